"""The outer loop of every edit: sample, assemble, solve, update, restore the constraints, carry points along.

An operation states what one step minimises; what it holds fixed is a list of functionals. Constraints enter
each step as hard rows, with the gap measured so far as their right-hand side, and are then restored to their
value by Newton's method: the row alone is exact only to first order (the paper's own flow loses 1.6 % of the
volume in 86 steps by that).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.deformation import DeformationSpace
from implicit.energies import Energy, NormalTarget
from implicit.extraction import SurfaceError, newton_to_surface
from implicit.field import Field
from implicit.functionals import Functional
from implicit.solve import DENSE_LIMIT, LeastSquares, Solution, SolveStatus
from implicit.surface import SurfaceSample, surface_quadrature

Progress = Callable[[int, int, dict[str, Any]], None]
Row = dict[str, Any]


class EditStatus(Enum):
    """How an edit ended; the value is the sentence a user reads."""

    DONE = "All steps were taken."
    REACHED = "The stopping rule was met before the last step."
    NOT_REACHED = "All steps were taken, but the prescribed displacement was not reached; see the error field."
    NOT_FINITE = "Stopped before a step that would not be finite; the field is as it was before that step."
    SURFACE_LOST = "Stopped before a step after which the surface would vanish or leave the bounds of the field."
    CONSTRAINT_NOT_HELD = "Stopped before a step after which a constraint could not be restored to its tolerance."
    UNSTABLE = "Stopped because the steps grew beyond what a linear prediction holds for; take smaller steps."


@dataclass(frozen=True, eq=False)
class Edit:
    """An edited field and the evidence of how it came about.

    Attributes:
        field: The edited field. `field.write_back()` stores it in the module that the edit began from.
        points: Starting points (I, D) on the unedited surface, with their `normals` and quadrature `weights`.
        displacement: Of the starting points, to the end (I, D), a length.
        wanted: Displacement asked for at the starting points (I, D); NaN where nothing was asked.
        tracked: Where the `track` points of the caller ended (M, D), or None.
        history: One row a step: energies, constraint values, residuals, step norms, seconds.
        status: How it ended.
        seconds: Wall time.
    """

    field: Field
    points: Float[Tensor, "i d"]
    normals: Float[Tensor, "i d"]
    weights: Float[Tensor, " i"]
    displacement: Float[Tensor, "i d"]
    wanted: Float[Tensor, "i d"]
    tracked: Float[Tensor, "m d"] | None
    history: list[Row]
    status: EditStatus
    seconds: float

    def error_field(self) -> Float[Tensor, " i"]:
        """Achieved minus wanted normal displacement over the largest wanted one, at the starting points.

        Achieved is measured on the edited field: each point is put where it was asked to go, and its signed
        way from there to the edited surface is the error. NaN where nothing was asked.
        """
        asked = torch.isfinite(self.wanted).all(dim=1)
        error = torch.full_like(self.weights, float("nan"))
        if not bool(asked.any()):
            return error
        goal = self.points[asked] + self.wanted[asked]
        largest = (self.wanted[asked] * self.normals[asked]).sum(dim=1).abs().max()
        surface, arrived = newton_to_surface(self.field, goal, reach=self.field.size / 2)
        way = ((surface - goal) * self.field.normal(surface)).sum(dim=1)
        way = torch.where(arrived, way, torch.full_like(way, float("nan")))
        error[asked] = way / largest.clamp(min=torch.finfo(way.dtype).tiny)
        return error


@dataclass(frozen=True, eq=False)
class State:
    """Where an edit stands at the start of a step."""

    field: Field
    step: int
    points: Float[Tensor, "i d"]  # the starting points, carried along
    sample: SurfaceSample | None  # the quadrature of the current surface, where constraints need one


@dataclass(frozen=True, eq=False)
class StepProblem:
    """What one step minimises, over which displacements."""

    space: DeformationSpace
    energies: Sequence[Energy]
    damping: float | None = None  # fixed; None lets the loop choose it by the linearity error
    first_damping: float = 1e-7  # where that choice begins, relative to the trace of the normal matrix
    least_damping: float = 0.0  # how far it may fall in later steps, in the same unit
    allowed_miss: float = 0.02  # nonlinear part of the motion that is accepted, relative to the motion
    # Motion along the surface that the normal motion leaves open, of the carried points (all, tracked ones last).
    slide: Callable[[Tensor, Tensor], Tensor] | None = None
    # Brings the carried points, where they were predicted, onto the moved surface; takes and returns what Newton does.
    place: Callable[..., tuple[Tensor, Tensor]] = newton_to_surface
    row: Row | None = None  # what the operation adds to the record of the step


class Operation(Protocol):
    """What a user asked for, as the loop sees it."""

    def step(self, state: State) -> StepProblem:
        """The problem of this step."""

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        """Whether to stop before this step."""


def evolve(
    field: Field,
    operation: Operation,
    start: SurfaceSample,
    *,
    steps: int,
    constraints: Sequence[Functional] = (),
    resolution: int = 48,
    tolerance: float = 1e-8,
    track: Float[Tensor, "m d"] | None = None,
    wanted: Float[Tensor, "i d"] | None = None,
    progress: Progress | None = None,
) -> Edit:
    """Take the steps of an operation.

    Args:
        start: Points of the surface to carry along.
        constraints: Functionals to hold, each at its target or, without one, at its value at the start.
        resolution: Of the quadrature that measures the constraints.
        tolerance: Relative gap to which each constraint is restored after each step.
        track: Further points on the surface to carry along.
        wanted: Displacement asked for at the starting points, for the error field.
        progress: Called after each step with the step's number, the number of steps and its record.

    Returns:
        The edit as far as it went; its status says why it ended.
    """
    began = time.perf_counter()
    guard = _Guard(field, constraints, resolution, tolerance)
    trust = _Trust(field.dtype)
    carried = start.points if track is None else torch.cat([start.points, _on_surface(field, track)])
    own = len(start.points)
    history: list[Row] = []
    status = EditStatus.DONE
    for step in range(steps):
        clock = time.perf_counter()
        state = State(field, step, carried[:own], guard.sample)
        if operation.finished(state, history):
            status = EditStatus.REACHED
            break
        taken = _take(state, operation, guard, trust, carried)
        if isinstance(taken, EditStatus):
            status = taken
            break
        field, carried, row = taken
        row = {"step": step + 1, **row, "seconds": time.perf_counter() - clock}
        history.append(row)
        if progress is not None:
            progress(step + 1, steps, row)
    edit = Edit(
        field=field,
        points=start.points,
        normals=start.normals,
        weights=start.weights,
        displacement=carried[:own] - start.points,
        wanted=torch.full_like(start.points, float("nan")) if wanted is None else wanted,
        tracked=None if track is None else carried[own:],
        history=history,
        status=status,
        seconds=time.perf_counter() - began,
    )
    if status is EditStatus.DONE and not _reached(edit):
        edit = replace(edit, status=EditStatus.NOT_REACHED)
    return edit


def _reached(edit: Edit) -> bool:
    """Whether the root mean square of the error field is at most a tenth, where a displacement was asked for."""
    error = edit.error_field()
    asked = torch.isfinite(edit.wanted).all(dim=1)
    moved = asked & (edit.wanted.norm(dim=1) > 0)
    if not bool(moved.any()):
        return True
    return bool((error[asked] * edit.weights[asked].sqrt()).norm() <= 0.1 * edit.weights[moved].sum().sqrt())


def _take(
    state: State, operation: Operation, guard: _Guard, trust: _Trust, carried: Tensor
) -> tuple[Field, Tensor, Row] | EditStatus:
    """One step: the new field, the carried points on it, and the record; or why it was not taken."""
    field = state.field
    problem = operation.step(state)
    space = problem.space
    system = _assemble(problem)
    fixed = guard.rows(field, space.size)
    clock = time.perf_counter()
    trial = _trial(state, problem, system, fixed, trust, carried, 2 * field.size / guard.resolution)
    if isinstance(trial, EditStatus):
        return trial
    solved = time.perf_counter() - clock
    moved, way, arrived_at, arrived = trial.moved, trial.way, trial.arrived_at, trial.arrived
    if guard.constraints:
        restored = guard.restore(moved, system, space)
        if isinstance(restored, EditStatus):
            return restored
        x = torch.cat([restored.theta - field.theta, trial.solution.x[space.parameters :]])
        moved = restored
        try:
            way = _way(problem, x, carried)
            arrived_at, arrived = newton_to_surface(moved, carried + way, reach=trial.reach)
        except ValueError:
            return EditStatus.SURFACE_LOST
    if float((~arrived).double().mean()) > 0.02:
        return EditStatus.SURFACE_LOST
    miss, size = _miss(way, arrived_at - carried, arrived)
    solution = trial.solution
    row = {
        **guard.values,
        "constraint_gap": guard.gap,
        "residual": solution.residual,
        "objective": solution.objective,
        "condition": solution.condition,
        "rank": solution.rank,
        "damping": solution.damping,
        "method": solution.method,
        "largest_motion": float(way.norm(dim=1).max()),
        "linearity_error": miss / max(size, 1e-300),
        "d_theta_norm": float((moved.theta - field.theta).norm()),
        "points_lost": int((~arrived).sum()),
        "solve_status": solution.status.value,
        "solves": trial.solves,
        "seconds_solve": solved,
    }
    return moved, arrived_at, {**(problem.row or {}), **row}


def _assemble(problem: StepProblem) -> LeastSquares:
    """The step's least squares: its rows, or for a network too large for a matrix, their products."""
    space = problem.space
    if space.size <= DENSE_LIMIT:
        system = LeastSquares(space.size, space.field.theta)
        for energy in problem.energies:
            for rows in energy.rows(space):
                system.add(rows)
        return system
    # A sketch of the spectrum costs as many products as it has columns, each a forward and a backward pass: here
    # plain conjugate gradients are through with less. Each step sees what the last one missed, so 1e-4 is enough.
    system = LeastSquares(space.size, space.field.theta, method="cg", rank=0, tolerance=1e-4)
    for energy in problem.energies:
        if not isinstance(energy, NormalTarget):
            raise ValueError(
                f"With {space.size} unknowns (more than {DENSE_LIMIT}) only targets along the normal can be "
                f"solved for, but the step has a {type(energy).__name__} energy. Edit fewer parameters "
                '(Field(parameters=...)), or smooth with method="explicit".'
            )
        system.add_operator(energy.operator(space))
    return system


