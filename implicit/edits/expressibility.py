"""How much of a prescribed displacement a field can express, said before the edit.

An edit in k parts, each aiming at its share y j / k of the target, comes to

    X_j = (B^T W B + damping)^-1 (B^T W y j / k + damping X_(j-1)),    j = 1 .. k        [from eq. 4, 5 of the paper]

if the sensitivities B stay what they are on the surface before the edit. What B X_k lacks of y is the prediction: one
matrix and one factor, whatever the number of parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.geometric_parts import OFF_SURFACE_STRENGTH, GeometricOperation, PartSchedule
from implicit.edits.handles import Handle
from implicit.edits.targets import Goal, Rest, checked_handles
from implicit.evolve.edit import REACHED_SHARE, EditStatus, require_options
from implicit.evolve.evolve import first_solve
from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import normal_displacement
from implicit.surface.sampling import sample_surface


class Verdict(Enum):
    """What to expect of an edit; the value is the sentence a user reads."""

    YES = "The field can express this displacement."
    NO = "The field cannot express this displacement: a tenth or more of it will be missed; see where."


@dataclass(frozen=True, eq=False)
class Expressibility:
    """What a field can make of a target, predicted from its sensitivities before any edit.

    Attributes:
        points, normals, weights: A sample of the unedited surface, other points than the prediction was solved at.
        target: Normal displacement asked for at the points (N,); NaN where nothing was asked.
        error: Predicted achieved minus target over the largest target (N,), as Edit.error_field will be.
        rms, largest: Root mean square of the error over the area where something was asked, and its largest size.
        unmet: Root of the share of the squared target that will be missed: 0 for all met, 1 for nothing met.
        rank: Number of parameter directions that the target's points decide at this damping.
        condition: Of the damped system, estimated.
        damping: That the first part of the edit ends up with.
        parts: Equal sub-steps that were assumed.
        verdict: Whether to go on.
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
    parts: int
    verdict: Verdict

    @property
    def missed(self) -> Float[Tensor, "m d"]:
        """The points at which a tenth or more of the largest target will be missed, the worst first."""
        size = torch.nan_to_num(self.error).abs()
        order = size.argsort(descending=True)
        return self.points[order[size[order] >= REACHED_SHARE]]

    def sentence(self) -> str:
        """The prediction in words."""
        words = (
            f"{self.verdict.value} Predicted error {100 * self.rms:.2g} % rms, {100 * self.largest:.2g} % at most, of "
            f"the largest target; {100 * self.unmet:.2g} % of the target is out of reach, with {self.rank:.0f} of "
            f"the parameters' directions."
        )
        missed = self.missed
        if len(missed) == 0:
            return words
        share = float(self.weights.sum() * len(missed) / len(self.points))
        worst = ", ".join(f"{x:.2f}" for x in missed[0].tolist())
        return f"{words} A tenth or more is missed on an area of {share:.2g}, most at ({worst})."


def expressibility(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Rest = "fixed",
    *,
    parts: int = 16,
    points: int = 4000,
    damping: float | None = None,
    least_alignment: float = 0.0,
    off_surface_strength: float = OFF_SURFACE_STRENGTH,
    seed: int = 0,
) -> Expressibility:
    """Predict how much of a target a field can express, without editing it.

    Args:
        field: The field as it is.
        handles, rest, damping, least_alignment, off_surface_strength, seed: As for geometric_edit.
        parts: Equal sub-steps of the edit in mind. More of them come closer, for each corrects those before.
        points: Of the target; as many others judge the prediction.

    Returns:
        The prediction. It is linear: what the field learns by moving, it cannot know.

    Raises:
        ValueError: As for geometric_edit, or not even its first step can be taken.
    """
    require_options(field, damping=damping, seed=seed)
    listed = checked_handles(handles)
    require_whole("parts", parts)
    require_whole("points", points)
    require_positive("off_surface_strength", off_surface_strength, or_zero=True)

    def goal_of(points: Tensor, normals: Tensor) -> Goal:
        return Goal(listed, points, normals, rest, least_alignment=least_alignment)

    sample = sample_surface(field, points, seed=seed)
    goal_of(sample.points, sample.normals).require_points_in_each_region()
    schedule = PartSchedule.of(parts)
    operation = GeometricOperation(field, goal_of, sample, schedule, damping, off_surface_strength, None, seed)
    others = sample_surface(field, points, seed=seed + 1)
    wanted = goal_of(others.points, others.normals).wanted()
    target = (wanted * others.normals).sum(dim=1)
    told = torch.isfinite(target)
    solved = first_solve(field, operation, sample)
    if isinstance(solved, EditStatus):
        raise ValueError(f"No prediction can be made, for the edit ends before its first step. {solved.value}")
    system, solution = solved
    x = torch.zeros_like(system.right)
    for part in range(1, parts + 1):
        x = system.inverse(part * system.right + solution.damping * x)
    moved = normal_displacement(field, others.points, x.to(field.theta))
    scale = target[told].abs().max().clamp(min=torch.finfo(target.dtype).tiny)
    error = (moved - target) / scale
    weights = others.weights[told] / others.weights[told].sum()
    rms = float((weights @ error[told].square()).sqrt())
    size = float((weights @ (target[told] / scale).square()).sqrt())
    inside = told & (wanted.norm(dim=1) > 0)
    missed = float((others.weights[told] @ error[told].square()).sqrt())
    verdict = Verdict.YES if missed <= REACHED_SHARE * float(others.weights[inside].sum()) ** 0.5 else Verdict.NO
    return Expressibility(
        points=others.points,
        normals=others.normals,
        weights=others.weights,
        target=target,
        error=error,
        rms=rms,
        largest=float(error[told].abs().max()),
        unmet=rms / max(size, 1e-300),
        rank=solution.rank,
        condition=solution.condition,
        damping=solution.damping,
        parts=parts,
        verdict=verdict,
    )
