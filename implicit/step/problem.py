"""One step of an edit: what an operation states of it, and the least squares that this makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.closed_form import has_closed_form
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, FieldTarget, NormalTarget, united
from implicit.step.least_squares import DENSE_LIMIT, LeastSquares
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import MeshedSample, SurfaceSample

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class State:
    """Where an edit stands at the start of a step."""

    field: Field
    step: int
    points: Float[Tensor, "i d"]  # the starting points, carried along
    sample: SurfaceSample | None  # the quadrature of the current surface, where it is measured


@dataclass(frozen=True, eq=False)
class StepProblem:
    """What one step minimises, over which displacements."""

    space: DeformationSpace
    energies: Sequence[Energy]
    damping: float | None = None  # fixed; None lets the loop choose it by the linearity error
    first_damping: float = 1e-7  # where that choice begins, relative to the trace of the normal matrix
    least_damping: float = 0.0  # how far it may fall in later steps, in the same unit
    allowed_miss: float = 0.02  # nonlinear part of the motion that is accepted, relative to the motion
    # Weights of the starting points by which the surface is brought to where the linear model sends them, see _settled.
    settle: Float[Tensor, " i"] | None = None
    probe: Tensor | None = None  # points whose motion decides whether the step is trusted; None: the carried ones
    # Motion along the surface that the normal motion leaves open, of the carried points (all, tracked ones last).
    slide: Callable[[Tensor, Tensor], Tensor] | None = None
    # Brings the carried points, where they were predicted, onto the moved surface; takes and returns what Newton does.
    place: Callable[..., tuple[Tensor, Tensor]] = newton_to_surface
    row: Row | None = None  # what the operation adds to the record of the step
    # The same, of the surface after the step, given what is held and the part of the step that was taken.
    record: Callable[[Field, MeshedSample, Row, float], Row] | None = None


class Operation(Protocol):
    """What a user asked for, as the loop sees it."""

    def step(self, state: State) -> StepProblem:
        """The problem of this step."""

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        """Whether to stop before this step."""


def predicted_way(problem: StepProblem, x: Tensor, points: Tensor) -> Tensor:
    """Predicted motion of points."""
    way = problem.space.displacement(points, x)
    if problem.slide is not None:
        way = way + problem.slide(points, problem.space.field.normal(points))
    return way


def assemble(problem: StepProblem) -> LeastSquares:
    """The step's least squares: its rows, or their products where these cost less or the rows would not fit."""
    space, energies = problem.space, problem.energies
    if space.size <= DENSE_LIMIT and not _is_cheaper_by_products(problem):
        system = LeastSquares(space.size, space.field.theta)
        for energy in energies:
            for rows in energy.rows(space):
                system.add(rows)
        return system
    # A sketch of the spectrum costs as many products as it has columns, each a forward and a backward pass: here
    # plain conjugate gradients are through with less. Each step sees what the last one missed, so 1e-4 is enough.
    system = LeastSquares(space.size, space.field.theta, rank=0, tolerance=1e-4)
    targets: list[NormalTarget | FieldTarget] = []
    for energy in energies:
        if not isinstance(energy, (NormalTarget, FieldTarget)):
            raise ValueError(
                f"With {space.size} unknowns (more than {DENSE_LIMIT}) only targets along the normal and of the field "
                f"can be solved for, but the step has a {type(energy).__name__} energy. Edit fewer parameters "
                '(Field(parameters=...)), or smooth with method="explicit".'
            )
        targets.append(energy)
    for target in united(space.field, targets):
        system.add_operator(target.operator(space))
    return system


def _is_cheaper_by_products(problem: StepProblem) -> bool:
    """Whether all are targets of a field with a closed form, at fewer points than unknowns and tied to nothing.

    The products of their rows with each other then come from those of the layers (implicit.sensitivity.closed_form).
    """
    space, count = problem.space, 0
    if space.directions is not None or not has_closed_form(space.field):
        return False
    for energy in problem.energies:
        if not isinstance(energy, NormalTarget) and not (isinstance(energy, FieldTarget) and energy.tied is None):
            return False
        count += len(energy.target)
    return count < space.size
