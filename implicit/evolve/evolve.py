"""The outer loop of every edit: sample, assemble, solve, update, restore the constraints, carry points along.

An operation states what one step minimises; what it holds fixed is a list of functionals. Constraints enter
each step as hard rows, with the gap measured so far as their right-hand side, and are then restored to their
value by Newton's method: the row alone is exact only to first order (the paper's own flow loses 1.6 % of the
volume in 86 steps by that). See implicit.evolve.constraints and implicit.evolve.damping.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.evolve.constraints import Guard, Holding, NotHeldError
from implicit.evolve.damping import Trust, miss
from implicit.evolve.edit import Asked, Edit, EditStatus, Progress, reached
from implicit.field.field import Field
from implicit.sensitivity.shape_functionals import Functional
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.least_squares import Factorised, LeastSquares, Solution, SolveStatus
from implicit.step.problem import Operation, Row, State, StepProblem, assemble, predicted_way
from implicit.surface.projection import newton_to_surface, require_on_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.topology import Topology, settled_topology

# Where Newton's method leaves points, relative to the field's size, with a margin.
PRECISION = {torch.float32: 4e-6, torch.float64: 4e-12}

# Corrections after a step whose surface is to settle.
SETTLINGS = 4


def evolve(
    field: Field,
    operation: Operation,
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
        constraints: Functionals to hold, each at its target or, without one, at its value at the start.
        resolution: Of the quadrature that measures the constraints, unless `holding` says.
        holding: How they are held; None is by hard rows and Newton's method.
        changing: Whether the surface may change its topology. It is then measured in every step, and a carried point
            that loses its sheet goes on from the nearest point of the surface.
        track: Further points on the surface to carry along.
        wanted: Displacement asked for at the starting points, for the error field.
        asked: The same for any points of the unedited surface; see Edit.
        progress: Called after each step with the step's number, the number of steps and its record.

    Returns:
        The edit as far as it went; its status says why it ended.
    """
    began = time.perf_counter()
    guard = Guard(field, constraints, holding or Holding(resolution=resolution), always=changing)
    loop = _Loop(field, operation, guard, changing)
    carried = start.points if track is None else torch.cat([start.points, require_on_surface(field, track, "track")])
    own = len(start.points)
    history: list[Row] = []
    trail: list[Tensor] = []
    status = EditStatus.DONE
    for step in range(steps):
        clock = time.perf_counter()
        state = State(field, step, carried[:own], None if guard.surface is None else guard.sample)
        if operation.finished(state, history):
            status = EditStatus.REACHED
            break
        taken = loop.take(state, carried)
        if isinstance(taken, EditStatus):
            status = taken
            break
        field, carried, row = taken
        trail.append(carried[own:])
        row = {"step": step + 1, **row, "seconds": time.perf_counter() - clock}
        history.append(row)
        if progress is not None:
            progress(step + 1, steps, row)
    if history:
        field, carried = loop.polish(field, carried, history[-1])
        trail[-1] = carried[own:]
    edit = Edit(
        field=field,
        points=start.points,
        normals=start.normals,
        weights=start.weights,
        displacement=carried[:own] - start.points,
        wanted=torch.full_like(start.points, float("nan")) if wanted is None else wanted,
        tracked=None if track is None else carried[own:],
        trail=() if track is None else tuple(trail),
        history=history,
        status=status,
        seconds=time.perf_counter() - began,
        asked=asked,
    )
    if status in (EditStatus.DONE, EditStatus.REACHED) and not reached(edit):
        edit = replace(edit, status=EditStatus.NOT_REACHED)
    return edit


