"""The zero set as a mesh (3D) or as line segments (2D): grid, marching, then Newton to the true surface.

Conventions: faces wind so that their normals point out of f < 0; segments have the inside on their left.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.marching import MEMORY_LIMIT, Grid, march
from implicit.surface.projection import newton_to_surface

# More cells along a side than any memory holds in three dimensions, or in two.
MOST_CELLS = 1_000_000

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


def extract_mesh(field: Field, resolution: int = 128, *, memory_limit: float = MEMORY_LIMIT) -> tuple[Vertices, Faces]:
    """Return the surface as a closed triangle mesh, its vertices placed on f = 0 by Newton's method.

    Args:
        field: A field in 3D (triangles), or in 2D (segments).
        resolution: Cells along the longest side of the bounds, at least 4.
        memory_limit: Bytes that the grid may take; a finer one is refused before any work.

    Returns:
        Vertices (n, D) float64 in the field's coordinates, and faces (m, D) int64 that index them: triangles
        with outward normals, or in 2D segments with the inside on their left.

    Raises:
        SurfaceError: There is no zero set in the bounds, it leaves them, or the gradient vanishes on it.
        MemoryError: The grid would take more than memory_limit.
    """
    points, faces = marched_surface(field, resolution, memory_limit)
    return points.double().cpu().numpy(), faces.cpu().numpy()


def require_resolution(name: str, cells: int) -> None:
    """Refuse a resolution that is no number of cells."""
    require_whole(name, cells, 4, "cells along the longest side", MOST_CELLS)


def marched_surface(
    field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT
) -> tuple[Float[Tensor, "n d"], Tensor]:
    """Return the mesh of extract_mesh as tensors of the field's dtype and device."""
    require_field(field)
    require_resolution("resolution", resolution)
    require_positive("memory_limit", memory_limit if memory_limit != float("inf") else 1.0, "number of bytes")
    grid = Grid.over(field, resolution)
    grid.require_memory(memory_limit)
    start, faces = march(field, grid)
    points, arrived = newton_to_surface(field, start, reach=2 * grid.cell)
    if not bool(arrived.all()):
        # A vertex between two sheets closer than a cell may have nowhere to go; it keeps its place on the grid edge,
        # which is within a cell of the surface, unless so many fail that the field itself is at fault.
        lost = int((~arrived).sum())
        if lost > 0.01 * len(points):
            raise SurfaceError(
                f"{lost} of {len(points)} surface points could not be placed on f = 0: the gradient vanishes or jumps "
                "there. Refit the field, or extract at a higher resolution."
            )
        points = torch.where(arrived[:, None], points, start)
    return points, faces
