"""Pieces of a surface that may fall apart: what a step made of them, and the part of a step that divides nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor

from implicit.evolve.constraints import ConstraintSet, Measurement
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.surface.topology import Topology, confirmed_topology

# Parts of a step that are tried, the longest first.
PARTS = (1.0, 0.5, 0.25)


@dataclass(frozen=True, eq=False)
class Undivided:
    """The part of a step to take, and the surface after it.

    Attributes:
        part: Of the step.
        measured: The surface after that part.
        topology: Its pieces.
    """

    part: float
    measured: Measurement
    topology: Topology


def pieces(measured: Measurement, field: Field, resolution: int, before: Topology | None = None) -> Topology:
    """Return the pieces of a field's measured surface, confirmed on finer meshes where they differ from those before.

    Args:
        resolution: Cells along the longest side of the bounds of the measured surface's mesh.
        before: What the surface is likely to be; None believes the mesh.
    """
    surface = measured.surface
    mesh = surface.vertices.double().cpu().numpy(), surface.faces.cpu().numpy()
    return confirmed_topology(field, mesh, resolution, before)


def undivided_part(
    field: Field, x: Float[Tensor, " s"], space: DeformationSpace, constraints: ConstraintSet, before: Topology
) -> Undivided:
    """Return the largest part of a step after which the surface has no more pieces than before.

    Where a step is longer than a thin part is wide, it leaves spurious components behind that a shorter one does not.
    If even a quarter of the step divides the surface, the division is no artefact, and the whole step is taken.

    Args:
        field: At the start of the step.
        x: The step's unknowns.
        constraints: What measures the surface.
        before: The pieces at the start of the step.

    Raises:
        ValueError: The surface is lost.
    """
    tried = []
    for part in PARTS:
        moved = field.with_theta(field.theta + space.split(part * x)[0])
        measured = constraints.measure(moved)
        tried.append(Undivided(part, measured, pieces(measured, moved, constraints.holding.resolution, before)))
        if tried[-1].topology.components <= before.components:
            return tried[-1]
    return tried[0]


def topology_row(before: Topology | None, after: Topology | None) -> dict[str, Any]:
    """Return the record of a surface's pieces after a step, with an `event` where they have changed.

    Args:
        before, after: The pieces on both sides of the step; None where they are not watched, which gives no record.
    """
    if before is None or after is None:
        return {}
    row: dict[str, Any] = {"components": after.components, "euler": after.euler}
    if not after.same_type(before):
        row["event"] = (
            f"Pieces {before.components} to {after.components}, Euler number {before.euler} to {after.euler}."
        )
    return row