def first_solve(
    field: Field, operation: Operation, start: SurfaceSample, resolution: int = 48
) -> tuple[Factorised, Solution] | EditStatus:
    """Solve the first step of an operation at the damping that its linearity allows, and do not take it."""
    guard = Guard(field, (), Holding(resolution=resolution), always=False)
    return _Loop(field, operation, guard, changing=False).solve(State(field, 0, start.points, None))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A step that may be taken: the moved field and the probed points on it."""

    solution: Solution
    x: Tensor  # the unknowns, after what the constraints took out
    moved: Field
    way: Tensor  # predicted motion of the probed points
    arrived_at: Tensor
    arrived: Tensor
    reach: float
    solves: int

    @property
    def factorised(self) -> Factorised:
        """What solved it; a failed solve makes no trial."""
        assert self.solution.factorised is not None
        return self.solution.factorised


class _Loop:
    """One step of an operation after the other."""

    def __init__(self, field: Field, operation: Operation, guard: Guard, changing: bool) -> None:
        self._operation, self._guard, self._changing = operation, guard, changing
        self._trust = Trust(field.dtype)
        self._last: tuple[Factorised, DeformationSpace] | None = None
        self._topology: Topology | None = None
        if changing:
            self._topology = self._pieces(field)
        self._found: Topology | None = None

    def solve(self, state: State) -> tuple[Factorised, Solution] | EditStatus:
        """A step's least squares, at the damping that its linearity allows; it is not taken."""
        problem = self._operation.step(state)
        system = assemble(problem)
        trial = self._trial(state, problem, system, None, state.points)
        return trial if isinstance(trial, EditStatus) else (trial.factorised, trial.solution)

    def take(self, state: State, carried: Tensor) -> tuple[Field, Tensor, Row] | EditStatus:
        """One step: the new field, the carried points on it, and the record; or why it was not taken."""
        field, guard = state.field, self._guard
        problem = self._operation.step(state)
        space = problem.space
        system = assemble(problem)
        fixed = guard.rows(field, space) if guard.constraints else None
        if fixed is not None and guard.holding.enforce == "penalty":
            system.add(guard.charge(*fixed))
            fixed = None
        clock = time.perf_counter()
        trial = self._trial(state, problem, system, fixed, carried)
        if isinstance(trial, EditStatus):
            return trial
        solved = time.perf_counter() - clock
        x, moved = trial.x, trial.moved
        way, arrived_at, arrived = trial.way, trial.arrived_at, trial.arrived
        part = 1.0
        if problem.settle is not None:
            x = x + _settled(problem, trial, state.points)
        try:
            if self._changing:
                part = self._undivided(field, x, space)
                x = part * x
            if guard.hard:
                x = guard.restore(field, x, trial.factorised, space, looked=self._changing)
                if not bool(torch.isfinite(x).all()):
                    return EditStatus.NOT_FINITE
            elif guard.surface is not None and not self._changing:
                guard.look(moved)
            moved = field.with_theta(field.theta + space.split(x)[0])
            if guard.hard or problem.probe is not None or problem.settle is not None:
                if problem.settle is None:
                    way = predicted_way(problem, x, carried)
                arrived_at, arrived = newton_to_surface(moved, carried + way, reach=trial.reach)
        except NotHeldError:
            return EditStatus.CONSTRAINT_NOT_HELD
        except ValueError:
            return EditStatus.SURFACE_LOST
        if self._changing:
            arrived_at[~arrived] = _nearest(guard.sample.points, arrived_at[~arrived])
        elif float((~arrived).double().mean()) > 0.02:
            return EditStatus.SURFACE_LOST
        self._last = trial.factorised, space
        missed, size = miss(trial.way, trial.arrived_at - _probed(problem, carried), trial.arrived)
        solution = trial.solution
        row = {
            **guard.record,
            "constraint_gap": guard.gap,
            "residual": solution.residual,
            "objective": solution.objective,
            "condition": solution.condition,
            "rank": solution.rank,
            "damping": solution.damping,
            "method": solution.method,
            "largest_motion": float(way.norm(dim=1).max()),
            "linearity_error": missed / max(size, 1e-300),
            "d_theta_norm": float((moved.theta - field.theta).norm()),
            "points_lost": int((~arrived).sum()),
            "solve_status": solution.status.value,
            "solves": trial.solves,
            "seconds_solve": solved,
        }
        after = (
            {}
            if problem.record is None or guard.surface is None
            else problem.record(moved, guard.surface, guard.record, part)
        )
        return moved, arrived_at, {**(problem.row or {}), **after, **self._turn(), **row}

    def _undivided(self, field: Field, x: Tensor, space: DeformationSpace) -> float:
        """The part of a step to take so that the surface does not fall into more pieces, and that surface measured.

        Where a step is longer than a thin part is wide, it leaves crumbs behind that a shorter one does not. If even
        a quarter of the step divides the surface, the division is no artefact, and the whole step is taken.
        """
        assert self._topology is not None
        for part in (1.0, 0.5, 0.25, 1.0):
            moved = field.with_theta(field.theta + space.split(part * x)[0])
            self._guard.look(moved)
            found = self._pieces(moved)
            if found.components <= self._topology.components:
                break
        self._found = found
        return part

    def _pieces(self, field: Field) -> Topology:
        surface = self._guard.surface
        assert surface is not None
        mesh = surface.vertices.double().cpu().numpy(), surface.faces.cpu().numpy()
        return settled_topology(field, mesh, self._guard.holding.resolution, self._topology)

    def _turn(self) -> Row:
        """The record of the surface's pieces, and of what became of them in this step."""
        if self._topology is None or self._found is None:
            return {}
        before, after = self._topology, self._found
        self._topology = after
        row: Row = {"components": after.components, "euler": after.euler}
        if (before.components, before.euler) != (after.components, after.euler):
            row["event"] = (
                f"Pieces {before.components} to {after.components}, Euler number {before.euler} to {after.euler}."
            )
        return row

    def polish(self, field: Field, carried: Tensor, row: Row) -> tuple[Field, Tensor]:
        """The last restoration, on the fine quadrature; what cannot be restored stays as it is."""
        if not self._guard.hard or self._last is None:
            return field, carried
        system, space = self._last
        try:
            x = self._guard.restore(field, field.theta.new_zeros(space.size), system, space, fine=True)
            moved = field.with_theta(field.theta + space.split(x)[0])
            arrived_at, arrived = newton_to_surface(moved, carried, reach=field.size / 100)
        except ValueError:
            return field, carried
        row |= {**self._guard.record, "constraint_gap": self._guard.gap}
        return moved, torch.where(arrived[:, None], arrived_at, carried)

    def _trial(
        self,
        state: State,
        problem: StepProblem,
        system: LeastSquares,
        fixed: tuple[Tensor, Tensor] | None,
        carried: Tensor,
    ) -> _Trial | EditStatus:
        """Solve, and solve again with more damping while the surface does not go where the linear model says.

        The assembled matrix serves every try, so that a further one costs a factorisation and a projection.
        """
        last: _Trial | EditStatus = EditStatus.UNSTABLE
        trust = self._trust
        damping = trust.begin(problem.first_damping)
        for solves in range(1, trust.tries + 1):
            solution, x = self._solve(system, problem, damping, fixed)
            if solution.status is SolveStatus.FAILED:
                return EditStatus.NOT_FINITE
            last, ratio = self._try(state.field, problem, solution, x, solves, carried)
            if ratio <= 1:
                trust.after(ratio, problem.least_damping)
                break
            if problem.damping is not None:
                break
            damping = trust.raise_damping()
        return last

    def _try(
        self,
        field: Field,
        problem: StepProblem,
        solution: Solution,
        x: Tensor,
        solves: int,
        carried: Tensor,
    ) -> tuple[_Trial | EditStatus, float]:
        """One step tried on the field, and how much it misses its prediction in units of what is allowed."""
        moved = field.with_theta(field.theta + problem.space.split(x)[0])
        if not bool(torch.isfinite(moved.theta).all()):
            return EditStatus.NOT_FINITE, math.inf
        points = _probed(problem, carried)
        way = predicted_way(problem, x, points)
        # A point may have to go as far again as it was predicted to; a cell more allows for small steps.
        reach = 2 * float(way.norm(dim=1).max()) + 2 * field.size / self._guard.holding.resolution
        try:
            arrived_at, arrived = problem.place(moved, points + way, reach=reach)
        except ValueError:
            return EditStatus.SURFACE_LOST, math.inf
        trial = _Trial(solution, x, moved, way, arrived_at, arrived, reach, solves)
        missed, size = miss(way, arrived_at - points, arrived)
        # A miss up to what the step leaves undone anyway is worth its smaller residual. But beyond a fifth of the
        # motion the linear model says too little: of constraints, of how thin parts vanish, of a target out of reach
        # (letters on a bracket were once pushed until the slope of the field fell to a seventh).
        undone = min(solution.residual, 0.2 * size)
        floor = PRECISION[field.dtype] * field.size  # to which points are placed on the surface at all
        allowed = max(problem.allowed_miss * size, floor, undone)
        kept = float(arrived.double().mean())
        return trial, missed / allowed if kept > (0.98 if self._changing else 0.995) else math.inf

    def _solve(
        self, system: LeastSquares, problem: StepProblem, relative: float, fixed: tuple[Tensor, Tensor] | None
    ) -> tuple[Solution, Tensor]:
        """The minimiser, and what the constraints leave of it."""
        damping = relative * system.trace() if problem.damping is None else problem.damping
        if fixed is None:
            solution = system.solve(damping)
            return solution, solution.x
        C, r = fixed
        if self._guard.holding.enforce == "projection":
            solution = system.solve(damping)
            return solution, solution.x - torch.linalg.pinv(C) @ (C @ solution.x)
        held = self._guard.binding(C, r, None)
        solution = system.solve(damping, (C[held], r[held]))
        broken = self._guard.binding(C, r, solution.x)
        if bool((broken & ~held).any()):
            solution = system.solve(damping, (C[broken], r[broken]))
        return solution, solution.x