@dataclass(frozen=True, eq=False)
class _Trial:
    """A step that may be taken: the moved field and the carried points on it."""

    solution: Solution
    moved: Field
    way: Tensor  # predicted motion of the carried points
    arrived_at: Tensor
    arrived: Tensor
    reach: float
    solves: int


def _trial(
    state: State,
    problem: StepProblem,
    system: LeastSquares,
    fixed: tuple[Tensor, Tensor] | None,
    trust: _Trust,
    carried: Tensor,
    cell: float,
) -> _Trial | EditStatus:
    """Solve, and solve again with more damping while the surface does not go where the linear model says.

    The assembled matrix serves every try, so that a further one costs a factorisation and a projection.
    """
    field = state.field
    last: _Trial | EditStatus = EditStatus.UNSTABLE
    damping = trust.begin(problem.first_damping)
    for solves in range(1, trust.tries + 1):
        solution = system.solve(problem.damping, fixed, relative_damping=damping)
        if solution.status is SolveStatus.FAILED:
            return EditStatus.NOT_FINITE
        moved = field.with_theta(field.theta + problem.space.split(solution.x)[0])
        if not moved.require_finite(moved.theta):
            return EditStatus.NOT_FINITE
        way = _way(problem, solution.x, carried)
        # A point may have to go as far again as it was predicted to; a cell more allows for small steps.
        reach = 2 * float(way.norm(dim=1).max()) + cell
        good = False
        try:
            arrived_at, arrived = problem.place(moved, carried + way, reach=reach)
        except ValueError:
            last = EditStatus.SURFACE_LOST
        else:
            last = _Trial(solution, moved, way, arrived_at, arrived, reach, solves)
            miss, size = _miss(way, arrived_at - carried, arrived)
            # A larger miss than what the step leaves undone anyway is not worth the smaller residual; and where there
            # are constraints, beyond a fifth of the motion the linear model says too little about them.
            undone = solution.residual if fixed is None else min(solution.residual, 0.2 * size)
            allowed = max(problem.allowed_miss * size, undone)
            good = miss <= allowed and bool(arrived.double().mean() > 0.995)
            if good:
                trust.after(miss / allowed, problem.least_damping)
        if good or problem.damping is not None:
            break
        damping = trust.raise_damping()
    return last


