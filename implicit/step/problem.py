"""One step of an edit: what an operation states of it, and the least squares that this makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.closed_form import has_closed_form
from implicit.sensitivity.sparse_rows import has_sparse_rows
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, FieldTarget, NormalTarget, united
from implicit.step.least_squares import DENSE_LIMIT, LeastSquares
from implicit.step.vertex_equations import vertex_equations
from implicit.step.vertex_motion import VertexMotion
from implicit.surface.projection import newton_to_surface

Row = dict[str, Any]

# Dampings from which products of rows in float64 may be summed in single precision, relative to their trace.
LEAST_SINGLE = 1e-9


@dataclass(frozen=True)
class DampingRule:
    """Rule by which the damping of a step is found.

    Attributes:
        fixed: Penalty on the squares of the unknowns; None adapts it to the linearisation error.
        first: Where that begins, relative to the trace of the normal matrix.
        least: What it may fall to in later steps, in the same unit.
        allowed_error: Part of the motion by which the surface may miss its prediction.
        floor: What it never falls below; None is what the precision carries of a normal matrix. Products of rows with
            each other carry less.
    """

    fixed: float | None = None
    first: float = 1e-7
    least: float = 0.0
    allowed_error: float = 0.02
    floor: float | None = None


@dataclass(frozen=True, eq=False)
class Projection:
    """Points brought from where they were predicted onto a moved surface.

    Attributes:
        points: Where they ended (N, D).
        arrived: Which reached the surface (N,) bool.
        space: The moved field's deformation space, where the projection has linearised the field there anyway.
    """

    points: Float[Tensor, "n d"]
    arrived: Tensor
    space: DeformationSpace | None = None


Project = Callable[[Field, Tensor, float], Projection]


def newton_projection(field: Field, points: Float[Tensor, "n d"], reach: float) -> Projection:
    """Return points projected by Newton's method, none farther than the reach, a length."""
    return Projection(*newton_to_surface(field, points, reach=reach))


@dataclass(frozen=True, eq=False)
class StepProblem:
    """The energies that one step minimises, and the displacements it chooses from.

    Attributes:
        space: The displacements to choose from.
        energies: What is minimised, their sum.
        damping: How the penalty on the unknowns is found.
        tangential_motion: Motion along the surface beside the space's own, a tangent vector each (K, D) of the first K
            tracked points, a length; None is no such motion.
        correction_weights: Weights of the starting points (I,) by which normal motions bring the surface to where the
            linear model sends it, see implicit.evolve.trial.normal_correction; None leaves it where the step does.
        probe: Points (N, D) whose motion decides whether the step is trusted; None takes the tracked points.
        project: Brings the tracked points, where they were predicted, onto the moved surface.
        row: What the operation adds to the record of the step.
    """

    space: DeformationSpace
    energies: Sequence[Energy]
    damping: DampingRule = DampingRule()
    tangential_motion: Float[Tensor, "k d"] | None = None
    correction_weights: Float[Tensor, " i"] | None = None
    probe: Float[Tensor, "n d"] | None = None
    project: Project = newton_projection
    row: Row | None = None

    def __post_init__(self) -> None:
        if self.probe is not None and (self.correction_weights is not None or self.tangential_motion is not None):
            raise ValueError("correction_weights and tangential_motion are of tracked points, so they take no probe.")


def predicted_displacement(
    problem: StepProblem, x: Float[Tensor, " s"], points: Float[Tensor, "n d"]
) -> Float[Tensor, "n d"]:
    """Return the motion that the unknowns x give the tracked points, or others of the surface, to first order."""
    displacement = problem.space.displacement(points, x)
    along = problem.tangential_motion
    if along is None:
        return displacement
    return torch.cat([displacement[: len(along)] + along, displacement[len(along) :]])


def assemble(problem: StepProblem) -> LeastSquares:
    """Return the step's least squares: its rows, sparse or dense, or their products where they cost less or fit alone.

    Raises:
        ValueError: There are too many unknowns for rows, and an energy that has no products.
    """
    space, energies = problem.space, problem.energies
    if isinstance(space, VertexMotion):
        return LeastSquares.of(vertex_equations(space, energies))
    if _is_sparse(problem):
        system = LeastSquares(space.size, space.field.theta, tolerance=1e-6, sparse=True)
        for target in united(space.field, _targets(problem)):
            system.add(target.sparse_rows(space))
        return system
    if space.size <= DENSE_LIMIT and not _is_cheaper_by_products(problem):
        rule = problem.damping
        single = (rule.least if rule.fixed is None else 0.0) >= LEAST_SINGLE
        system = LeastSquares(space.size, space.field.theta, single_products=single)
        for energy in energies:
            for rows in energy.rows(space):
                system.add(rows)
        return system
    # Each step sees what the last one missed, so 1e-4 is enough.
    system = LeastSquares(space.size, space.field.theta, tolerance=1e-4)
    for energy in energies:
        if not isinstance(energy, (NormalTarget, FieldTarget)):
            raise ValueError(
                f"With {space.size} unknowns (more than {DENSE_LIMIT}) only targets along the normal and of the field "
                f"can be solved for, but the step has a {type(energy).__name__} energy. Edit fewer parameters "
                '(Field(parameters=...)), or smooth with method="explicit".'
            )
    for target in united(space.field, _targets(problem)):
        system.add_operator(target.operator(space))
    return system


def _targets(problem: StepProblem) -> list[NormalTarget | FieldTarget]:
    """Return the energies that are targets along the normal or of the field."""
    return [energy for energy in problem.energies if isinstance(energy, (NormalTarget, FieldTarget))]


def _is_sparse(problem: StepProblem) -> bool:
    """Return whether all are targets of a field in which few parameters act at a point (features on a grid)."""
    space, targets = problem.space, _targets(problem)
    if space.is_reduced or space.tangential is not None or not targets:
        return False
    return len(targets) == len(problem.energies) and has_sparse_rows(space.field, targets[0].points)


def _is_cheaper_by_products(problem: StepProblem) -> bool:
    """Return whether all are targets of a field with a closed form, at fewer points than unknowns and tied to nothing.

    The products of their rows with each other then come from those of the layers (implicit.sensitivity.closed_form).
    """
    space, count = problem.space, 0
    if space.is_reduced or not has_closed_form(space.field):
        return False
    for energy in problem.energies:
        if not isinstance(energy, NormalTarget) and not (isinstance(energy, FieldTarget) and energy.tied is None):
            return False
        count += len(energy.target)
    return count < space.size
