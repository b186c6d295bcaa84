"""Check that a surface moved as its flow asked: what a flow promises, held against what was measured.

| flow, with nothing or the volume held | promise |
|---|---|
| MeanCurvature, of level 0 or "mean" | the area never grows |
| MeanCurvature, Offset | a surface whose speed is not zero moves |
| Bending, in weak form | 1/2 int kappa^2 does not grow |

Areas are compared to within the error of the quadrature, of which the difference between the areas of its curved cells
and of their flat ones is a bound once the cells resolve the shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from implicit.edits.flows import Bending, Flow, MeanCurvature, Offset
from implicit.edits.regions import Region
from implicit.evolve.edit import Edit, EditStatus
from implicit.field.field import Field, SurfaceError
from implicit.sensitivity.shape_functionals import Functional, Volume
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.surface.quadrature import MeshedSample

# Part of the motion that a flow asks for in its first step alone, below which a whole edit has moved nothing.
STOOD_STILL = 0.05

# Unevenness of the curvature, relative to the curvature, below which a surface at constant volume is at rest: the weak
# form is no better on an irregular mesh.
AT_REST = 0.15

# Part of the bending energy by which it may grow: averaged curvatures of two meshes agree no better.
BENDING_NOISE = 0.02


def area_growth(flow: Flow, constraints: Sequence[Functional], least: float, surface: MeshedSample) -> str | None:
    """Return what to say where a step made the area grow that a flow never lets grow; else None.

    Args:
        least: Least area of the edit so far.
        surface: After the step.
    """
    if not (isinstance(flow, MeanCurvature) and flow.level in (0.0, "mean") and _only_keep_volume(constraints)):
        return None
    area = float(surface.sample.weights.double().sum())
    error = abs(area - float(WeakSurface.of(surface.vertices, surface.faces).contents.sum()))
    if area <= least + error:
        return None
    return (
        f"The area grew to {area:.5g} from {least:.5g}, more than the error of its quadrature ({error:.2g}), which "
        "mean-curvature flow never lets it. Take smaller steps, or more points, directions or resolution."
    )


@dataclass(frozen=True, eq=False)
class AskedFlow:
    """Wish that a flow had of a surface, and how it is looked at.

    Attributes:
        flow: The law of motion.
        step_size: Time of a step.
        constraints: Functionals that are held.
        where: Region that scales the speed; None is everywhere.
        resolution: Cells along the longest side of the bounds.
        smooth: Whether curvature can be sampled at points.
    """

    flow: Flow
    step_size: float
    constraints: Sequence[Functional]
    where: Region | None
    resolution: int
    smooth: bool


def promise_kept(field: Field, edit: Edit, asked: AskedFlow) -> list[str]:
    """Return a sentence for each promise of its flow that an edit of the field has broken."""
    if not edit.history or edit.status not in (EditStatus.DONE, EditStatus.REACHED):
        return []
    broken = [row["flow"] for row in edit.history if "flow" in row][-1:]
    if not _only_keep_volume(asked.constraints):
        return broken
    try:
        return broken + _stood_still(field, edit, asked)
    except SurfaceError:  # the surface could be measured in every step, so only a mesh of its own is missing here
        return broken


def _stood_still(field: Field, edit: Edit, asked: AskedFlow) -> list[str]:
    flow = asked.flow
    if isinstance(flow, Bending) and not asked.smooth:
        before, after = (_bending_energy(part, asked.resolution) for part in (field, edit.field))
        if after > (1 + BENDING_NOISE) * before:
            return [
                f"The bending energy grew to {after:.4g} from {before:.4g}, which its flow never lets it. Take smaller "
                "steps, or more directions or resolution."
            ]
        return []
    if isinstance(flow, MeanCurvature):
        kappa = _curvature(field, edit.points, asked.resolution, asked.smooth)
        level = flow.level
        if asked.constraints or level == "mean":
            level = float(edit.weights @ kappa / edit.weights.sum())
        speed = kappa - level
        if _size(speed, edit.weights) < AT_REST * _size(kappa, edit.weights):
            return []
    elif isinstance(flow, Offset):
        speed = torch.full_like(edit.weights, flow.speed)
        if asked.constraints:  # a constant speed at constant volume is none
            return []
    else:
        return []
    if asked.where is not None:
        speed = speed * asked.where(edit.points)
    wanted = asked.step_size * _size(speed, edit.weights)
    moved = _size(edit.displacement.norm(dim=1), edit.weights)
    if moved >= STOOD_STILL * wanted:
        return []
    remedy = "Take more directions, or less damping." if asked.smooth else 'Leave the form measured: curvature="auto".'
    return [
        f"The surface moved by {moved:.2g} (root mean square) in {len(edit.history)} steps, where the flow asked for "
        f"{wanted:.2g} in the first alone. {remedy}"
    ]


def _only_keep_volume(constraints: Sequence[Functional]) -> bool:
    return all(isinstance(c, Volume) and c.target is None for c in constraints)


def _curvature(field: Field, points: Tensor, resolution: int, smooth: bool) -> Tensor:
    if smooth:
        return field.mean_curvature(points)
    surface = WeakSurface.extracted(field, resolution)
    return surface.at(points, surface.mean_curvature)


def _bending_energy(field: Field, resolution: int) -> float:
    """Return 1/2 int kappa^2 of the averaged curvature."""
    surface = WeakSurface.extracted(field, resolution)
    return float(surface.masses @ surface.mean_curvature**2) / 2


def _size(values: Tensor, weights: Tensor) -> float:
    """Return the root mean square over the surface."""
    return float(((weights @ values.square()) / weights.sum()).sqrt())
