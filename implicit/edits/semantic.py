"""Semantic editing: prescribe how some points of a generated shape move; only its code changes, and the rest follows.

Each step goes some of the way r_i that the points still have before them, along the normals n_i that they have by now:

    minimise over d_z   sum_i (b(x_i) . d_z - n_i . r_i)^2  +  damping |d_z|^2  +  w |S^-1 (z + d_z - m)|^2

The sum runs over points, without quadrature weights, so that the damping is the paper's [section 4.2, appendix B]; the
last term, the pull to the Gaussian N(m, S S^T) of the training codes, is there if asked for. Points follow their whole
vector: what the field leaves open, the motion along the surface, they are moved by hand.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_between, require_positive, require_whole
from implicit.edits.code_prior import CodePrior
from implicit.edits.handles import Handle
from implicit.edits.targets import SummedTargets, checked_handles
from implicit.evolve.edit import Edit, EditStatus, Progress, require_options
from implicit.evolve.evolve import evolve
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field, require_field
from implicit.renamed import renamed
from implicit.sensitivity.boundary_sensitivity import BLOCK, value_and_gradients
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, NormalTarget
from implicit.step.problem import DampingRule, Projection, Row, StepProblem
from implicit.surface.projection import SLACK, newton_to_surface, placing_tolerance, require_on_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import farthest_order, sample_surface


@renamed(least_cosine="least_alignment")
def semantic_edit(
    field: Field,
    points: Float[Tensor, "i 3"],
    displacements: Float[Tensor, "i 3"],
    *,
    steps: int = 15,
    stride: float | None = None,
    damping: float | None = 0.1,
    prior: CodePrior | None = None,
    trust_region: float | None = None,
    least_alignment: float = 0.5,
    tolerance: float = 0.05,
    track: Float[Tensor, "m 3"] | None = None,
    progress: Progress | None = None,
) -> Edit:
    """Move points of a generated shape by moving its code.

    Args:
        field: Made by `decoder_field`, for its code alone or with some of its weights; any other field will do too.
        points: About 100 points (I, 3) on the surface; `prescribe` draws them in regions. All else is free.
        displacements: Where to, a vector a point; zeros hold a point.
        steps: Most steps.
        stride: No point aims farther than this in one step, a length; None is a fortieth of the field's size.
        damping: Penalty on |d_z|^2, the paper's lambda, for codes of spread one: 10 takes some hundred steps, 0.1 about
            ten, 0.001 three [appendix B]. None adapts it to the linearity error, which is quickest; but with little
            damping an edit that no shape of the family fits drives the code out to where there are none, so give a
            prior with it.
        prior: Pulls the code towards those of the training shapes.
        trust_region: Largest change of the code in one step, in the code's own unit; the damping is raised until the
            step stays within.
        least_alignment: Points whose normal is at a larger angle than this to their displacement are left out: the
            surface can slide through them without moving.
        tolerance: The edit stops when the root mean square of what is left along the normals is this part of the
            largest displacement along them.
        track: Further surface points (M, 3) to carry along, such as the rest of the shape.
        progress: Called as progress(step, steps, row) after each step: its number from 1, how many there are, and its
            row of the record, as in Edit.record.

    Returns:
        The edit. Its status is REACHED, or NOT_REACHED if the tolerance was not met in all steps; `wanted` is NaN at
        points that were left out. Rows of its history add "missed", what was left before the step as the tolerance
        measures it, "points_used", and with a prior "prior_distance".

    Raises:
        ValueError: Points and displacements do not match, are not finite, no point is to move along its normal, or an
            option is out of range.
        SurfaceError: A point is farther than a fiftieth of the field's size from the surface.
    """
    require_field(field)
    track = field.in_precision(track)
    require_options(field, damping=damping, track=track, progress=progress)
    _check_options(steps, stride, trust_region, least_alignment, tolerance)
    if prior is not None and not isinstance(prior, CodePrior):
        raise TypeError(f"prior must be None or a CodePrior, such as CodePrior.of(codes), but is {prior!r}.")
    start = _starting_points(field, points, displacements)
    stride = field.size / 40 if stride is None else stride
    operation = SemanticOperation(
        start, displacements, stride, damping, prior, trust_region, least_alignment, tolerance
    )
    wanted = torch.where(operation.used[:, None], displacements, torch.full_like(displacements, float("nan")))
    return evolve(field, operation, start, steps=steps, track=track, wanted=wanted, progress=progress)


def prescribe(
    field: Field, handles: Sequence[Handle] | Handle, points: int = 100, *, resolution: int = 64, seed: int = 0
) -> tuple[Float[Tensor, "i 3"], Float[Tensor, "i 3"]]:
    """Points in regions of the surface and their displacements, for `semantic_edit`.

    Args:
        handles: Regions and their displacements; the points are shared out evenly among them.
        points: How many in all; fewer where a region is so small that it holds fewer of 40 times as many drawn on the
            whole surface.
        resolution: Of the cells that the points are drawn from.
        seed: Of the random choice.

    Raises:
        ValueError: No point of the surface lies in a region.
    """
    handles = checked_handles(handles)
    require_whole("points", points)
    sample = sample_surface(field, 40 * points, resolution=resolution, seed=seed)
    chosen, displacements = [], []
    targets = SummedTargets(handles, sample.points, sample.normals)
    targets.require_points_in_each_region(field.units)
    for k, handle in enumerate(handles):
        share = points // len(handles) + (k < points % len(handles))
        x = sample.points[targets.handle_weights[k] > 0]
        x = x[farthest_order(x, min(share, len(x)))]
        chosen.append(x)
        displacements.append(SummedTargets([handle], x, field.normal(x)).displacement())
    return torch.cat(chosen), torch.cat(displacements)


def _starting_points(field: Field, points: Tensor, displacements: Tensor) -> SurfaceSample:
    points = field.require_points(points)
    if len(points) == 0:
        raise ValueError("points must hold at least one point, but are none. Draw some with prescribe.")
    if len(field.require_points(displacements, "displacements")) != len(points):
        raise ValueError(
            f"There must be a displacement for each of the {len(points)} points, but there are {len(displacements)}."
        )
    placed = require_on_surface(field, points, "points")
    return SurfaceSample(placed, field.normal(placed), torch.ones_like(placed[:, 0]))


def _check_options(
    steps: int, stride: float | None, trust_region: float | None, least_alignment: float, tolerance: float
) -> None:
    require_whole("steps", steps)
    for name, value in (("stride", stride), ("trust_region", trust_region)):
        if value is not None:
            require_positive(name, value, "length")
    require_between("least_alignment", least_alignment, 0, 1)
    require_positive("tolerance", tolerance)
    require_between("tolerance", tolerance, 0, 1)


@dataclass(frozen=True, eq=False)
class SemanticOperation:
    """The steps of semantic_edit, for the loop; see there. The memory is the space at the points of the next step.

    Attributes:
        sample: The points, with their normals at the start.
        displacements: Where to (I, D).
        stride: No point aims farther than this in one step, a length.
        damping, prior, trust_region, least_alignment, tolerance: Of semantic_edit.

    Raises:
        ValueError: No point is to move along its normal.
    """

    sample: SurfaceSample
    displacements: Tensor
    stride: float
    damping: float | None
    prior: CodePrior | None
    trust_region: float | None
    least_alignment: float
    tolerance: float

    columns = ("missed", "points_used", "prior_distance")

    def __post_init__(self) -> None:
        if not bool(self._moving.any()):
            raise ValueError(
                "No point is to move along its normal: every displacement is zero or at an angle with a cosine below "
                f"{self.least_alignment:.3g} to the normal. Choose points on the faces that are to move."
            )

    @cached_property
    def used(self) -> Tensor:
        """Mask (I,) of the points that carry the target: those whose displacement is along their normal, or zero."""
        return self._along(self.sample.normals)

    @cached_property
    def _goal(self) -> Tensor:
        return self.sample.points + self.displacements

    @cached_property
    def _moving(self) -> Tensor:
        return self.used & (self.displacements.norm(dim=1) > 0)

    @cached_property
    def _largest(self) -> float:
        """Largest displacement along the normals, a length."""
        return float((self.displacements * self.sample.normals).sum(dim=1)[self._moving].abs().max())

    def _along(self, normals: Tensor) -> Tensor:
        """Return whether each point's displacement has enough along the normal, or is zero."""
        along = (self.displacements * normals).sum(dim=1).abs()
        return along >= self.least_alignment * self.displacements.norm(dim=1)

    def start(self, field: Field, points: Tensor) -> PointSpace:
        """Return the space at the points of the first step."""
        return PointSpace(field, points, reach=0.01 * field.size)

    def finished(self, state: State[PointSpace], history: Sequence[Row]) -> EditStatus | None:
        """Return REACHED where what is left along the normals is within the tolerance."""
        if self._missed(self._goal - state.points, state.memory.normals) > self.tolerance:
            return None
        # Carried points may have slid to where nothing is left to do; the places that they were sent to may not.
        value, gradient = state.field.value_and_gradient(self._goal[self.used])
        left = float((value / gradient.norm(dim=1)).square().mean().sqrt())
        return EditStatus.REACHED if left <= self.tolerance * self._largest else None

    def step(self, state: State[PointSpace]) -> StepProblem:
        """Return the ridge regression of one step."""
        space, left = state.memory, self._goal - state.points
        share = min(1.0, self.stride / max(float(left.norm(dim=1).max()), 1e-300))
        aim = share * left
        inward = (aim * space.normals).sum(dim=1)
        counted = self.used & self._along(space.normals)
        energies: list[Energy] = [NormalTarget(state.points, inward, counted.to(inward))]
        row: Row = {"missed": self._missed(left, space.normals), "points_used": int(counted.sum())}
        if self.prior is not None:
            energies.append(self.prior.energy(state.field))
            row["prior_distance"] = self.prior.distance(state.field.theta[: len(self.prior.mean)])
        damping = self.damping
        if self.trust_region is not None:
            damping = _damping_within(self.trust_region, energies, space, damping)
        along = aim - inward[:, None] * space.normals
        return StepProblem(
            space, energies, DampingRule(damping), tangential_motion=along, project=self._project, row=row
        )

    def taken(self, state: State[PointSpace], taken: Taken) -> Outcome[PointSpace]:
        """Return the space that the projection has made at the points of the next step."""
        space = taken.space
        return Outcome(space if isinstance(space, PointSpace) else self.start(taken.field, taken.points))

    def _missed(self, left: Tensor, normals: Tensor) -> float:
        return float((left * normals).sum(dim=1)[self.used].square().mean().sqrt()) / self._largest

    def _project(self, field: Field, points: Tensor, reach: float) -> Projection:
        """Return points on the moved surface; the pass that this takes linearises the next step there, too."""
        own = len(self.displacements)
        space = PointSpace(field, points[:own], reach)
        if len(points) == own:
            return Projection(space.points, space.arrived, space)
        further, arrived = newton_to_surface(field, points[own:], reach=reach)
        return Projection(torch.cat([space.points, further]), torch.cat([space.arrived, arrived]), space)


