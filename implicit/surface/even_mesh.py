"""A mesh of the surface with about so many vertices, evenly spread: marched, then relaxed along the surface.

Each sweep moves every vertex by SHARE of the tangential part of the mean of its neighbours less itself, and back onto
f = 0 by Newton's method. Marching leaves needles, whose angles make the cotangents of an energy on the mesh useless.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy import sparse
from torch import Tensor

from implicit.field.field import Field
from implicit.surface.extraction import marched_surface
from implicit.surface.projection import newton_to_surface

SWEEPS = 10
SHARE = 0.7

# Vertices that marching makes to an area of one cell squared.
VERTICES_OF_CELLS = 1.5

# Cells along the longest side at which the area is measured first; no mesh has fewer, or more than MOST.
FIRST_CELLS, MOST_CELLS = 32, 512


def even_mesh(field: Field, count: int) -> tuple[Float[Tensor, "v 3"], Int[Tensor, "m 3"]]:
    """Return vertices on the surface and triangles with outward normals, of all its pieces.

    Args:
        field: A field in 3D.
        count: About how many vertices.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    points, faces = marched_surface(field, FIRST_CELLS)
    cells = round(FIRST_CELLS * (count / len(points)) ** 0.5)
    cells = min(max(cells, FIRST_CELLS), MOST_CELLS)
    if cells != FIRST_CELLS:
        points, faces = marched_surface(field, cells)
    return _relaxed(field, points, faces), faces


def _relaxed(field: Field, points: Float[Tensor, "v 3"], faces: Int[Tensor, "m 3"]) -> Float[Tensor, "v 3"]:
    F = faces.cpu().numpy()
    ends = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    both = np.concatenate([ends, ends[:, ::-1]])
    links = sparse.coo_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(len(points), len(points))).tocsr()
    links.data[:] = 1.0
    means = sparse.csr_array(sparse.diags_array(1 / np.maximum(links.sum(axis=1), 1)) @ links)
    side = float((points[faces[:, 0]] - points[faces[:, 1]]).norm(dim=1).square().mean().sqrt())
    for _ in range(SWEEPS):
        normals = torch.nn.functional.normalize(field.gradient(points), dim=1)
        way = torch.from_numpy(means @ points.detach().double().cpu().numpy()).to(points) - points
        way = way - (way * normals).sum(dim=1, keepdim=True) * normals
        moved, arrived = newton_to_surface(field, points + SHARE * way, reach=side)
        points = torch.where(arrived[:, None], moved, points)
    return points
