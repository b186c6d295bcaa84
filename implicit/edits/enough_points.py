"""The number of points that an edit needs, and points that carry nothing to judge whether it had enough.

A network's parameters act everywhere, so that a few thousand points hold the surface between them too. A grid's do not:
what no point of the sample sees does not move, and between the points the surface lags behind. So other points of the
surface are asked as well: with x the linear solution at the sample's points,

    unmet = |B x - y| / |y|        at the sample's points, and at others

and the sample is doubled until the others are met about as well. A network's sample stays as it was asked for; where it
is small, other points judge what the edit has left between its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from implicit.edits.targets import SummedTargets
from implicit.evolve.edit import REACHED_SHARE, Edit, edit_status
from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import normal_displacement
from implicit.sensitivity.sparse_rows import has_sparse_rows
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import StepProblem, assemble
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import carrying_points, sample_surface

# Share of the target, root mean square, that others may miss in any case, and in multiples of the sample's own.
ALLOWED, ALLOWED_MULTIPLE = 0.015, 1.5

# Most points that are drawn, and the others that judge them.
MOST_POINTS = 32_000
OTHERS = 3000

# Points from which on a network, whose parameters act everywhere, holds the surface between them; fewer are judged by
# others. On the cow's flank a bump of three parts is missed by 16 % between 500 points, 9 % of 1000, 6 % of 2000.
MANY_POINTS, JUDGES = 2000, 1000

# Of the linear solution, relative to the trace: about where the edits of grids end up.
RELATIVE_DAMPING = 1e-6

TargetsOf = Callable[[Tensor, Tensor], SummedTargets]


@dataclass(frozen=True, eq=False)
class Carriers:
    """The points that carry a target, and what judges them.

    Attributes:
        sample: The points.
        others: Points of the unedited surface that carry nothing; None where a network's points are many.
        notes: What is to be said of their number, a sentence each.
    """

    sample: SurfaceSample
    others: SurfaceSample | None = None
    notes: tuple[str, ...] = ()

    def judged(self, edit: Edit) -> Edit:
        """Return the edit with the status that it has on the other points too, and the notes."""
        if self.others is None:
            return edit
        unmet = _unmet_after(edit, self.others)
        status, notes = edit_status(edit.status, reached=unmet <= REACHED_SHARE), self.notes
        if unmet > REACHED_SHARE:
            notes = (*notes, f"On points of the surface that carried no target {100 * unmet:.2g} % of it is missed.")
        return replace(edit, status=status, notes=(*edit.notes, *notes))


def carriers(field: Field, points: int | SurfaceSample, targets_of: TargetsOf, *, seed: int = 0) -> Carriers:
    """Return the points that carry a target: as asked for, or more where the field's parameters act too locally.

    Args:
        field: The field before the edit.
        points: Number of points, or the sample itself, which is kept as it is.
        targets_of: From points and normals of the unedited surface to their target.
        seed: Seed of the draws.
    """
    sample = carrying_points(field, points, seed=seed)
    targets_of(sample.points, sample.normals).require_points_in_each_region(field.units)
    if not has_sparse_rows(field, sample.points):
        few = len(sample) < MANY_POINTS
        return Carriers(sample, sample_surface(field, JUDGES, seed=seed + 1) if few else None)
    others = sample_surface(field, OTHERS, seed=seed + 1)
    larger, unmet = _enough(field, sample, others, targets_of, seed)
    count = f"{len(sample):,} points are too few for the field, whose parameters act near their own place alone"
    if larger is sample:
        return Carriers(sample, others)
    if isinstance(points, SurfaceSample):
        return Carriers(sample, others, (f"{count}; about {len(larger):,} would do. Give a larger sample.",))
    if _is_enough(*unmet):
        return Carriers(larger, others, (f"{count}; {len(larger):,} were drawn.",))
    missed = f"on others of the surface {100 * unmet[1]:.2g} % of the target is out of their reach"
    return Carriers(larger, others, (f"{count}; {len(larger):,} were drawn, and {missed} still.",))


def _enough(
    field: Field, sample: SurfaceSample, others: SurfaceSample, targets_of: TargetsOf, seed: int
) -> tuple[SurfaceSample, tuple[float, float]]:
    """Return the sample, or the first larger one that is enough or the largest, and what is unmet there and beside."""
    while True:
        unmet = _unmet(field, sample, others, targets_of)
        if _is_enough(*unmet) or len(sample) >= MOST_POINTS:
            return sample, unmet
        sample = sample_surface(field, min(2 * len(sample), MOST_POINTS), seed=seed)


def _is_enough(own: float, others: float) -> bool:
    return others <= max(ALLOWED, ALLOWED_MULTIPLE * own)


def _unmet(field: Field, sample: SurfaceSample, others: SurfaceSample, targets_of: TargetsOf) -> tuple[float, float]:
    """Return the share of the target that the linear solution misses, at the sample's points and at others."""
    where, target, weights = _normal_target(sample, targets_of)
    energy = NormalTarget(where, target, weights)
    solution = assemble(StepProblem(DeformationSpace(field), [energy])).solve(relative_damping=RELATIVE_DAMPING)
    shares = []
    for points, wanted, w in ((where, target, weights), _normal_target(others, targets_of)):
        miss = normal_displacement(field, points, solution.x) - wanted
        size = float(w @ wanted.square())
        shares.append((float(w @ miss.square()) / size) ** 0.5 if size > 0 else 0.0)
    return shares[0], shares[1]


def _normal_target(sample: SurfaceSample, targets_of: TargetsOf) -> tuple[Tensor, Tensor, Tensor]:
    """Return the points that have a target, that along the normal, and their weights."""
    targets = targets_of(sample.points, sample.normals)
    used = targets.weights > 0
    along = (targets.displacement() * sample.normals).sum(dim=1)
    return sample.points[used], along[used], (sample.weights * targets.weights)[used]


def _unmet_after(edit: Edit, others: SurfaceSample) -> float:
    """Return the error after an edit, as `reached_target` measures it, at other points of the unedited surface."""
    assert edit.asked is not None
    error, (wanted, _) = edit.error_field(others), edit.asked(others.points, others.normals)
    moved = torch.isfinite(wanted).all(dim=1) & (wanted.norm(dim=1) > 0)
    area = others.weights[moved].sum()
    missed = torch.where(torch.isfinite(wanted).all(dim=1), error, torch.zeros_like(error))
    return float(((others.weights @ missed.square()) / area).sqrt()) if float(area) > 0 else 0.0
