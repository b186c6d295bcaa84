"""Points that carry a linear rigid edit, and the triangles between them: both from one mesh of the surface.

That mesh is the one on which the soundness of the field before the edit was measured, so that neither costs a look at
the field of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from implicit.field.field import Field, SurfaceError
from implicit.sensitivity.weak_curvature import FloatArray, IntArray, WeakSurface
from implicit.surface.dual_mesh import connected_points
from implicit.surface.extraction import marched_surface
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import CANDIDATES, farthest_order
from implicit.surface.topology import Topology, mesh_topology

# Vertices of the mesh to each point at least. With three the points make a mesh of another type.
FINER = 5

# Cells along the longest side of the bounds of a mesh that is made where the points cannot be connected by the first.
FINER_CELLS = 192

# Part by which the weights of the points may differ in all from the areas about them, for these to take their place.
LIKE_AREAS = 0.1


@dataclass(frozen=True, eq=False)
class FineMesh:
    """A mesh of a field's surface, finer than its points are to stand.

    Attributes:
        vertices: On the surface, or near it between crossings of a lattice (V, 3).
        faces: Outward (m, 3).
        topology: Its pieces and handles.
    """

    vertices: FloatArray
    faces: IntArray
    topology: Topology

    @classmethod
    def of(cls, field: Field, cells: int) -> FineMesh:
        """Return the marched mesh of so many cells along the longest side of the bounds, in single precision.

        Raises:
            SurfaceError: There is no surface in the bounds, or it leaves them.
        """
        V, F = (part.cpu().numpy() for part in marched_surface(field.to(torch.float32), cells))
        return cls(V.astype(float), F, mesh_topology(V, F))

    def faces_of(self, sample: SurfaceSample) -> IntArray | None:
        """Return triangles between points of the surface (m, 3); None where it is too coarse for that."""
        if len(self.vertices) < FINER * len(sample):
            return None
        points, normals = (part.detach().double().cpu().numpy() for part in (sample.points, sample.normals))
        return connected_points(points, normals, self.vertices, self.faces, self.topology)

    def spread(self, field: Field, count: int, seed: int) -> tuple[SurfaceSample, IntArray] | None:
        """Return so many points as far apart as can be, weighted by area, and the triangles between them.

        Args:
            field: Whose mesh this is; the points are put on its surface.
            count: Number of points.
            seed: Of the first of them.

        Returns:
            None where the mesh is too coarse, or the points make no mesh of the surface.
        """
        wanted = CANDIDATES * count
        if len(self.vertices) < wanted:
            return None
        some = torch.from_numpy(self.vertices[np.arange(wanted) * len(self.vertices) // wanted]).to(torch.float32)
        first = int(torch.randint(wanted, (1,), generator=torch.Generator().manual_seed(seed)))
        some = some.roll(-first, dims=0)
        points = some[farthest_order(some, count)]
        for precision in (field.to(torch.float32), field):  # the last of Newton's steps alone in the field's own
            points, arrived = newton_to_surface(precision, points.to(precision.theta), reach=field.size / 16)
        if not bool(arrived.all()):
            return None
        sample = SurfaceSample(points, field.normal(points), torch.ones_like(points[:, 0]))
        faces = self.faces_of(sample)
        return None if faces is None else (_weighted(sample, faces), faces)


def connected(field: Field, sample: SurfaceSample, mesh: FineMesh) -> IntArray | None:
    """Return triangles between points whose weights are areas (m, 3).

    Args:
        field: On whose surface they are.
        sample: The points.
        mesh: Of the surface; where it is too coarse, one of FINER_CELLS takes its place.

    Returns:
        None where the points make no mesh of the surface, or their weights are other than the areas about them.
    """
    faces = mesh.faces_of(sample)
    if faces is None:
        try:
            faces = FineMesh.of(field, FINER_CELLS).faces_of(sample)
        except SurfaceError:
            return None
    if faces is None:
        return None
    weights, areas = sample.weights.double().cpu(), _weighted(sample, faces).weights.double().cpu()
    likely = bool((weights > 0).all()) and abs(float(weights.sum() / areas.sum()) - 1) < LIKE_AREAS
    return faces if likely else None


def _weighted(sample: SurfaceSample, faces: IntArray) -> SurfaceSample:
    """Return the points with the areas about them in a mesh."""
    areas = WeakSurface(sample.points.detach().double().cpu().numpy(), faces).masses
    return SurfaceSample(sample.points, sample.normals, torch.from_numpy(areas).to(sample.points))
