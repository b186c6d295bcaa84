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


def promise_kept(
    field: Field,
    edit: Edit,
    flow: Flow,
    step_size: float,
    constraints: Sequence[Functional],
    where: Region | None,
    resolution: int,
    *,
    smooth: bool,
) -> list[str]:
    """Return a sentence for each promise of its flow that an edit has broken.

    Args:
        field: Before the edit.
        step_size: Time of a step.
        where: Region that scales the speed.
        resolution: Cells along the longest side of the bounds.
        smooth: Whether curvature can be sampled at points.
    """
    if not edit.history or edit.status not in (EditStatus.DONE, EditStatus.REACHED):
        return []
    broken = [row["flow"] for row in edit.history if "flow" in row][-1:]
    if not _only_keep_volume(constraints):
        return broken
    try:
        return broken + _stood_still(field, edit, flow, step_size, constraints, where, resolution, smooth)
    except SurfaceError:  # the surface could be measured in every step, so only a mesh of its own is missing here
        return broken


def _stood_still(
    field: Field,
    edit: Edit,
    flow: Flow,
    step_size: float,
    constraints: Sequence[Functional],
    where: Region | None,
    resolution: int,
    smooth: bool,
) -> list[str]:
    if isinstance(flow, Bending) and not smooth:
        before, after = (_bending_energy(part, resolution) for part in (field, edit.field))
        if after > (1 + BENDING_NOISE) * before:
            return [
                f"The bending energy grew to {after:.4g} from {before:.4g}, which its flow never lets it. Take smaller "
                "steps, or more directions or resolution."
            ]
        return []
    if isinstance(flow, MeanCurvature):
        kappa = _curvature(field, edit.points, resolution, smooth)
        level = flow.level
        if constraints or level == "mean":
            level = float(edit.weights @ kappa / edit.weights.sum())
        asked = kappa - level
        if _size(asked, edit.weights) < AT_REST * _size(kappa, edit.weights):
            return []
    elif isinstance(flow, Offset):
        asked = torch.full_like(edit.weights, flow.speed)
        if constraints:  # a constant speed at constant volume is none
            return []
    else:
        return []
    if where is not None:
        asked = asked * where(edit.points)
    wanted = step_size * _size(asked, edit.weights)
    moved = _size(edit.displacement.norm(dim=1), edit.weights)
    if moved >= STOOD_STILL * wanted:
        return []
    return [
        f"The surface moved by {moved:.2g} (root mean square) in {len(edit.history)} steps, where the flow asked for "
        f"{wanted:.2g} in the first alone. "
        + ("Take more directions, or less damping." if smooth else 'Leave the form to be measured: curvature="auto".')
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
