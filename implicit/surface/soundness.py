"""Soundness of a field after an edit: its slope near the surface, and the pieces of its surface.

Where |df/dx| vanishes the surface is about to tear, and where it is steep sphere tracing and sampling slow down. An
edit asks for the surface alone, so both are measured, beside the pieces and the Euler number.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from implicit.arguments import counted
from implicit.field.field import Field
from implicit.surface.extraction import marched_surface
from implicit.surface.topology import Topology, mesh_topology

# Share of a cell's area (or length) below which a component is spurious. The one seen so far, on the ear of a rabbit,
# had 4e-5.
SPURIOUS = 1e-2


@dataclass(frozen=True)
class Soundness:
    """Measures of a field near its surface.

    Attributes:
        topology: Components, Euler number and areas of the surface, as extracted.
        pieces: Components that are not spurious: marching cubes cuts off slivers at thin tips, of no area once their
            vertices are on the surface.
        slope_low, slope_median, slope_high: 1st, 50th and 99th percentile of |df/dx| near the surface, in units of
            the field a length. For a distance they are 1.
    """

    topology: Topology
    pieces: int
    slope_low: float
    slope_median: float
    slope_high: float

    def __repr__(self) -> str:
        slopes = f"{self.slope_low:.3g}, {self.slope_median:.3g}, {self.slope_high:.3g}"
        return (
            f"Soundness: {counted(self.pieces, 'piece')}, Euler number {self.topology.euler}; |df/dx| near the surface "
            f"{slopes} (1st, 50th, 99th percentile)"
        )


def field_soundness(field: Field, resolution: int = 48) -> Soundness:
    """Measure a field on its extracted surface, and at one cell of the grid to both sides of it.

    Args:
        field: The field.
        resolution: Cells along the longest side of the bounds; pieces smaller than a cell go unseen.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    points, faces = marched_surface(field, resolution)
    topology = mesh_topology(points.double().cpu().numpy(), faces.cpu().numpy())
    cell = field.size / resolution
    normals = field.normal(points)
    slopes = field.gradient(torch.cat([points, points + cell * normals, points - cell * normals])).norm(dim=1)
    low, median, high = (float(torch.quantile(part, q)) for part, q in _quantiles(slopes))
    pieces = sum(area > SPURIOUS * cell ** (field.dimension - 1) for area in topology.areas)
    return Soundness(topology, pieces, low, median, high)


def _quantiles(slopes: torch.Tensor) -> list[tuple[torch.Tensor, float]]:
    return [(slopes.double(), q) for q in (0.01, 0.5, 0.99)]


def changes(before: Soundness, after: Soundness) -> tuple[str, ...]:
    """Return what a reader must know of the difference, a sentence each; none where the field is as sound as before."""
    notes = []
    old, new = before.topology, after.topology
    if after.pieces > before.pieces:
        apart = ", ".join(f"{area:.3g}" for area in new.areas[before.pieces : after.pieces])
        notes.append(
            f"The surface has {after.pieces} pieces, where it had {before.pieces}; the smallest have the areas "
            f"{apart}. Hold the rest fixed, take a smaller displacement, or keep the largest piece of the mesh."
        )
    elif after.pieces < before.pieces:
        notes.append(f"The surface has {after.pieces} pieces, where it had {before.pieces}: some have merged.")
    elif new.components == old.components and new.euler != old.euler:
        notes.append(
            f"The Euler number of the surface went from {old.euler} to {new.euler}: handles have opened or closed."
        )
    if after.slope_low < 0.5 * before.slope_low:
        notes.append(
            f"The field has become flat near the surface: the 1st percentile of its slope fell from "
            f"{before.slope_low:.3g} to {after.slope_low:.3g}."
        )
    return tuple(notes)
