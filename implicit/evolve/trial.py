"""A step tried on the field: solved at growing damping until the surface goes where the linear model sends it.

    predicted = D(x),   achieved = projection(p + predicted) - p,   error = rms(achieved - predicted)

The assembled matrix serves every try, so that a further one costs a factorisation and a projection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.evolve.constraints import Enforcement, LinearConstraints
from implicit.evolve.damping import TRIES, AdaptiveDamping, LinearisationError, linearisation_error
from implicit.evolve.edit import EditStatus
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.least_squares import Factorised, LeastSquares, Solution, SolveStatus
from implicit.step.problem import Projection, StepProblem, assemble, predicted_displacement
from implicit.step.vertex_equations import VertexFactor
from implicit.surface.projection import newton_to_surface

# Where Newton's method leaves points, relative to the field's size, with a margin.
PRECISION = {torch.float32: 4e-6, torch.float64: 4e-12}

# Corrections after a step whose surface is to go just where the linear model sends it.
CORRECTIONS = 4

# Part of the motion, squared, to which the factor of a step corrects it: what is left costs no strain worth more. And
# above which least squares of their own make up what that factor leaves.
NEGLIGIBLE, WORTH = 1e-6, 1e-4

# Of a step's motion: what it leaves undone is no reason to let it miss its prediction by more than this.
UNDONE = 0.2


class StepRefused(Exception):  # noqa: N818, as an answer it is no error of the caller's
    """A step that is not taken.

    Attributes:
        status: Why.
    """

    def __init__(self, status: EditStatus) -> None:
        super().__init__(status.value)
        self.status = status


@dataclass(frozen=True, eq=False)
class Trial:
    """A step that may be taken, and the probed points on the surface after it.

    Attributes:
        solution: Of the least squares.
        x: The unknowns, after what the constraints took out.
        field: After the step.
        predicted: Motion of the probed points to first order (N, D).
        projection: The probed points on the moved surface.
        reach: How far the projection was let go, a length.
        error: How far the probed points missed their predicted motion.
        solves: Tries that it took.
    """

    solution: Solution
    x: Float[Tensor, " s"]
    field: Field
    predicted: Float[Tensor, "n d"]
    projection: Projection
    reach: float
    error: LinearisationError
    solves: int

    @property
    def factorised(self) -> Factorised:
        """Factored least squares that gave the step; a failed solve makes no trial."""
        assert self.solution.factorised is not None
        return self.solution.factorised


@dataclass(frozen=True, eq=False)
class Attempt:
    """The part that all tries of a step have in common.

    Attributes:
        problem: Of the step.
        system: Its least squares.
        enforcement: How the least squares meet the functionals that are held.
        linear: These to first order; None where nothing is held.
        tracked: Points carried along with the surface (N, D).
        resolution: Cells along the longest side of the bounds; points may miss their prediction by two of them.
        least_arrived: Part of the points of which more must reach the moved surface.
    """

    problem: StepProblem
    system: LeastSquares
    enforcement: Enforcement
    linear: LinearConstraints | None
    tracked: Float[Tensor, "n d"]
    resolution: int
    least_arrived: float

    @property
    def probed(self) -> Float[Tensor, "n d"]:
        """Points whose motion decides whether a try is accepted."""
        return self.tracked if self.problem.probe is None else self.problem.probe

    def accepted(self, damping: AdaptiveDamping) -> tuple[Trial, AdaptiveDamping]:
        """Return the first try that goes where the linear model sends it, or the last of all, and the damping after it.

        Args:
            damping: From the step before.

        Raises:
            StepRefused: The solve fails, or the last try loses the surface.
        """
        rule = self.problem.damping
        damping = damping.start(rule.first, rule.floor)
        last: Trial | EditStatus = EditStatus.UNSTABLE
        for solves in range(1, TRIES + 1):
            solution, x = self._solve(damping)
            if solution.status is SolveStatus.FAILED:
                raise StepRefused(EditStatus.NOT_FINITE)
            last = self._try(solution, x, solves)
            ratio = math.inf if isinstance(last, EditStatus) else self._ratio(last)
            if ratio <= 1:
                damping = damping.accept(ratio, rule.least)
                break
            if rule.fixed is not None:
                break
            damping = damping.increase()
        if isinstance(last, EditStatus):
            raise StepRefused(last)
        return last, damping

    def _solve(self, damping: AdaptiveDamping) -> tuple[Solution, Tensor]:
        fixed = self.problem.damping.fixed
        penalty = damping.current * self.system.trace() if fixed is None else fixed
        return self.enforcement.solve(self.system, penalty, self.linear)

    def _try(self, solution: Solution, x: Tensor, solves: int) -> Trial | EditStatus:
        """Return the step tried on the field, or why it cannot be."""
        problem, field = self.problem, self.problem.space.field
        moved = field.with_theta(field.theta + problem.space.split(x)[0])
        if not bool(torch.isfinite(moved.theta).all()):
            return EditStatus.NOT_FINITE
        predicted = predicted_displacement(problem, x, self.probed)
        # A point may have to go as far again as it was predicted to; two cells more allow for small steps.
        reach = 2 * float(predicted.norm(dim=1).max()) + 2 * field.size / self.resolution
        try:
            projection = problem.project(moved, self.probed + predicted, reach)
        except ValueError:
            return EditStatus.SURFACE_LOST
        error = linearisation_error(predicted, projection.points - self.probed, projection.arrived)
        return Trial(solution, x, moved, predicted, projection, reach, error, solves)

    def _ratio(self, trial: Trial) -> float:
        """Return how far a try misses its prediction, in units of what is allowed."""
        arrived = float(trial.projection.arrived.double().mean())
        if arrived <= self.least_arrived:
            return math.inf
        return trial.error.missed / allowed_miss(trial, self.problem.damping.allowed_error)


def allowed_miss(trial: Trial, allowed_error: float) -> float:
    """Return how far the probed points may miss their predicted motion, a length (root mean square).

    A miss up to what the step leaves undone anyway is worth its smaller residual. But beyond a fifth of the motion the
    linear model says too little: of constraints, of how thin parts vanish, of a target out of reach (letters on a
    bracket were once pushed until the slope of the field fell to a seventh).

    Args:
        allowed_error: Part of the motion that is allowed in any case.
    """
    size = trial.error.size
    undone = min(trial.solution.residual, UNDONE * size)
    floor = PRECISION[trial.field.dtype] * trial.field.size  # to which points are placed on the surface at all
    return max(allowed_error * size, floor, undone)


def normal_correction(
    problem: StepProblem, trial: Trial, points: Float[Tensor, "i d"], weights: Float[Tensor, " i"]
) -> Float[Tensor, " s"]:
    """Return what to add to a step's unknowns so that the surface goes where the linear model sends some points.

    A step that minimises strain moves far along the surface, and where the normal turns on the way the surface misses
    by ripples that cost more strain than the whole motion. So the rest of the motion is made up by Newton's method:
    normal motions, each a small least squares, or with motion free at each vertex by the factor of the step again. It
    stops when a correction no longer halves what is left; one that makes it more is left out.

    Args:
        problem: Of the step.
        trial: The step; its probed points begin with these.
        points: Starting points at the start of the step.
        weights: Of the points in the least squares.
    """
    count = len(points)
    goal = points + trial.predicted[:count]
    field, at = trial.field, trial.projection.points[:count]
    change = before = torch.zeros_like(trial.x)
    left, moved_by = float("inf"), float(weights @ trial.predicted[:count].square().sum(dim=1))
    factor = trial.factorised.factor if isinstance(trial.factorised.factor, VertexFactor) else None
    for number in range(CORRECTIONS + 1):
        gap = ((goal - at) * field.normal(at)).sum(dim=1)
        size = float(weights @ gap.square())
        stalled = not size < 0.25 * left
        if stalled and factor is not None and size > WORTH * moved_by:
            factor, stalled = None, False
        if stalled and size > left:
            return before
        if number == CORRECTIONS or stalled or (factor is not None and size < NEGLIGIBLE * moved_by):
            break
        left, before = size, change
        step = _normal_step(problem, factor, field, at, gap, weights)
        moved = field.with_theta(field.theta + problem.space.basis.change(step))
        arrived_at, arrived = newton_to_surface(moved, goal, reach=trial.reach)
        if not bool(arrived.all()):
            break
        field, at = moved, arrived_at
        change = change.clone()
        change[: len(step)] += step
    return change


def _normal_step(
    problem: StepProblem,
    factor: VertexFactor | None,
    field: Field,
    at: Float[Tensor, "i d"],
    gap: Float[Tensor, " i"],
    weights: Float[Tensor, " i"],
) -> Float[Tensor, " k"]:
    """Return the unknowns of the normal part that move points of a field's surface along its normals by some gaps."""
    if factor is not None:
        return factor.fitted(gap)
    space = DeformationSpace(field, basis=problem.space.basis)
    return assemble(StepProblem(space, [NormalTarget(at, gap, weights)])).solve().x
