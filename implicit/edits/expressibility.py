"""Part of a prescribed displacement that a field can express, said before the edit.

An edit in k steps, each aiming at its share y j / k of the target, comes to

    X_j = (B^T W B + damping)^-1 (B^T W y j / k + damping X_(j-1)),    j = 1 .. k        [from eq. 4, 5 of the paper]

if the sensitivities B stay what they are on the surface before the edit. What B X_k lacks of y is the prediction: one
matrix and one factor, whatever the number of steps.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.enough_points import carriers
from implicit.edits.geometric_parts import OFF_SURFACE_STRENGTH, GeometricOperation, PartSchedule
from implicit.edits.handles import Handle
from implicit.edits.targets import Rest, SummedTargets, checked_handles
from implicit.evolve.edit import REACHED_SHARE, EditStatus, require_options
from implicit.evolve.evolve import first_solve
from implicit.field.field import Field
from implicit.renamed import renamed
from implicit.sensitivity.boundary_sensitivity import normal_displacement
from implicit.step.least_squares import Solution
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import sample_surface


class Verdict(Enum):
    """Answer to whether a field can take an edit; the value is the sentence a user reads."""

    YES = "The field can express this displacement."
    NO = "The field cannot express this displacement: a tenth or more of it will be missed; see where."


@dataclass(frozen=True, eq=False, repr=False)
class Expressibility:
    """Prediction of how much of a target a field can express, from its sensitivities before any edit.

    Attributes:
        points, normals, weights: A sample of the unedited surface, other points than the prediction was solved at.
        target: Normal displacement that is the target at the points (N,), a length; NaN where there is none.
        error: Predicted achieved minus target over the largest target (N,), as Edit.error_field will be.
        rms, largest: Root mean square of the error over the area that has a target, and its largest size.
        unmet: Root of the share of the squared target that will be missed: 0 for all met, 1 for nothing met.
        rank: Number of parameter directions that the target's points decide at this damping; NaN where the solve is
            iterative and nothing tells it, and `sentence` then leaves it out.
        condition: Estimated condition number of the damped system.
        damping: Damping that the first step of the edit ends up with.
        steps: Number of equal sub-steps that were assumed.
        verdict: YES to go on, NO where a tenth or more of the target will be missed.
    """

    points: Float[Tensor, "n d"]
    normals: Float[Tensor, "n d"]
    weights: Float[Tensor, " n"]
    target: Float[Tensor, " n"]
    error: Float[Tensor, " n"]
    rms: float
    largest: float
    unmet: float
    rank: float
    condition: float
    damping: float
    steps: int
    verdict: Verdict

    def __repr__(self) -> str:
        count, dimension = self.points.shape
        precision = str(self.points.dtype).removeprefix("torch.")
        rank = "" if math.isnan(self.rank) else f"rank {self.rank:.0f}, "
        return (
            f"Expressibility: {self.verdict.name} in {self.steps} steps, at {count:,} points in {dimension}D "
            f"({precision}, {self.points.device})\n"
            f"  of the largest target: error {self.rms:.3g} rms, {self.largest:.3g} at most; of the target: "
            f"{self.unmet:.3g} unmet; {rank}damping {self.damping:.3g}"
        )

    @property
    def parts(self) -> int:
        """Return `steps`, of which this is the former name."""
        warnings.warn("Expressibility.parts is now Expressibility.steps.", DeprecationWarning, stacklevel=2)
        return self.steps

    @property
    def missed(self) -> Float[Tensor, "m d"]:
        """Return the points at which a tenth or more of the largest target will be missed, the worst first (M, D)."""
        size = torch.nan_to_num(self.error).abs()
        order = size.argsort(descending=True)
        return self.points[order[size[order] >= REACHED_SHARE]]

    def sentence(self) -> str:
        """Return the prediction in words."""
        directions = "" if math.isnan(self.rank) else f", with {self.rank:.0f} of the parameters' directions"
        words = (
            f"{self.verdict.value} Predicted error {100 * self.rms:.2g} % rms, {100 * self.largest:.2g} % at most, of "
            f"the largest target; {100 * self.unmet:.2g} % of the target is out of reach{directions}."
        )
        missed = self.missed
        if len(missed) == 0:
            return words
        share = float(self.weights.sum() * len(missed) / len(self.points))
        worst = ", ".join(f"{x:.2f}" for x in missed[0].tolist())
        return f"{words} A tenth or more is missed on an area of {share:.2g}, most at ({worst})."


@renamed(parts="steps")
def expressibility(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Rest = "fixed",
    *,
    steps: int = 16,
    points: int = 4000,
    damping: float | None = None,
    least_alignment: float = 0.0,
    off_surface_strength: float = OFF_SURFACE_STRENGTH,
    seed: int = 0,
) -> Expressibility:
    """Predict how much of a target a field can express, without editing it.

    Args:
        field: The field as it is.
        handles, rest, damping, least_alignment, off_surface_strength, seed: Options of geometric_edit.
        steps: Number of equal sub-steps of the edit in mind. More of them come closer, for each corrects those before.
        points: Number of points that carry the target, of a grid more where it needs them, as in geometric_edit; as
            many others as were asked for judge the prediction.

    Returns:
        The prediction. It is linear: what the field learns by moving, it cannot know.

    Raises:
        ValueError: As for geometric_edit, or not even its first step can be taken.
    """
    require_options(field, damping=damping, seed=seed)
    listed = checked_handles(handles)
    require_whole("steps", steps)
    require_whole("points", points)
    require_positive("off_surface_strength", off_surface_strength, or_zero=True)
    targets_of = partial(SummedTargets, listed, rest=rest, least_alignment=least_alignment)
    sample = carriers(field, points, targets_of, seed=seed).sample
    schedule = PartSchedule.of(steps)
    others = sample_surface(field, points, seed=seed + 1)
    displacement = targets_of(others.points, others.normals).target()
    # Repeated inverses cancel as many digits as the damping lies below the trace: more than float32 has.
    precise, exact = field.to(torch.float64), sample.to(torch.float64)
    operation = GeometricOperation(precise, targets_of, exact, schedule, damping, off_surface_strength, None, seed)
    solved = first_solve(precise, operation, exact)
    if isinstance(solved, EditStatus):
        raise ValueError(f"No prediction can be made, for the edit ends before its first step. {solved.value}")
    system, solution = solved
    x = torch.zeros_like(system.right)
    for step in range(1, steps + 1):
        x = system.inverse(step * system.right + solution.damping * x)
    moved = normal_displacement(precise, others.points.double(), x.to(precise.theta)).to(field.dtype)
    return _judged(others, displacement, moved, solution, steps)


def _judged(
    sample: SurfaceSample,
    displacement: Float[Tensor, "n d"],
    moved: Float[Tensor, " n"],
    solution: Solution,
    steps: int,
) -> Expressibility:
    """Return what is to be thought of points that move by so much along the normal, of the displacement targeted."""
    target = (displacement * sample.normals).sum(dim=1)
    targeted = torch.isfinite(target)
    scale = target[targeted].abs().max().clamp(min=torch.finfo(target.dtype).tiny)
    error = (moved - target) / scale
    weights = sample.weights[targeted] / sample.weights[targeted].sum()
    rms = float((weights @ error[targeted].square()).sqrt())
    size = float((weights @ (target[targeted] / scale).square()).sqrt())
    inside = targeted & (displacement.norm(dim=1) > 0)
    missed = float((sample.weights[targeted] @ error[targeted].square()).sqrt())
    verdict = Verdict.YES if missed <= REACHED_SHARE * float(sample.weights[inside].sum()) ** 0.5 else Verdict.NO
    return Expressibility(
        points=sample.points,
        normals=sample.normals,
        weights=sample.weights,
        target=target,
        error=error,
        rms=rms,
        largest=float(error[targeted].abs().max()),
        unmet=rms / max(size, 1e-300),
        rank=solution.rank,
        condition=solution.condition,
        damping=solution.damping,
        steps=steps,
        verdict=verdict,
    )