def _way(problem: StepProblem, x: Tensor, carried: Tensor) -> Tensor:
    """Predicted motion of the carried points."""
    way = problem.space.displacement(carried, x)
    if problem.slide is not None:
        way = way + problem.slide(carried, problem.space.field.normal(carried))
    return way


def _miss(way: Tensor, achieved: Tensor, arrived: Tensor) -> tuple[float, float]:
    """Root mean squares of achieved minus predicted motion, and of the predicted one."""
    if not bool(arrived.any()):
        return float("inf"), 0.0
    rms = [float(v[arrived].square().sum(dim=1).mean().sqrt()) for v in (achieved - way, way)]
    return rms[0], rms[1]


class _Trust:
    """Damping relative to the trace, adapted as in Levenberg-Marquardt: the linear model decides."""

    tries = 16

    def __init__(self, dtype: torch.dtype) -> None:
        # Rounding in the normal matrix itself is about the precision times its trace.
        self._least = 1e-13 if dtype == torch.float64 else 1e-7
        self.damping: float | None = None

    def begin(self, damping: float) -> float:
        """The damping to try first: the last step's, or where the operation begins."""
        self.damping = max(damping if self.damping is None else self.damping, self._least)
        return self.damping

    def raise_damping(self) -> float:
        """After a try whose nonlinear part was too large."""
        assert self.damping is not None
        self.damping *= 10**0.5
        return self.damping

    def after(self, ratio: float, least: float) -> None:
        """After a good try, with the ratio of its nonlinear part to what is allowed."""
        assert self.damping is not None
        if ratio < 0.3:
            self.damping = max(self.damping / 10**0.5, self._least, least)


