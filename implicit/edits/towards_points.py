"""Steps of boundary sensitivity that take a surface the last of the way to the positions of least energy.

A field that has followed a large deformation is off by its fit, and so are the functionals to hold. Each step moves the
surface along its normals to where the vertices are to be [paper, eq. 4, 5], in the metric of their energy
(implicit.step.rigidity_target), and then restores the functionals (see implicit.evolve.evolve), so that these end as
near as those of other edits. With more parameters than MOST the gaps count by area instead, for the least squares then
knows only targets along the normal.

Where nothing has to be restored, and no piece to be mended, the normal matrix of one step serves several: of what costs
a step little is left in the matrix, made in single precision, and all of what steers it in the gaps, which are measured
anew each time (`nearer`). A step is taken where it lowers the energy.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from jaxtyping import Float
from scipy import sparse
from scipy.linalg import lapack
from torch import Tensor

from implicit.evolve.edit import EditStatus
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import parameter_gradient
from implicit.sensitivity.closed_form import factors, fits
from implicit.sensitivity.row_factors import RowFactors
from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, FieldTarget, NormalTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.step.rigidity_target import RigidityTarget
from implicit.step.symmetric import add_gram, gram
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample

# Of the energy off the surface beside that on it.
OFF_SURFACE_STRENGTH = 0.1
OFF_SURFACE_POINTS = 1000

# Damping of the first step, and the least of later ones, relative to the trace of the normal matrix. A step may miss
# its prediction by so many times its motion: what decides is whether the energy falls.
FIRST_DAMPING, LEAST_DAMPING, ALLOWED = 1e-6, 3e-8, 3.0

# Normal matrices that are made at most, steps that one of them serves, and the part of the energy before that a step is
# to leave at most for another of its kind to be tried. A matrix of a wide field costs more, and its caller looks at the
# surface in between.
MATRICES, STEPS, LEFT = 4, 3, 0.85
MATRICES_OF_WIDE = 2

# Factor by which the damping goes up where a step has raised the energy, and down after each matrix.
HARDER = {False: 10.0, True: 4.0}

# Part of the energy before that a matrix is to leave at most for another one to be made.
WORTH = 0.95

# Parameters up to which the metric of the energy is taken: its equations are a matrix.
MOST = 4000

# Numbers of the rows of a wider field at most that are made where they are not known by their factors.
LARGEST = 200_000_000


@dataclass(frozen=True, eq=False)
class TowardsPoints:
    """The operation that takes the vertices of a mesh of the surface along its normals to their goals.

    Attributes:
        goals: Where the starting points are to be (V, D).
        weights: Area that each stands for (V,).
        laplacian: L of the energy whose minimum the goals are (V, V).
        seed: Of the random points off the surface.
        firmness: Factor of the damping.
    """

    columns: ClassVar[tuple[str, ...]] = ("strain_left",)

    goals: Float[Tensor, "v d"]
    weights: Float[Tensor, " v"]
    laplacian: sparse.csc_array
    seed: int
    firmness: float = 1.0

    def start(self, field: Field, points: Tensor) -> None:
        """Return no memory: the steps need none."""

    def finished(self, state: State[None], history: Sequence[Row]) -> EditStatus | None:
        """Return that the edit goes on, up to its last step."""
        return None

    def step(self, state: State[None]) -> StepProblem:
        """Return the problem of a step: the whole way that is left."""
        field, target = state.field, self.left(state.field)
        sample = SurfaceSample(target.points, target.normals, self.weights)
        if len(field.theta) > MOST:
            on: Energy = NormalTarget(target.points, target.gaps, self.weights)
            strength = OFF_SURFACE_STRENGTH
        else:
            on = target
            # Strains of the surface are gaps over the spacing.
            strength = OFF_SURFACE_STRENGTH / float(self.weights.mean())
        away = off_surface(
            field, sample, target.gaps, strength=strength, points=OFF_SURFACE_POINTS, seed=self.seed + state.step
        )
        rule = DampingRule(
            None, first=self.firmness * FIRST_DAMPING, least=self.firmness * LEAST_DAMPING, allowed_error=ALLOWED
        )
        row = {"strain_left": target.energy()}
        return StepProblem(DeformationSpace(field), [on, away], rule, row=row)

    def left(self, field: Field) -> RigidityTarget:
        """Return what is left between the field's surface and the goals; of a goal that finds no surface, nothing."""
        points, arrived = newton_to_surface(field, self.goals, reach=field.size / 20)
        points = torch.where(arrived[:, None], points, self.goals)
        slopes = field.gradient(points)
        normals = slopes / slopes.norm(dim=1, keepdim=True).clamp(min=torch.finfo(slopes.dtype).tiny)
        gaps = ((self.goals - points) * normals).sum(dim=1)
        return RigidityTarget(points, normals, gaps, self.laplacian)

    def taken(self, state: State[None], taken: Taken) -> Outcome[None]:
        """Return nothing to keep or to record."""
        return Outcome(None)


