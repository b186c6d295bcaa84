"""Soundness of a field after an edit: its slope near the surface, and the pieces of its surface.

Where |df/dx| vanishes the surface is about to tear, and where it is steep sphere tracing and sampling slow down. An
edit asks for the surface alone, so both are measured, beside the pieces and the Euler number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from implicit.arguments import counted
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.extraction import marched_crossings, placed_crossings, require_resolution
from implicit.surface.topology import Topology, mesh_topology, surface_topology, vertices_of_pieces

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Share of a cell's area (or length) below which a component is spurious. The one seen so far, on the ear of a rabbit,
# had 4e-5.
SPURIOUS = 1e-2

# Cells on which pieces and handles are counted, for each of the resolution: thin parts tear and close on coarse cells.
# And at most so many vertices of their surface at which slopes are measured.
FINER = 8 / 3
MEASURED = 4000

# Measurements that are kept with a field: those before and after an edit.
KEPT = 2

# Vertices below which a piece may be a sliver.
SMALL = 200


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
    """Measure a field on its extracted surface, and a little to both sides of it.

    Args:
        field: The field.
        resolution: Cells along the longest side of the bounds, of which one is that little. Pieces and handles are
            counted on finer ones, FINER times as many: at 48, on 128. What is smaller than such a cell goes unseen.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    return soundness_on_mesh(field, resolution)[0]


def soundness_on_mesh(field: Field, resolution: int = 48) -> tuple[Soundness, FloatArray, IntArray]:
    """Return the same, and the mesh on which it was measured: vertices (V, D), near the surface, and faces (m, D).

    Most vertices are where the lines of the lattice cross the surface by interpolation. What was found last of a field
    is kept with it, for edits that start from the field that another has ended with, or from the same field again.
    """
    require_field(field)
    require_resolution("resolution", resolution)
    key = _Measured(resolution, field.theta.clone(), field.bounds.clone(), field.level, field.sign)
    known: list[tuple[_Measured, tuple[Soundness, FloatArray, IntArray]]] = field.findings.setdefault("soundness", [])
    for other, found in known:
        if key.is_like(other):
            return found
    found = _measured(field, resolution)
    if field._evaluator.module is not None:  # a function may change, whatever its parameters
        known[:] = [*known[1 - KEPT :], (key, found)]
    return found


@dataclass(frozen=True, eq=False)
class _Measured:
    """All that the soundness of a frozen module depends on."""

    resolution: int
    theta: Tensor
    bounds: Tensor
    level: float
    sign: float

    def is_like(self, other: _Measured) -> bool:
        same = (self.resolution, self.level, self.sign) == (other.resolution, other.level, other.sign)
        return same and torch.equal(self.theta, other.theta) and torch.equal(self.bounds, other.bounds)


def _measured(field: Field, resolution: int) -> tuple[Soundness, FloatArray, IntArray]:
    working, grid, start = marched_crossings(field, fine_cells(resolution))
    faces = start.faces.cpu().numpy()
    # Areas are as good without Newton's method, but those of slivers, which have none once they are on the surface.
    measured = torch.zeros(len(start.points), dtype=torch.bool)
    measured[:: -(-len(measured) // MEASURED)] = True
    which = (measured | torch.from_numpy(vertices_of_pieces(len(measured), faces) < SMALL)).to(start.points.device)
    placed = placed_crossings(working, grid, start.only(which)).points
    points = start.points.to(placed)
    points[which] = placed
    V = points.double().cpu().numpy()
    topology = mesh_topology(V, faces)
    cell = field.size / resolution
    some = points[measured.to(points.device)].to(field.dtype)
    normals = field.normal(some)
    slopes = field.gradient(torch.cat([some, some + cell * normals, some - cell * normals])).norm(dim=1).double()
    low, median, high = (float(torch.quantile(slopes, q)) for q in (0.01, 0.5, 0.99))
    return Soundness(topology, _pieces(field, topology, resolution), low, median, high), V, faces


def fine_cells(resolution: int) -> int:
    """Return the cells on which pieces and handles are counted."""
    return round(FINER * resolution)


def _pieces(field: Field, topology: Topology, resolution: int) -> int:
    cell = field.size / fine_cells(resolution)
    return sum(area > SPURIOUS * cell ** (field.dimension - 1) for area in topology.areas)


def has_changed(before: Soundness, after: Soundness) -> bool:
    """Return whether pieces have merged or vanished, or handles have opened or closed."""
    old, new = before.topology, after.topology
    return after.pieces < before.pieces or (
        after.pieces == before.pieces and old.components == new.components and old.euler != new.euler
    )


def confirmed(
    before: Soundness, after: Soundness, fields: tuple[Field, Field], resolution: int
) -> tuple[Soundness, Soundness]:
    """Return both with pieces and handles as finer cells show them, where those of the fields differ.

    The edge of a sheet thinner than a cell comes and goes with the lattice.

    Args:
        before, after: As measured at the resolution.
        fields: Before and after.
        resolution: Cells along the longest side of the bounds.
    """
    if after.pieces == before.pieces and not has_changed(before, after):
        return before, after
    finer = 2 * resolution
    try:
        one, two = (surface_topology(field, fine_cells(finer)) for field in fields)
    except SurfaceError:  # on finer cells one meets the bounds: what the others show stands
        return before, after
    return (
        replace(before, topology=one, pieces=_pieces(fields[0], one, finer)),
        replace(after, topology=two, pieces=_pieces(fields[1], two, finer)),
    )


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
        count = f"{counted(after.pieces, 'piece')}, where it had {before.pieces}"
        notes.append(f"The surface has {count}: some have merged or vanished.")
    elif has_changed(before, after):
        notes.append(
            f"The Euler number of the surface went from {old.euler} to {new.euler}: handles have opened or closed."
        )
    if after.slope_low < 0.5 * before.slope_low:
        notes.append(
            f"The field has become flat near the surface: the 1st percentile of its slope fell from "
            f"{before.slope_low:.3g} to {after.slope_low:.3g}."
        )
    return tuple(notes)
