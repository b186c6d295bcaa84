"""One part of a geometric edit after the other: how far each goes, at which points, and what it minimises.

Part j takes the sample's points from where they are to goal(x, t_j), along the current normal [paper, eq. 4, 5]. The
fractions t_j are equal, or follow the linearisation error that each part measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.edits.enough_points import MOST_POINTS
from implicit.edits.targets import SummedTargets
from implicit.evolve.edit import EditStatus
from implicit.evolve.operation import Outcome, State, Taken
from implicit.evolve.trial import PRECISION
from implicit.field.field import Field
from implicit.sensitivity.closed_form import has_closed_form
from implicit.sensitivity.frame import tangential_component
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, NormalTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import sample_surface

# Where the edit itself chooses the parts: the first part's share of the field's size, the nonlinear share of a step's
# motion that is aimed at, and the most parts. The loop accepts a fiftieth; beyond, it damps the step, and what a damped
# step leaves undone costs more than another part would. Of a field with kinks the nonlinear share hardly falls with the
# part: on a ReLU network of 7 x 32, 4, 8, 12 and 24 parts leave 2.3, 2.2, 2.2 and 2.1 % between the points.
FIRST_PART = 1 / 160
LINEARITY = 0.012
MOST_PARTS = 24

# The same for an approach that finishing parts follow. A bump of 6 % on the cow is met within 0.1 % (root mean square,
# at other points) by 4 parts and 4 finishing ones, where 21 exact parts leave 0.09 %.
APPROACH_FIRST, APPROACH_LINEARITY = 1 / 40, 0.08

# Points that a part of an approach and a finishing part take at most, and off the surface; their damping at first,
# relative to the trace; and the part of their motion by which they may miss their prediction, which is made up for.
APPROACH_POINTS, FINISHING_POINTS = 1000, 2000
APPROACH_ERROR = 0.4
APPROACH_DAMPING, APPROACH_OFF_SURFACE = 1e-8, 250

# Finishing parts end where one leaves more than this share of what was missed before it, and after so many.
FINISHED, MOST_FINISHING = 0.8, 8

# Points are drawn anew where their spacing has grown so that one stands for this many times the area it began with.
MOST_STRETCH = 2.0

# Of the energy off the surface beside that on it: with it the bump of a tenth on the rocker arm leaves no stray piece
# in 16 parts, and the error on the surface is as without.
OFF_SURFACE_STRENGTH = 1e-2


@dataclass(frozen=True)
class PartSchedule:
    """The ends of the parts: equal parts, or parts as large as the linearisation error allows.

    Attributes:
        parts: How many equal ones; None chooses them as the edit goes.
        share: Of the whole displacement, in a part.
        now, then: Fractions of the whole at the start and at the end of the part that is next.
        kinked: Whether the gradient of the field jumps, so that parts are made no smaller for their linearity's sake.
        approaching: Whether the parts only approach the goal, and finishing parts follow.
    """

    parts: int | None
    share: float
    now: float
    then: float
    kinked: bool = False
    approaching: bool = False

    @classmethod
    def of(
        cls, parts: int | None, largest: float = 0.0, *, kinked: bool = False, approaching: bool = False
    ) -> PartSchedule:
        """Return the schedule before the first part.

        Args:
            parts: How many equal ones; None chooses them as the edit goes.
            largest: Longest displacement over the field's size, for parts that are chosen as the edit goes.
            kinked: Whether the gradient of the field jumps.
            approaching: Whether finishing parts follow.
        """
        first = APPROACH_FIRST if approaching else FIRST_PART
        share = 1.0 / parts if parts is not None else min(0.25, first / max(largest, 1e-12))
        return cls(parts, share, 0.0, share, kinked, approaching)

    def advance(self, step: int, error: float, solves: int) -> PartSchedule:
        """Return the schedule after a part was taken.

        Args:
            step: Parts taken, this one included.
            error: Linearisation error of the part, relative to its motion.
            solves: Tries that the part took.
        """
        now = self.then
        if self.parts is not None:
            return replace(self, now=now, then=(step + 1) / self.parts)
        # The nonlinear part of a step grows with its square, so its share of the motion grows with the step.
        damped = solves > 1 and step > 1  # the first part looks for its damping from below
        least = 1.0 if self.kinked else 0.5
        aim = APPROACH_LINEARITY if self.approaching else LINEARITY
        share = self.share * (0.5 if damped else min(1.5, max(least, aim / max(error, 1e-12))))
        left = 1.0 - now
        share = max(share, left / max(1, MOST_PARTS - step))
        more = math.ceil(left / share - 1e-9)
        # The parts that are left are equal, so that the last is no crumb.
        return replace(self, share=share, now=now, then=1.0 if more <= 1 else now + left / more)

    def count(self, done: int) -> int:
        """Return how many parts there will be, as far as is known.

        Args:
            done: Parts that will have been taken after the next.
        """
        if self.parts is not None:
            return self.parts
        return done + math.ceil((1.0 - self.then) / self.share - 1e-9)


@dataclass(frozen=True, eq=False)
class TargetPoints:
    """The points that carry the target.

    Attributes:
        sample: Of the unedited surface.
        goal: Where they are to be.
        coverage: How the moving ones lay among their neighbours.
        redrawn: Whether they were drawn anew, so that the loop does not carry them.
    """

    sample: SurfaceSample
    targets: SummedTargets
    coverage: _Coverage
    redrawn: bool = False


@dataclass(frozen=True, eq=False)
class GeometricMemory:
    """Memory of a geometric edit from part to part.

    Attributes:
        schedule: Of the part that is next.
        carriers: The points that carry the target.
        points: Where they are on the current surface (N, D).
        used: Which of them carry it (N,) bool.
        stretch: How many times the area it began with a moving point stood for before they were drawn anew.
        finished: Finishing parts taken.
        missed: Of the goal, at the points (root mean square), before the next finishing part, a length.
        ended: Whether there is nothing left to do.
    """

    schedule: PartSchedule
    carriers: TargetPoints
    points: Tensor
    used: Tensor
    stretch: float
    finished: int = 0
    missed: float = math.inf
    ended: bool = False


class GeometricOperation:
    """The operation that takes points of the surface to their goal, part by part.

    Args:
        field: At the start of the edit.
        targets_of: From points and normals of the unedited surface to their goal.
        sample: The points that carry the target at first, which the loop carries along.
        schedule: Before the first part.
        damping: Penalty on |d_theta|^2; None adapts it.
        off_surface_strength: Of the energy off the surface; 0 is none.
        track: The caller's points, or None.
        seed: Of the random points; part k uses seed + k.
    """

    columns = ("fraction", "points_used", "thinned")

    def __init__(
        self,
        field: Field,
        targets_of: Callable[[Tensor, Tensor], SummedTargets],
        sample: SurfaceSample,
        schedule: PartSchedule,
        damping: float | None,
        off_surface_strength: float,
        track: Tensor | None,
        seed: int,
    ) -> None:
        self._off_surface_strength = off_surface_strength
        self._origin, self._targets_of, self._schedule = field, targets_of, schedule
        self._damping, self._seed = damping, seed
        targets = targets_of(sample.points, sample.normals)
        self._first = TargetPoints(sample, targets, _Coverage(targets, sample))
        # The loop carries the points of the first sample and the tracked ones; they follow their goal.
        self._tracked = targets
        if track is not None:
            normals = torch.cat([sample.normals, field.normal(track)])
            self._tracked = targets_of(torch.cat([sample.points, track]), normals)

    def start(self, field: Field, points: Tensor) -> GeometricMemory:
        """Return the memory before the first part."""
        return self._ready(field, points, 0, self._schedule, self._first)

    def finished(self, state: State[GeometricMemory], history: Sequence[Row]) -> EditStatus | None:
        """Return that all is done where the whole displacement is, in fewer parts than there might have been."""
        return EditStatus.DONE if state.memory.ended else None

    def step(self, state: State[GeometricMemory]) -> StepProblem:
        """Return the problem of the next part."""
        field, memory = state.field, state.memory
        schedule = memory.schedule
        now, then = schedule.now, schedule.then
        share = self._share(memory, state.step)
        energy = _part_energy(field, memory.carriers, memory.points, share, then, memory.used)
        energies: list[Energy] = [energy]
        if self._off_surface_strength > 0:
            sample = SurfaceSample(energy.points, field.normal(energy.points), energy.weights)
            seed, strength = self._seed + state.step, self._off_surface_strength
            count = APPROACH_OFF_SURFACE if schedule.approaching else 500
            energies.append(off_surface(field, sample, energy.target, strength=strength, points=count, seed=seed))
        # A prescribed point follows its whole vector; the field sees only the part along the normal.
        ahead = self._tracked.positions(then) - self._tracked.positions(now)
        normals = field.normal(state.tracked)
        along = tangential_component(ahead, normals)
        row = {"fraction": then, "points_used": len(energy.points), "thinned": memory.stretch}
        rule = DampingRule(self._damping)
        if schedule.approaching:
            few = len(energy.points) < len(field.theta)
            floor = APPROACH_DAMPING if few and has_closed_form(field) else None
            rule = DampingRule(self._damping, first=APPROACH_DAMPING, allowed_error=APPROACH_ERROR, floor=floor)
        return StepProblem(DeformationSpace(field), energies, rule, tangential_motion=along, row=row)

    def _share(self, memory: GeometricMemory, step: int) -> Tensor:
        """Return which of the points carry the target in a part (N,) bool: of an approach, every k-th in turn."""
        if not memory.schedule.approaching:
            return memory.used
        most = APPROACH_POINTS if memory.schedule.now < 1.0 else FINISHING_POINTS
        turns = max(1, math.ceil(int(memory.used.sum()) / most))
        rank = memory.used.cumsum(0) - 1  # among those used
        return memory.used & (rank % turns == step % turns)

    def taken(self, state: State[GeometricMemory], taken: Taken) -> Outcome[GeometricMemory]:
        """Return the memory for the next part, and how many parts there will be."""
        done, memory = state.step + 1, state.memory
        if memory.schedule.now >= 1.0:
            after = self._finishing(taken, memory, memory.finished + 1)
            return Outcome(after, steps=done if after.ended else done + 1)
        schedule = memory.schedule.advance(done, taken.error.relative, taken.solves)
        if schedule.now < 1.0:
            after = self._ready(taken.field, taken.points, done, schedule, memory.carriers)
            return Outcome(after, steps=memory.schedule.count(done) + schedule.approaching)
        if not schedule.approaching:
            return Outcome(replace(memory, schedule=schedule, ended=True), steps=done)
        after = self._finishing(taken, replace(memory, schedule=schedule), 0)
        return Outcome(after, steps=done if after.ended else done + 1)

    def _finishing(self, taken: Taken, memory: GeometricMemory, finished: int) -> GeometricMemory:
        """Return the memory after a part that aimed at the goal: at its end, or before another finishing part."""
        points, used = _places(taken.field, taken.points, memory.carriers, 1.0)
        if not bool(used.any()):
            return replace(memory, ended=True)
        energy = _part_energy(taken.field, memory.carriers, points, used, 1.0)
        missed = float((energy.weights @ energy.target.square() / energy.weights.sum()).sqrt())
        placed = PRECISION[taken.field.dtype] * taken.field.size
        ended = missed > FINISHED * memory.missed or missed <= placed or finished >= MOST_FINISHING
        return replace(memory, points=points, used=used, finished=finished, missed=missed, ended=ended)

    def _ready(
        self, field: Field, points: Tensor, step: int, schedule: PartSchedule, carriers: TargetPoints
    ) -> GeometricMemory:
        """Return the memory before a part, with more points where those there were stand for too large an area."""
        places, used = _places(field, points, carriers, schedule.now)
        stretch = carriers.coverage.stretch(places, used)
        # Where points have lost their neighbours the stretch has no end, and more of them would find none either.
        count = int(min(stretch * len(carriers.sample), max(MOST_POINTS, len(carriers.sample))))
        if stretch > MOST_STRETCH and count > len(carriers.sample):
            sample = sample_surface(self._origin, count, seed=self._seed + step)
            targets = self._targets_of(sample.points, sample.normals)
            coverage = _Coverage(targets, sample, carriers.coverage.density)
            carriers = TargetPoints(sample, targets, coverage, redrawn=True)
            places, used = _places(field, points, carriers, schedule.now)
        return GeometricMemory(schedule, carriers, places, used, stretch)


def _places(field: Field, points: Tensor, carriers: TargetPoints, now: float) -> tuple[Tensor, Tensor]:
    """Return where the points are on the current surface, and which of them carry the target.

    Args:
        points: Where the loop has carried those of the first sample.
    """
    used = carriers.targets.weights > 0
    if not carriers.redrawn:
        return points, used
    # The parts before have taken every point to its goal but for what they missed, so that is where it is.
    places, arrived = newton_to_surface(field, carriers.targets.positions(now), reach=0.1 * field.size)
    return places, used & arrived


def _part_energy(
    field: Field, carriers: TargetPoints, points: Tensor, used: Tensor, then: float, of: Tensor | None = None
) -> NormalTarget:
    """Return E_C of one part: from where the points are to their goal after the part, along the normal.

    Args:
        used: Points that carry it (N,) bool.
        of: Those for whose area they stand; None is their own.
    """
    here = points[used]
    target = ((carriers.targets.positions(then)[used] - here) * field.normal(here)).sum(dim=1)
    weights = carriers.sample.weights * carriers.targets.weights
    stand_for = 1.0 if of is None else float(weights[of].sum() / weights[used].sum())
    return NormalTarget(here, target, stand_for * weights[used])


class _Coverage:
    """Multiple of the area it began with that a point of the moving part stands for, judged by its neighbours."""

    neighbours = 8

    def __init__(self, targets: SummedTargets, sample: SurfaceSample, density: float | None = None) -> None:
        self._moving = targets.prescribed & (targets.weights > 0)
        self._power = sample.points.shape[1] - 1
        own = len(sample) / float(sample.weights.sum())
        self.density = own if density is None else density  # points an area that the edit began with
        self._denser = own / self.density
        self._begun = self._spacing(sample.points, self._moving)

    def stretch(self, points: Tensor, used: Tensor) -> float:
        """Return the 90th percentile over the moving points, in areas of a point of the first sample."""
        if self._begun is None:
            return 1.0
        now = self._spacing(torch.where(used[:, None], points, torch.full_like(points, 1e6)), self._moving)
        if now is None:
            return 1.0
        return float(np.quantile((now / self._begun) ** self._power, 0.9)) / self._denser

    def _spacing(self, points: Tensor, moving: Tensor) -> NDArray[np.float64] | None:
        """Return the distance of each moving point from its farthest near neighbour; None where there are too few."""
        if int(moving.sum()) < 2 * self.neighbours:
            return None
        tree = cKDTree(points.double().cpu().numpy())
        near, _ = tree.query(points[moving].double().cpu().numpy(), k=self.neighbours + 1)
        return np.asarray(near)[:, -1]