def _settled(problem: StepProblem, trial: _Trial, points: Tensor) -> Tensor:
    """What to add to a step's unknowns so that the surface goes where the linear model sends the starting points.

    A step that minimises strain moves far along the surface, and where the normal turns on the way the surface misses
    by ripples that cost more strain than the whole motion. So the rest of the way is taken by Newton's method: normal
    motions, each a small least squares. It stops when a correction no longer halves what is left.
    """
    assert problem.settle is not None
    goal = points + trial.way[: len(points)]
    field, at, directions = trial.moved, trial.arrived_at[: len(points)], problem.space.directions
    change = torch.zeros_like(trial.x)
    left = float("inf")
    for _ in range(SETTLINGS):
        gap = ((goal - at) * field.normal(at)).sum(dim=1)
        size = float(problem.settle @ gap.square())
        if not size < 0.25 * left:
            break
        left = size
        space = DeformationSpace(field, directions=directions)
        step = assemble(StepProblem(space, [NormalTarget(at, gap, problem.settle)])).solve()
        moved = field.with_theta(field.theta + space.split(step.x)[0])
        arrived_at, arrived = newton_to_surface(moved, goal, reach=trial.reach)
        if not bool(arrived.all()):
            break
        field, at = moved, arrived_at
        change[: len(step.x)] += step.x
    return change


def _probed(problem: StepProblem, carried: Tensor) -> Tensor:
    return carried if problem.probe is None else problem.probe


def _nearest(surface: Tensor, points: Tensor) -> Tensor:
    """The nearest of some surface points to each point."""
    return surface[torch.cat([torch.cdist(part, surface).argmin(dim=1) for part in points.split(1000)])]