def nearer(operation: TowardsPoints, field: Field, enough: float) -> tuple[Field, int]:
    """Return a field with less strain between its surface and the goals, and how many steps it took.

    The steps are those of `operation` with one normal matrix for several, and none of them raises the energy. With more
    parameters than MOST it is the matrix of the products of the equations; where a field's rows are not known by their
    factors and are too many to be made, nothing is done.

    Args:
        operation: Where the surface is to be.
        field: In float64.
        enough: Energy at which no more steps are taken.
    """
    left, taken, damping = operation.left(field), 0, operation.firmness * FIRST_DAMPING
    energy, wide = left.energy(), len(field.theta) > MOST
    for number in range(MATRICES_OF_WIDE if wide else MATRICES):
        system, begun = None, energy
        if energy > enough:
            system = _system(operation, field, left, operation.seed + number)
        if system is None:
            break
        for _ in range(STEPS):
            step = system.step(left, damping)
            tried = None if step is None else field.with_theta(field.theta + step)
            after = None if tried is None else operation.left(tried)
            if tried is None or after is None or not after.energy() < energy:
                damping *= HARDER[wide]
                continue
            stalled = after.energy() > LEFT * energy
            field, left, energy, taken = tried, after, after.energy(), taken + 1
            if stalled or energy <= enough:
                break
        if energy > WORTH * begun:
            break
        damping = max(damping / HARDER[wide], LEAST_DAMPING)
    return field, taken


class _System(Protocol):
    """The equations of a step, to serve several."""

    def step(self, left: RigidityTarget, damping: float) -> Float[Tensor, " p"] | None:
        """Return the change of the parameters, in float64; None where it cannot be told."""