class _Guard:
    """Measures the constraints and brings them back to their targets."""

    iterations = 8

    def __init__(self, field: Field, constraints: Sequence[Functional], resolution: int, tolerance: float) -> None:
        self.constraints = tuple(constraints)
        self.resolution = resolution
        self._tolerance = tolerance
        self.sample: SurfaceSample | None = None
        self.gap = 0.0
        self.values: Row = {}
        names = [c.name for c in self.constraints]
        self._names = [n if names.count(n) == 1 else f"{n}_{k + 1}" for k, n in enumerate(names)]
        if self.constraints:
            self.sample = surface_quadrature(field, resolution)
            measured = self._measure(field)
            self._targets = [
                value if c.target is None else c.target for c, value in zip(self.constraints, measured, strict=True)
            ]
            # Relative to the target, or where that is zero (a centred moment, say) to the size of the integrand.
            size = float(self.sample.weights.sum())
            self._scales = [abs(t) if t != 0 else size for t in self._targets]

    def _measure(self, field: Field) -> list[float]:
        assert self.sample is not None
        values = [c.value(field, self.sample) for c in self.constraints]
        self.values = dict(zip(self._names, values, strict=True))
        return values

    def rows(self, field: Field, size: int) -> tuple[Tensor, Tensor] | None:
        """C and r of the step: the sensitivities, and how far each value is from its target."""
        if not self.constraints:
            return None
        gaps = [t - v for t, v in zip(self._targets, self._measure(field), strict=True)]
        return self._sensitivities(field, size), field.theta.new_tensor(gaps)

    def _sensitivities(self, field: Field, size: int) -> Tensor:
        assert self.sample is not None
        C = field.theta.new_zeros(len(self.constraints), size)
        for k, constraint in enumerate(self.constraints):
            C[k, : len(field.theta)] = constraint.sensitivity(field, self.sample)
        return C

    def restore(self, field: Field, system: LeastSquares, space: DeformationSpace) -> Field | EditStatus:
        """Newton's method on the measured values, each correction the one that disturbs the step least."""
        C: Tensor | None = None
        last = float("inf")
        for _ in range(self.iterations):
            try:
                self.sample = surface_quadrature(field, self.resolution)
            except ValueError:
                return EditStatus.SURFACE_LOST
            gaps = [t - v for t, v in zip(self._targets, self._measure(field), strict=True)]
            self.gap = max(abs(g) / s for g, s in zip(gaps, self._scales, strict=True))
            if self.gap <= self._tolerance:
                return field
            if C is None or self.gap > 0.1 * last:
                # Near the target one set of sensitivities serves all further corrections.
                C = self._sensitivities(field, space.size)
            last = self.gap
            change = system.correction(C, field.theta.new_tensor(gaps))[: space.parameters]
            if not field.require_finite(field.theta + change):
                return EditStatus.NOT_FINITE
            field = field.with_theta(field.theta + change)
        # Quadrature cells switch as the surface moves; in float32 that and rounding set a floor.
        return field if self.gap <= 1e3 * self._tolerance else EditStatus.CONSTRAINT_NOT_HELD


def _on_surface(field: Field, points: Tensor) -> Tensor:
    """Points to track, refused where they lie farther from the surface than a hundredth of the bounds."""
    points = field.require_points(points)
    placed, arrived = newton_to_surface(field, points, reach=0.02 * field.size)
    if not bool(arrived.all()):
        i = int((~arrived).nonzero()[0])
        raise SurfaceError(
            f"track points must lie on the surface, but points[{i}] = {points[i].tolist()} is farther than "
            f"{0.02 * field.size:.3g} from it. Move them there first with project_to_surface."
        )
    return placed


def total_energy(energies: Iterable[Energy], space: DeformationSpace, x: Tensor) -> float:
    """The value of some energies at a displacement, without solving."""
    return float(
        sum((rows.weights * (rows.matrix @ x - rows.target) ** 2).sum() for e in energies for rows in e.rows(space))
    )
