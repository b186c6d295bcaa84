"""A mesh of the surface with about so many vertices, evenly spread: clusters of a finer marched mesh, and their dual.

Vertices p of the finer mesh, each with its share m of the area, are divided among centres c by Lloyd's method in the
space of positions and normals,

    sum over p  m |p - c|^2 + (NORMALS h)^2 |n_p - n_c|^2        [Valette and Chassery 2004; Lloyd 1982]

h the spacing, where the normals keep two sheets apart that are closer than the spacing. Where three clusters meet in a
triangle of the finer mesh is a triangle of the new one, and its vertices are the centres brought onto f = 0. So they
are as dense in every direction, which those of a marched mesh are not: the energy of spokes and rims bends the more
stiffly the wider its vertices stand, and would bend by the direction of the lattice.

Where a cluster is no disk the new mesh would not be closed; then the marched mesh itself is relaxed along the surface.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.field.field import Field
from implicit.surface.dual_mesh import NORMALS, dual_triangles, in_one_piece, is_closed, vertex_normals
from implicit.surface.extraction import marched_surface
from implicit.surface.projection import newton_to_surface
from implicit.surface.topology import mesh_topology

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Vertices of the finer mesh in a cluster, and sweeps of Lloyd's method.
FINER = 8
SWEEPS = 8

# Sweeps of the relaxation that rounds the triangles at the end, and of the one of a marched mesh; in each a vertex goes
# this share of the way to the mean of its neighbours.
AFTER, RELAXATIONS, SHARE = 3, 10, 0.7

# Cells along the longest side at which the vertices are counted first; no mesh has fewer, or more than MOST.
FIRST_CELLS, MOST_CELLS = 32, 256


def even_mesh(field: Field, count: int) -> tuple[Float[Tensor, "v 3"], Int[Tensor, "m 3"]]:
    """Return vertices on the surface and triangles with outward normals, of all its pieces.

    Args:
        field: A field in 3D.
        count: About how many vertices.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    single = field.to(torch.float32)  # the finer mesh only says where the surface is
    points, faces = _marched(single, FINER * count, *marched_surface(single, FIRST_CELLS))
    found = _clustered(points.double().cpu().numpy(), faces.cpu().numpy(), count)
    if found is not None:
        V, F = found
        side = float(np.linalg.norm(V[F[:, 0]] - V[F[:, 1]], axis=1).mean())
        start = torch.from_numpy(V).to(field.theta)
        placed, arrived = newton_to_surface(field, start, reach=side)
        if bool(arrived.all()):
            faces = torch.from_numpy(F).to(faces)
            return _relaxed(field, placed, faces, AFTER), faces
    points, faces = _marched(field, count, *marched_surface(field, FIRST_CELLS))
    return _relaxed(field, points, faces, RELAXATIONS), faces


def _marched(field: Field, count: int, points: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Return the marched mesh with about so many vertices; given is that of FIRST_CELLS."""
    cells = min(max(round(FIRST_CELLS * (count / len(points)) ** 0.5), FIRST_CELLS), MOST_CELLS)
    return (points, faces) if cells == FIRST_CELLS else marched_surface(field, cells)


def _clustered(V: FloatArray, F: IntArray, count: int) -> tuple[FloatArray, IntArray] | None:
    """Return the centres of clusters and the triangles between them; None where they make no mesh of the same type."""
    areas, masses, normals = vertex_normals(V, F)
    masses = masses + 1e-9 * areas.mean()
    spacing = (areas.sum() / count) ** 0.5
    places = np.concatenate([V, NORMALS * spacing * normals], axis=1)
    centres = places[_even_start(V, masses, count)]
    count = len(centres)
    for _ in range(SWEEPS):
        cluster = cKDTree(centres).query(places)[1]
        weights = np.bincount(cluster, masses, count)
        sums = [np.bincount(cluster, masses * column, count) for column in places.T]
        full = weights > 0
        centres[full] = np.stack(sums, axis=1)[full] / weights[full, None]
    cluster = in_one_piece(np.asarray(cKDTree(centres).query(places)[1], dtype=np.int64), F)
    triangles = dual_triangles(cluster, F)
    used, renamed = np.unique(triangles, return_inverse=True)
    triangles = renamed.reshape(-1, 3).astype(np.int64)
    if not is_closed(triangles):
        return None
    found = centres[used, :3]
    return (found, triangles) if mesh_topology(found, triangles).same_type(mesh_topology(V, F)) else None


def _even_start(V: FloatArray, masses: FloatArray, count: int) -> IntArray:
    """Return vertices that stand for equal parts of the area, along a curve that fills space."""
    unit = (V - V.min(axis=0)) / np.ptp(V, axis=0).max()
    cells = np.minimum((unit * 1024).astype(np.int64), 1023)
    code = np.zeros(len(V), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    until = np.cumsum(masses[order])
    middles = (np.arange(count) + 0.5) / count * until[-1]
    return np.asarray(np.unique(order[np.searchsorted(until, middles)]))


def _relaxed(
    field: Field, points: Float[Tensor, "v 3"], faces: Int[Tensor, "m 3"], sweeps: int
) -> Float[Tensor, "v 3"]:
    """Return the vertices of a mesh spread more evenly along the surface."""
    F = faces.cpu().numpy()
    ends = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    both = np.concatenate([ends, ends[:, ::-1]])
    links = sparse.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(points), len(points))).tocsr()
    links.data[:] = 1.0
    means = sparse.csr_array(sparse.diags_array(1 / np.maximum(links.sum(axis=1), 1)) @ links)
    side = float((points[faces[:, 0]] - points[faces[:, 1]]).norm(dim=1).square().mean().sqrt())
    for _ in range(sweeps):
        normals = torch.nn.functional.normalize(field.gradient(points), dim=1)
        way = torch.from_numpy(means @ points.detach().double().cpu().numpy()).to(points) - points
        way = way - (way * normals).sum(dim=1, keepdim=True) * normals
        moved, arrived = newton_to_surface(field, points + SHARE * way, reach=side)
        points = torch.where(arrived[:, None], moved, points)
    return points
