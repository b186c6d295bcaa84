"""The zero set as a mesh (3D) or as line segments (2D): grid, marching, then Newton to the true surface.

Each vertex starts on an edge of the grid at whose ends f has different signs, so where Newton's method fails a bracket
finds the zero that every continuous field has there.

Conventions: faces wind so that their normals point out of f < 0; segments have the inside on their left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int, Int8
from numpy.typing import NDArray
from torch import Tensor

from implicit.arguments import require_choice, require_positive, require_whole
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.bracketing import bracketed_zeros
from implicit.surface.marching import MEMORY_LIMIT, Crossings, Grid, march
from implicit.surface.projection import Placement, discontinuous, in_working_precision, place_on_surface

# More cells along a side than any memory holds in three dimensions, or in two.
MOST_CELLS = 1_000_000

# Share of the vertices that may jump over f = 0, or have nowhere to go, before the field is at fault.
LOST = 0.01

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


def extract_mesh(
    field: Field,
    resolution: int = 128,
    *,
    memory_limit: float = MEMORY_LIMIT,
    units: Literal["field", "user"] = "field",
) -> tuple[Vertices, Faces]:
    """Return the surface as a closed triangle mesh, its vertices placed on f = 0.

    The field need only be continuous: where its gradient jumps or vanishes the vertices are found by brackets, each on
    the edge of the grid that the surface crosses.

    Args:
        field: A field in 3D (triangles), or in 2D (segments). Of half precision it is taken in single.
        resolution: Cells along the longest side of the bounds, at least 4.
        memory_limit: Bytes that the grid may take; a finer one is refused before any work.
        units: Coordinates of the vertices: "field", or "user" for those of the file that the field was fitted to,
            field.units.to_user of them.

    Returns:
        Vertices (n, D) float64 in these coordinates, and faces (m, D) int64 that index them: triangles
        with outward normals, or in 2D segments with the inside on their left.

    Raises:
        SurfaceError: There is no zero set in the bounds, it leaves them, or f jumps over zero instead of crossing it.
        MemoryError: The grid would take more than memory_limit.
    """
    require_choice("units", units, ("field", "user"))
    points, faces = marched_surface(field, resolution, memory_limit)
    points = points.double() if units == "field" else field.units.to_user(points.double())
    return points.cpu().numpy(), faces.cpu().numpy()


def require_resolution(name: str, cells: int) -> None:
    """Refuse a resolution that is no number of cells."""
    require_whole(name, cells, 4, "cells along the longest side", MOST_CELLS)


def marched_surface(
    field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT
) -> tuple[Float[Tensor, "n d"], Tensor]:
    """Return the mesh of extract_mesh as tensors on the field's device, in its dtype but at least single precision."""
    placement, faces = placed_vertices(field, resolution, memory_limit)
    return placement.points, faces


def placed_vertices(
    field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT
) -> tuple[Placement, Int[Tensor, "m d"]]:
    """Return the vertices of marched_surface with the gradients there, and its faces."""
    found = placed_on_grid(field, resolution, memory_limit)
    return found.placement, found.faces


@dataclass(frozen=True, eq=False)
class PlacedOnGrid:
    """A marched mesh with its vertices on the surface, and the signs that it was told from.

    Attributes:
        placement: The vertices.
        faces: Triangles or segments that join them.
        grid: The grid that was marched over.
        signs: At each of its nodes the sign of f, zero where the surface is far.
    """

    placement: Placement
    faces: Int[Tensor, "m d"]
    grid: Grid
    signs: Int8[Tensor, "*nodes"]
    crossings: Crossings


def placed_on_grid(field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT) -> PlacedOnGrid:
    """Return the vertices and faces of placed_vertices with the grid that they were told from."""
    field, grid, start = marched_crossings(field, resolution, memory_limit)
    return PlacedOnGrid(placed_crossings(field, grid, start), start.faces, grid, start.signs, start)


def marched_crossings(
    field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT
) -> tuple[Field, Grid, Crossings]:
    """Return the crossings that placed_on_grid places, with the field in the precision of that, and the grid."""
    require_field(field)
    require_resolution("resolution", resolution)
    require_positive("memory_limit", memory_limit if memory_limit != float("inf") else 1.0, "number of bytes")
    field = in_working_precision(field)
    grid = Grid.over(field, resolution)
    grid.require_memory(memory_limit)
    return field, grid, march(field, grid)


def placed_crossings(field: Field, grid: Grid, start: Crossings) -> Placement:
    """Return crossings placed on the surface.

    Raises:
        SurfaceError: f jumps over zero at too many of them, or they cannot be placed.
    """
    found = place_on_surface(field, start.points, reach=2 * grid.cell, segments=(start.lower, start.upper))
    found = on_their_side(field, start, found)
    if int(found.jumps.sum()) > LOST * len(start.points):
        raise discontinuous(field, found)
    if not bool((found.arrived | found.jumps).all()):
        # Signs are told in single precision: an end of an edge may lie on the surface but for rounding. What else has
        # nowhere to go lies between two sheets closer than a cell, and keeps its place.
        lost = int((~found.arrived & ~found.jumps).sum())
        if lost > LOST * len(start.points):
            raise SurfaceError(
                f"{lost} of {len(start.points)} surface points could not be placed on f = 0: the field changes with "
                "rounding there, or has pieces thinner than a cell. Extract at a higher resolution, take the field to "
                "torch.float64, or refit it."
            )
        kept = torch.where((found.arrived | found.jumps)[:, None], found.points, start.points)
        found = replace(found, points=kept)
    return found


def on_their_side(field: Field, start: Crossings, found: Placement) -> Placement:
    """Return the placement with what strayed to the other side of a thin part brought back to its own edge.

    From the middle of a sheet Newton's method goes to either side, by less than a cell: there f rises against the
    direction in which it changes its sign along the edge. Both sides placed on one would leave the sheet no volume.
    """
    outward = start.outward
    strayed = found.arrived & ((found.gradients * outward).sum(dim=1) < 0)
    which = strayed.nonzero()[:, 0]
    if len(which) == 0:
        return found
    lower, upper = start.lower[which], start.upper[which]
    at_lower, at_upper = field.value(lower), field.value(upper)
    crossed = (at_lower < 0) != (at_upper < 0)
    which, lower, upper, at_lower, at_upper = (x[crossed] for x in (which, lower, upper, at_lower, at_upper))
    tolerance = field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)
    zeros = bracketed_zeros(field, lower, upper, at_lower, at_upper, tolerance)
    slopes = field.gradient(zeros.points)
    # Beside a blunt ridge that runs along the edge the other face is no other side.
    opposed = (slopes * found.gradients[which]).sum(dim=1) < 0
    which, slopes = which[opposed], slopes[opposed]
    points, arrived, jumps, gradients = (x.clone() for x in (found.points, found.arrived, found.jumps, found.gradients))
    points[which], arrived[which], jumps[which] = zeros.points[opposed], ~zeros.jumps[opposed], zeros.jumps[opposed]
    gradients[which] = slopes
    return Placement(points, arrived, jumps, gradients)
