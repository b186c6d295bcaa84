"""The outer loop of every edit. A step goes through six stations, and gives a new state and a row of the history:

    state the problem       what the operation minimises, over which displacements      implicit.step.problem
    assemble                the least squares, and the functionals to first order       implicit.step, .constraints
    solve                   at a damping at which the linear model holds                .trial, .damping
    correct the surface     to where the linear model sends it, in one piece            .trial, .pieces
    restore the constraints to their values, by Newton's method                         .constraints
    carry the points        along with the surface                                      here

Constraints enter each step as hard rows, with the gap measured so far as their right-hand side, and are then restored:
the row alone is exact only to first order (the paper's own flow loses 1.6 % of the volume in 86 steps by that). They
come after the correction, for they are what must hold at the end of the step.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Generic

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.evolve.constraints import ConstraintSet, Holding, Measurement, NotHeldError
from implicit.evolve.damping import AdaptiveDamping
from implicit.evolve.edit import Asked, Edit, EditStatus, Progress, edit_status, reached_target
from implicit.evolve.operation import Memory, Operation, State, Taken
from implicit.evolve.pieces import pieces, topology_row, undivided_part
from implicit.evolve.record import COLUMNS, StepRecord, history_row
from implicit.evolve.trial import Attempt, StepRefused, Trial, normal_correction
from implicit.field.field import Field
from implicit.sensitivity.shape_functionals import Functional
from implicit.step.least_squares import Factorised, Solution
from implicit.step.problem import Projection, Row, StepProblem, assemble, predicted_displacement
from implicit.surface.projection import newton_to_surface, require_on_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.topology import Topology

# Part of the tracked points of which more must reach the moved surface for a try to be accepted: where pieces may
# vanish a few are lost with them.
LEAST_ARRIVED, LEAST_ARRIVED_CHANGING = 0.995, 0.98

# Part of the tracked points that a step may lose where pieces may not vanish.
MOST_LOST = 0.02


def evolve(
    field: Field,
    operation: Operation[Memory],
    start: SurfaceSample,
    *,
    steps: int,
    constraints: Sequence[Functional] = (),
    resolution: int = 48,
    holding: Holding | None = None,
    changing: bool = False,
    track: Float[Tensor, "m d"] | None = None,
    wanted: Float[Tensor, "i d"] | None = None,
    asked: Asked | None = None,
    progress: Progress | None = None,
) -> Edit:
    """Take the steps of an operation.

    Args:
        start: Points of the surface to carry along.
        steps: The most steps to take.
        constraints: Functionals to hold, each at its target or, without one, at its value at the start.
        resolution: Of the quadrature that measures the constraints, unless `holding` says.
        holding: How they are held; None is by hard rows and Newton's method.
        changing: Whether the surface may change its topology. It is then measured in every step, and a tracked point
            that loses its sheet goes on from the nearest point of the surface.
        track: Further points on the surface to carry along.
        wanted: Displacement asked for at the starting points, for the error field.
        asked: The same for any points of the unedited surface; see Edit.
        progress: Called after each step with the step's number, the number of steps and its record.

    Returns:
        The edit as far as it went; its status says why it ended.

    Raises:
        ValueError: A functional has the name of a column of the records, or the field has no surface.
    """
    began = time.perf_counter()
    columns = (*COLUMNS, *operation.columns)
    held = ConstraintSet.of(field, constraints, holding or Holding(resolution=resolution), columns)
    loop = Loop(operation, held, changing)
    state = loop.start(field, start, track)
    history: list[Row] = []
    trail: list[Tensor] = []
    ended = EditStatus.DONE
    for _ in range(steps):
        finished = operation.finished(state, history)
        if finished is not None:
            ended = finished
            break
        try:
            step = loop.step(state)
        except StepRefused as refusal:
            ended = refusal.status
            break
        state = step.state
        history.append(step.row)
        trail.append(state.further)
        if progress is not None:
            progress(len(history), steps if step.steps is None else step.steps, step.row)
    if history:
        state, history[-1] = loop.polished(state, history[-1])
        trail[-1] = state.further
    edit = Edit(
        field=state.field,
        points=start.points,
        normals=start.normals,
        weights=start.weights,
        displacement=state.points - start.points,
        wanted=torch.full_like(start.points, float("nan")) if wanted is None else wanted,
        tracked=None if track is None else state.further,
        trail=() if track is None else tuple(trail),
        history=history,
        status=ended,
        seconds=time.perf_counter() - began,
        asked=asked,
    )
    notes = held.unresolved(history[-1]["constraint_error"]) if history else []
    return replace(edit, status=edit_status(ended, reached=reached_target(edit)), notes=tuple(notes))


def first_solve(
    field: Field, operation: Operation[Memory], start: SurfaceSample, resolution: int = 48
) -> tuple[Factorised, Solution] | EditStatus:
    """Return the first step's factored least squares and its solution at the damping that the linear model allows.

    The step is not taken. Where no damping allows it, the status of the edit that would end there comes back.
    """
    loop = Loop(operation, ConstraintSet.of(field, (), Holding(resolution=resolution)), changing=False)
    state = loop.start(field, start, None)
    attempt = loop.assembled(state, operation.step(state))
    try:
        trial, _ = attempt.accepted(state.damping)
    except StepRefused as refusal:
        return refusal.status
    return trial.factorised, trial.solution


@dataclass(frozen=True, eq=False)
class Step(Generic[Memory]):
    """A step that was taken.

    Attributes:
        state: After it.
        row: Of the history.
        steps: How many steps there will be, as far as the operation knows; None is as many as were asked for.
    """

    state: State[Memory]
    row: Row
    steps: int | None


@dataclass(frozen=True, eq=False)
class Moved:
    """A step on its way from the solve to the surface.

    Attributes:
        x: Its unknowns.
        part: Of the solved step, at most 1.
        measured: The surface after it, where it is measured.
        topology: The pieces of that, where they are watched.
    """

    x: Float[Tensor, " s"]
    part: float = 1.0
    measured: Measurement | None = None
    topology: Topology | None = None


@dataclass(frozen=True, eq=False)
class Loop(Generic[Memory]):
    """The part of an edit that stays the same from step to step.

    Attributes:
        operation: What the user asked for.
        constraints: What is held.
        changing: Whether the surface may change its topology.
    """

    operation: Operation[Memory]
    constraints: ConstraintSet
    changing: bool

    def start(self, field: Field, start: SurfaceSample, track: Float[Tensor, "m d"] | None) -> State[Memory]:
        """Return the state before the first step.

        Args:
            start, track: Points of the surface to carry along: the starting points, and the caller's.
        """
        points = start.points if track is None else torch.cat([start.points, require_on_surface(field, track, "track")])
        measured = self.constraints.first
        if measured is None and self.changing:
            measured = self.constraints.measure(field)
        topology = None
        if self.changing and measured is not None:
            topology = pieces(measured, field, self.constraints.holding.resolution)
        return State(
            field=field,
            step=0,
            tracked=points,
            starting=len(start.points),
            memory=self.operation.start(field, start.points),
            measured=measured,
            topology=topology,
            damping=AdaptiveDamping.of_precision(field.dtype),
        )

    def step(self, state: State[Memory]) -> Step[Memory]:
        """Return one step.

        Raises:
            StepRefused: It cannot be taken.
        """
        began = time.perf_counter()

        # State the problem
        problem = self.operation.step(state)
        field, space = state.field, problem.space

        # Assemble
        attempt = self.assembled(state, problem)

        # Solve at an adaptive damping
        clock = time.perf_counter()
        trial, damping = attempt.accepted(state.damping)
        seconds_solve = time.perf_counter() - clock

        with _refused_without_surface():
            # Correct the surface
            moved = self._corrected(state, problem, trial)
            # The next step is much like this one, and allows for what its own rows will miss.
            curved: tuple[float, ...] = ()
            if moved.measured is not None and moved.part == 1:
                curved = self.constraints.beyond_first_order(moved.measured, state.curved)

            # Restore the constraints
            moved = self._restored(state, problem, trial.factorised, moved)
            edited = field.with_theta(field.theta + space.split(moved.x)[0])

            # Carry the points
            predicted, projection = _carried(state, problem, trial, moved, edited)
            tracked = self._found_again(projection, moved.measured)

        # What the operation makes of it, and the record
        after = replace(
            state,
            field=edited,
            step=state.step + 1,
            tracked=tracked,
            measured=moved.measured,
            topology=moved.topology,
            damping=damping,
            correction=(trial.factorised.correction, space),
            curved=curved,
        )
        outcome = self.operation.taken(
            state,
            Taken(
                field=edited,
                points=after.points,
                part=moved.part,
                error=trial.error,
                solves=trial.solves,
                surface=None if moved.measured is None else moved.measured.surface,
                values=self.constraints.values(moved.measured),
                space=projection.space,
            ),
        )
        row = history_row(
            after.step,
            {**(problem.row or {}), **outcome.row},
            topology_row(state.topology, moved.topology),
            self.constraints.values(moved.measured),
            StepRecord.of(
                trial,
                constraint_gap=self.constraints.violation(moved.measured),
                constraint_error=self.constraints.error(),
                largest_motion=float(predicted.norm(dim=1).max()),
                d_theta_norm=float((edited.theta - field.theta).norm()),
                points_lost=int((~projection.arrived).sum()),
                seconds_solve=seconds_solve,
            ),
            time.perf_counter() - began,
        )
        return Step(replace(after, memory=outcome.memory), row, outcome.steps)

    def assembled(self, state: State[Memory], problem: StepProblem) -> Attempt:
        """Return a step's least squares with the functionals to first order, ready to be tried."""
        constraints = self.constraints
        linear = constraints.linearised(state.field, problem.space, state.measured, state.curved)
        system = assemble(problem)
        for rows in [] if linear is None else constraints.enforcement.penalty_rows(linear):
            system.add(rows)
        return Attempt(
            problem,
            system,
            constraints.enforcement,
            linear,
            state.tracked,
            constraints.holding.resolution,
            LEAST_ARRIVED_CHANGING if self.changing else LEAST_ARRIVED,
        )

    def _corrected(self, state: State[Memory], problem: StepProblem, trial: Trial) -> Moved:
        """Return the step that goes where the linear model sends it, or the part of that which divides nothing."""
        x = trial.x
        if problem.correction_weights is not None:
            x = x + normal_correction(problem, trial, state.points, problem.correction_weights)
        if state.topology is None:
            return Moved(x)
        whole = undivided_part(state.field, x, problem.space, self.constraints, state.topology)
        return Moved(whole.part * x, whole.part, whole.measured, whole.topology)

    def _restored(self, state: State[Memory], problem: StepProblem, factorised: Factorised, moved: Moved) -> Moved:
        """Return the step after which the functionals are at their targets, and the surface measured."""
        field, space, constraints = state.field, problem.space, self.constraints
        if constraints.enforcement.restores:
            x, measured = constraints.restore(field, moved.x, space, factorised.correction, measured=moved.measured)
            if not bool(torch.isfinite(x).all()):
                raise StepRefused(EditStatus.NOT_FINITE)
            return replace(moved, x=x, measured=measured)
        if constraints.functionals and moved.measured is None:
            edited = field.with_theta(field.theta + space.split(moved.x)[0])
            return replace(moved, measured=constraints.measure(edited))
        return moved

    def _found_again(self, projection: Projection, measured: Measurement | None) -> Tensor:
        """Return the tracked points after a step; those that lost their sheet go on from the nearest point.

        Raises:
            StepRefused: Too many are lost where no piece of the surface may vanish.
        """
        lost = ~projection.arrived
        if self.changing and measured is not None:
            points = projection.points.clone()
            points[lost] = _nearest(measured.sample.points, points[lost])
            return points
        if float(lost.double().mean()) > MOST_LOST:
            raise StepRefused(EditStatus.SURFACE_LOST)
        return projection.points

    def polished(self, state: State[Memory], row: Row) -> tuple[State[Memory], Row]:
        """Return the end of an edit with its values restored on the fine quadrature, and its last row with them.

        What cannot be restored stays as it is.
        """
        if not self.constraints.enforcement.restores or state.correction is None:
            return state, row
        (correction, space), field = state.correction, state.field
        try:
            x, measured, error = self.constraints.restore_at_end(field, space, correction)
            moved = field.with_theta(field.theta + space.split(x)[0])
            points, arrived = newton_to_surface(moved, state.tracked, reach=field.size / 100)
        except ValueError:
            return state, row
        gap = self.constraints.violation(measured)
        row = {**row, **self.constraints.values(measured), "constraint_gap": gap, "constraint_error": error}
        tracked = torch.where(arrived[:, None], points, state.tracked)
        return replace(state, field=moved, tracked=tracked, measured=measured), row


def _carried(
    state: State[Memory], problem: StepProblem, trial: Trial, moved: Moved, edited: Field
) -> tuple[Tensor, Projection]:
    """Return the predicted motion of the tracked points, and the points on the edited surface."""
    if moved.x is trial.x and problem.probe is None:
        return trial.predicted, trial.projection
    if problem.correction_weights is None:
        predicted = predicted_displacement(problem, moved.x, state.tracked)
    else:  # corrected so that the surface goes there
        predicted = trial.predicted
    return predicted, problem.project(edited, state.tracked + predicted, trial.reach)


@contextmanager
def _refused_without_surface() -> Iterator[None]:
    """Turn what measuring or restoring a surface refuses into why a step is not taken."""
    try:
        yield
    except NotHeldError as error:
        raise StepRefused(EditStatus.CONSTRAINT_NOT_HELD) from error
    except ValueError as error:
        raise StepRefused(EditStatus.SURFACE_LOST) from error


def _nearest(surface: Tensor, points: Tensor) -> Tensor:
    """Return the nearest of some surface points to each point."""
    return surface[torch.cat([torch.cdist(part, surface).argmin(dim=1) for part in points.split(1000)])]