class PointSpace(DeformationSpace):
    """The motions of a few points near the surface, from one forward and one backward pass.

    Values and gradients give a Newton step to the surface, and the sensitivities serve there as well: they differ from
    those at the points by the part of a radius of curvature that the step is. Where it is longer than CLOSE, the points
    are brought to the surface by further passes first.
    """

    CLOSE = 1e-3  # of the field's size; one Newton step then leaves some 1e-5 of it

    def __init__(self, field: Field, points: Tensor, reach: float) -> None:
        super().__init__(field)
        self.arrived = torch.ones(len(points), dtype=torch.bool, device=points.device)
        self._rows: Tensor | None = None
        for attempt in range(2):
            values, gradients, lengths = self._linearise(field, points)
            step = -(values / lengths)[:, None] * (gradients / lengths[:, None])
            longest = float(step.norm(dim=1).max())
            if attempt == 1 or longest <= self.CLOSE * field.size:
                break
            points, self.arrived = newton_to_surface(field, points, reach=reach)
        # Points that are on the surface already stay, so that what is known of them is known of the caller's.
        there = attempt == 1 or longest <= SLACK * placing_tolerance(field)
        self.points = points if there else points + step
        self.normals = gradients / lengths[:, None]

    def _linearise(self, field: Field, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        if len(points) * self.parameters > BLOCK:
            values, gradients = field.value_and_gradient(points)
            return values, gradients, field.gradient_length(gradients)
        values, gradients, rows = value_and_gradients(field, points)
        lengths = field.gradient_length(gradients)
        self._rows = -rows / lengths[:, None]
        return values, gradients, lengths

    def normal_rows(self, points: Tensor) -> Iterator[tuple[slice, Tensor]]:
        """Return the rows as the base does, but for the points that it knows."""
        if self._rows is not None and torch.equal(points, self.points):
            yield slice(0, len(points)), self._rows
        else:
            yield from super().normal_rows(points)

    def displacement(self, points: Tensor, x: Tensor) -> Tensor:
        """Return D as in the base, for the points that it knows from their rows."""
        if self._rows is not None and torch.equal(points, self.points):
            return self.normals * (self._rows @ x)[:, None]
        return super().displacement(points, x)


def _damping_within(radius: float, energies: Sequence[Energy], space: DeformationSpace, least: float | None) -> float:
    """The least damping, from `least` up, for which the step is no longer than the radius.

    With the singular values s of the rows and the target's parts c along them, |d_z|^2 = sum (s c / (s^2 + damping))^2,
    which falls with the damping.
    """
    blocks = [rows for energy in energies for rows in energy.rows(space)]
    roots = [rows.weights.double().sqrt() for rows in blocks]
    matrix = torch.cat([root[:, None] * rows.matrix.double() for root, rows in zip(roots, blocks, strict=True)])
    target = torch.cat([root * rows.target.double() for root, rows in zip(roots, blocks, strict=True)])
    U, s, _ = torch.linalg.svd(matrix, full_matrices=False)
    c = U.T @ target

    def length(damping: float) -> float:
        return float((s * c / (s * s + damping)).norm())

    floor = 1e-12 * float(s[0]) ** 2
    low = max(floor, 0.0 if least is None else least)
    if length(low) <= radius:
        return low
    high = low
    while length(high) > radius:
        high *= 4
    for _ in range(30):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if length(middle) > radius else (low, middle)
    return high
