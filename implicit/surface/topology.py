"""Number of pieces of a surface, and its Euler number: what an edit must not change unnoticed.

    chi = vertices - edges + faces        2 for each sphere, less 2 for each handle; 0 for closed curves

Conventions: components are those of the extracted mesh, so a piece smaller than a cell of the grid goes unseen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from implicit.arguments import counted
from implicit.field.field import Field
from implicit.surface.extraction import Faces, Vertices, extract_mesh


@dataclass(frozen=True)
class Topology:
    """Pieces of a surface.

    Attributes:
        components: How many there are.
        euler: Vertices minus edges plus faces, of all pieces together.
        areas: Of each piece (lengths, in the plane), the largest first.
    """

    components: int
    euler: int
    areas: tuple[float, ...]

    def __repr__(self) -> str:
        largest = ", ".join(f"{area:.4g}" for area in self.areas[:3]) + (", ..." if len(self.areas) > 3 else "")
        return f"Topology: {counted(self.components, 'component')}, Euler number {self.euler}, areas {largest}"

    def same_type(self, other: Topology) -> bool:
        """Return whether both have as many pieces and the same Euler number."""
        return (self.components, self.euler) == (other.components, other.euler)


def surface_topology(field: Field, resolution: int = 48) -> Topology:
    """Return the pieces of a field's surface.

    Args:
        resolution: Cells along the longest side of the bounds; pieces smaller than a cell go unseen.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    return mesh_topology(*extract_mesh(field, resolution))


def confirmed_topology(
    field: Field, mesh: tuple[Vertices, Faces], resolution: int, before: Topology | None = None
) -> Topology:
    """Return the pieces of a mesh of a field's surface; where they differ from those before, those of finer meshes.

    The edge of a sheet thinner than a cell shows as spurious components that come and go with the lattice: a bunny's
    ear, 0.01 thick at its tip, has one or two at 48 and 96 cells and none at 192.

    Args:
        mesh: Vertices and faces at the resolution.
        resolution: Cells along the longest side of the bounds.
        before: What the surface is likely to be; None believes the mesh.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    found = mesh_topology(*mesh)
    for finer in (2 * resolution, 4 * resolution):
        if before is None or found.same_type(before):
            break
        found = surface_topology(field, finer)
    return found


def mesh_topology(V: Vertices, F: Faces) -> Topology:
    """Return the pieces of a closed mesh: triangles (m, 3), or segments (m, 2) in the plane.

    Raises:
        ValueError: V or F have another shape or type, or F names rows that V does not have.
    """
    V, F = np.asarray(V), np.asarray(F)
    if V.ndim != 2 or V.dtype.kind not in "fiu":
        raise ValueError(f"V must be an array of points (n, D), but has shape {V.shape} and type {V.dtype}.")
    if F.ndim != 2 or F.shape[1] not in (2, 3) or F.dtype.kind not in "iu":
        raise ValueError(f"F must be whole numbers (m, 3) or (m, 2), but has shape {F.shape} and type {F.dtype}.")
    if len(F) == 0 or F.min() < 0 or F.max() >= len(V):
        raise ValueError(f"F must name some of the {len(V)} rows of V, from 0 on, but does not.")
    ends = F if F.shape[1] == 2 else np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    code = np.sort(ends.min(axis=1) * len(V) + ends.max(axis=1))  # np.unique hashes, in twenty times as long
    code = code[np.diff(code, prepend=-1) != 0]
    count, label = _labelled(len(V), np.stack([code // len(V), code % len(V)], axis=1))
    areas = np.bincount(label[F[:, 0]], _contents(V, F), minlength=count)
    faces = len(F) if F.shape[1] == 3 else 0
    return Topology(count, len(V) - len(code) + faces, tuple(float(a) for a in np.sort(areas)[::-1]))


def vertices_of_pieces(vertices: int, F: Faces) -> NDArray[np.int64]:
    """Return for each vertex of a mesh how many vertices its piece has."""
    count, label = _labelled(vertices, F[:, :2] if F.shape[1] == 2 else np.concatenate([F[:, :2], F[:, 1:]]))
    return np.asarray(np.bincount(label, minlength=count)[label])


def _labelled(vertices: int, edges: Faces) -> tuple[int, NDArray[np.int32]]:
    """Return how many pieces the edges join the vertices to, and the piece of each."""
    links = (np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1]))
    count, label = csgraph.connected_components(sparse.csr_array(links, shape=(vertices, vertices)), directed=False)
    return int(count), label


def _contents(V: Vertices, F: Faces) -> Vertices:
    """Return the area of each triangle, or length of each segment."""
    sides = V[F[:, 1:]] - V[F[:, :1]]
    if F.shape[1] == 2:
        return np.asarray(np.linalg.norm(sides[:, 0], axis=1))
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2)