def _system(operation: TowardsPoints, field: Field, left: RigidityTarget, seed: int) -> _System | None:
    """Return the equations over the parameters, or their products where these are fewer; None where none fit."""
    single = field.to(torch.float32)
    here = SurfaceSample(*(part.to(single.theta) for part in (left.points, left.normals, operation.weights)))
    strength = OFF_SURFACE_STRENGTH / float(operation.weights.mean())
    away = off_surface(
        single, here, left.gaps.to(single.theta), strength=strength, points=OFF_SURFACE_POINTS, seed=seed
    )
    if len(field.theta) <= MOST:
        return _Normal.of(single, left, away)
    count = len(here) + len(away.points)
    return _Products.of(single, left, away) if fits(field, count) or count * len(field.theta) <= LARGEST else None


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal matrix of a step.

    Attributes:
        matrix: Its lower triangle, in single precision (P, P).
        rows: Motion of the vertices along their normals by each parameter (V, P), in single precision.
        away: Sum over what is asked off the surface, at the first of the steps (P,).
        factors: Of the matrix with the last damping, by that.
    """

    matrix: Float[Tensor, "p p"]
    rows: Float[Tensor, "v p"]
    away: Float[Tensor, " p"]
    factors: dict[float, FloatArray] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, field: Field, left: RigidityTarget, target: FieldTarget) -> _Normal:
        """Return that of a field in single precision, what is left of its way, and what is asked off its surface."""
        space = DeformationSpace(field)
        rows = torch.cat([part for _, part in space.normal_rows(left.points.to(field.theta))])
        matrix = rows.new_zeros(space.size, space.size)
        add_gram(matrix, torch.from_numpy(left.factor.astype(np.float32) @ rows.cpu().numpy()))
        away = rows.new_zeros(space.size)
        for part in target.rows(space):
            add_gram(matrix, part.rooted())
            away += part.matrix.T @ (part.weights * part.target)
        return cls(matrix, rows, away)

    def step(self, left: RigidityTarget, damping: float) -> Float[Tensor, " p"] | None:
        """Return the change of the parameters, in float64; None where it cannot be told."""
        bent = torch.from_numpy(left.metric @ left.gaps.cpu().numpy()).to(self.rows)
        found = _solved(self.matrix, damping, self.rows.T @ bent + self.away, np.float64, self.factors)
        return None if found is None else found.to(left.gaps)


@dataclass(frozen=True, eq=False)
class _Products:
    """The products of the equations of a step with each other, for fields with more parameters than equations.

    With A the equations, one a vertex in the metric of the energy and one a point off the surface, and b what they ask,
    the step of least |A d_theta - b|^2 + damping |d_theta|^2 is A^T (A A^T + damping)^-1 b.

    Attributes:
        matrix: A A^T (N, N), in single precision.
        rows: Motion of the vertices along their normals, and change of the field off the surface by the root of its
            weight, by each parameter (N, P), in single precision.
        factor: U of the metric at the first of the steps (V, V).
        away: What is asked off the surface, by the root of its weight (M,).
        factors: Of the matrix with the last damping, by that.
    """

    matrix: Float[Tensor, "n n"]
    rows: RowFactors | Float[Tensor, "n p"]
    factor: sparse.csr_array
    away: Float[Tensor, " m"]
    factors: dict[float, FloatArray] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(cls, field: Field, left: RigidityTarget, target: FieldTarget) -> _Products:
        """Return those of a field in single precision, what is left of its way, and what is asked off its surface."""
        points, roots = left.points.to(field.theta), target.weights.sqrt()
        scale = torch.cat([-1 / field.gradient_length(field.gradient(points)), roots / target.scale])
        everywhere = torch.cat([points, target.points])
        if fits(field, len(everywhere)):
            known = factors(field, everywhere).scaled(scale)
            rows: RowFactors | Tensor = known
            products = known.gram()
        else:
            made = rows = parameter_gradient(field, everywhere).mul_(scale[:, None])
            products = gram(made)
        lower = products.float().cpu().tril()
        whole = (lower + lower.tril(-1).T).numpy()
        V, U = len(points), left.factor.astype(np.float32)
        whole[:V] = U @ whole[:V]
        whole[:, :V] = (U @ np.ascontiguousarray(whole[:, :V].T)).T
        return cls(torch.from_numpy(whole), rows, left.factor, (roots * target.target).double().cpu())

    def step(self, left: RigidityTarget, damping: float) -> Float[Tensor, " p"] | None:
        """Return the change of the parameters, in float64; None where it cannot be told."""
        bent = torch.from_numpy(self.factor @ left.gaps.double().cpu().numpy())
        found = _solved(self.matrix, damping, torch.cat([bent, self.away]), np.float32, self.factors)
        if found is None:
            return None
        V = self.factor.shape[0]
        shares = torch.cat([torch.from_numpy(self.factor.T @ found[:V].numpy()), found[V:]])
        if isinstance(self.rows, Tensor):
            return (shares.to(self.rows) @ self.rows).to(left.gaps)
        return self.rows.transposed_times(shares.to(self.rows.theta)).to(left.gaps)


def _solved(
    matrix: Float[Tensor, "n n"],
    damping: float,
    right: Float[Tensor, " n"],
    dtype: type[np.floating[Any]],
    factors: dict[float, FloatArray],
) -> Float[Tensor, " n"] | None:
    """Return the solution with a symmetric matrix, of which the lower triangle counts, damped relative to its trace.

    The factor of the last damping is kept for the next solution with the same.
    """
    single = dtype == np.float32
    factored, solve = (lapack.spotrf, lapack.spotrs) if single else (lapack.dpotrf, lapack.dpotrs)
    if damping not in factors:
        factors.clear()
        lower = matrix.cpu().numpy().astype(dtype)
        lower[np.diag_indices_from(lower)] += damping * np.trace(lower)
        # The triangle below the diagonal is the upper one of the Fortran-ordered view.
        factor, failed = factored(lower.T, lower=0, overwrite_a=1)
        if failed:
            return None
        factors[damping] = factor
    found, failed = solve(factors[damping], right.cpu().numpy().astype(dtype), lower=0)
    return None if failed or not np.isfinite(found).all() else torch.from_numpy(found).double()
