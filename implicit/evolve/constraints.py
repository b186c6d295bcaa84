"""Functionals that an edit holds: measured on the surface, their rows in each step, and their restoration.

A hard row keeps a functional to first order in the step; Newton's method on the re-measured value then restores it.
The targets are measured at the start on a fine quadrature, and so is the end; in between a coarser one serves. The
error of each is estimated, and the fine ones are refined where it is more than the tolerance, up to a limit: a value is
held no better than it is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_choice, require_positive
from implicit.field.field import Field, SurfaceError
from implicit.sensitivity.boundary_sensitivity import adjoint
from implicit.sensitivity.shape_functionals import (
    Area,
    Functional,
    Integral,
    Values,
    Volume,
    next_finer,
    require_functional,
    with_errors,
)
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import LeastSquares, Rows, Solution
from implicit.surface.extraction import require_resolution
from implicit.surface.quadrature import MeshedSample, SurfaceSample, carried, meshed_quadrature
from implicit.surface.refined_quadrature import refined_quadrature
from implicit.surface.sampling import one_a_strip

Enforce = Literal["rows", "projection", "penalty"]

# Points for the sensitivities: they only steer, so a thousandth of error costs at most one more correction.
STEERING_POINTS = 4000
CORRECTIONS = 8

# Estimated relative error of the fine quadrature that is come to where no tolerance is given. The true error of volumes
# is a twentieth of the estimate in the median; half of this would refine shapes that 96 cells resolve.
RESOLVED = 2e-6

# Estimated relative error of what is held from which on an edit says so, where no tolerance is given.
TOLD = 1e-6

SIGNS = {"equal": 0, "at least": 1, "at most": -1}

# From C and r to the change of the unknowns that a correction makes.
Correction = Callable[[Tensor, Tensor], Tensor]


class NotHeldError(ValueError):
    """A functional could not be restored to its target."""


@dataclass(frozen=True)
class Holding:
    """Choice of how an edit holds its functionals.

    Attributes:
        enforce: "rows" holds by hard rows and Newton's method; "projection" takes what would change them out of the
            finished step, as the paper does; "penalty" charges their relative gaps, squared.
        tolerance: Of "rows": relative gap that is left after each step; None is 1e-8 in float64, 1e-5 in float32. The
            end is brought as near as the precision allows. The fine quadrature is refined until its estimated error
            is below it too, or below 2e-6 for None, or up to `finest_resolution`; what is then left is in the column
            `constraint_error` of the records, and where it is too much in the notes of the edit.
        resolution: Cells along the longest side of the bounds of the quadrature in each step.
        fine_resolution: The same at the start and at the end, where it decides how well the values agree.
        finest_resolution: The most that these are refined to; None is twice fine_resolution.
        penalty: Of "penalty": the price of a squared relative gap of 1, in units of size^(D + 1).
    """

    enforce: Enforce = "rows"
    tolerance: float | None = None
    resolution: int = 48
    fine_resolution: int = 96
    penalty: float = 1.0
    finest_resolution: int | None = None

    def __post_init__(self) -> None:
        require_choice("enforce", self.enforce, get_args(Enforce))
        if self.tolerance is not None:
            require_positive("tolerance", self.tolerance)
        require_positive("penalty", self.penalty)
        require_resolution("resolution", self.resolution)
        require_resolution("fine_resolution", self.fine_resolution)
        if self.finest_resolution is not None:
            require_resolution("finest_resolution", self.finest_resolution)

    @property
    def fine(self) -> int:
        """Cells along the longest side of the bounds at the start and at the end, before any refinement."""
        return max(self.fine_resolution, self.resolution)

    @property
    def finest(self) -> int:
        """The most cells along the longest side of the bounds."""
        return 2 * self.fine if self.finest_resolution is None else max(self.finest_resolution, self.fine)

    @property
    def resolved(self) -> float:
        """Relative error that the fine quadrature is to come to."""
        return RESOLVED if self.tolerance is None else self.tolerance


def checked_constraints(constraints: Sequence[Functional]) -> tuple[Functional, ...]:
    """Return functionals to hold as a tuple.

    Raises:
        TypeError: They are no list, or one is no functional.
        ValueError: A bound is none of those there are.
    """
    if not isinstance(constraints, list | tuple):
        raise TypeError(f"constraints must be a list such as [Volume()], but are {constraints!r}.")
    for k, constraint in enumerate(constraints):
        require_functional(f"constraints[{k}]", constraint)
        require_choice(f"bound of constraints[{k}]", constraint.bound, tuple(SIGNS))
    return tuple(constraints)


@dataclass(frozen=True, eq=False)
class Measurement:
    """A surface and the values of the functionals on it.

    Attributes:
        surface: The quadrature and its mesh.
        values: Of each functional.
    """

    surface: MeshedSample
    values: tuple[float, ...]

    @property
    def sample(self) -> SurfaceSample:
        """Quadrature of the surface."""
        return self.surface.sample


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """The functionals to first order in the unknowns x of a step: C x = r brings each to its target.

    Attributes:
        matrix: C, the sensitivities (M, S).
        gap: r, target minus value (M,).
        signs: 0 of an equality, 1 of "at least", -1 of "at most" (M,).
        scales: What a gap is relative to (M,).
    """

    matrix: Float[Tensor, "m s"]
    gap: Float[Tensor, " m"]
    signs: Float[Tensor, " m"]
    scales: Float[Tensor, " m"]

    def active(self, x: Float[Tensor, " s"] | None = None) -> Tensor:
        """Return which must be held, (M,) bool: all equalities, and the bounds that a step x would break.

        Args:
            x: The step; None takes no bound for broken.
        """
        if x is None or not bool((self.signs != 0).any()):
            return self.signs == 0
        return (self.signs == 0) | ((self.matrix @ x - self.gap) * self.signs < 0)

    def only(self, which: Tensor) -> tuple[Tensor, Tensor]:
        """Return C and r of some of them."""
        return self.matrix[which], self.gap[which]


class Enforcement(Protocol):
    """A way for a step's least squares to meet the functionals."""

    @property
    def restores(self) -> bool:
        """True if Newton's method brings the values back after the step."""

    def penalty_rows(self, linear: LinearConstraints) -> list[Rows]:
        """Return what is added to the least squares before it is solved."""

    def solve(
        self, system: LeastSquares, damping: float, linear: LinearConstraints | None
    ) -> tuple[Solution, Float[Tensor, " s"]]:
        """Return the minimiser, and the step that the functionals leave of it."""


@dataclass(frozen=True)
class HardRows:
    """C x = r holds exactly in each solve, of bounds only those that the step would break."""

    restores = True

    def penalty_rows(self, linear: LinearConstraints) -> list[Rows]:
        """Return none."""
        return []

    def solve(
        self, system: LeastSquares, damping: float, linear: LinearConstraints | None
    ) -> tuple[Solution, Float[Tensor, " s"]]:
        """Return the constrained minimiser, twice."""
        if linear is None:
            return _unconstrained(system, damping)
        held = linear.active()
        solution = system.solve(damping, linear.only(held))
        broken = linear.active(solution.x)
        if bool((broken & ~held).any()):
            solution = system.solve(damping, linear.only(broken))
        return solution, solution.x


@dataclass(frozen=True)
class KernelProjection:
    """The free minimiser, less its part that changes the functionals to first order, as in the paper: x - C^+ C x."""

    restores = False

    def penalty_rows(self, linear: LinearConstraints) -> list[Rows]:
        """Return none."""
        return []

    def solve(
        self, system: LeastSquares, damping: float, linear: LinearConstraints | None
    ) -> tuple[Solution, Float[Tensor, " s"]]:
        """Return the free minimiser, and its projection."""
        solution, x = _unconstrained(system, damping)
        if linear is None:
            return solution, x
        return solution, x - torch.linalg.pinv(linear.matrix) @ (linear.matrix @ x)


@dataclass(frozen=True)
class Penalty:
    """A price on the squared relative gaps: price |(C x - r) / scale|^2 beside the step's energies."""

    price: float
    restores = False

    def penalty_rows(self, linear: LinearConstraints) -> list[Rows]:
        """Return the rows of the price."""
        price = torch.full_like(linear.gap, self.price)
        return [Rows(linear.matrix / linear.scales[:, None], linear.gap / linear.scales, price)]

    def solve(
        self, system: LeastSquares, damping: float, linear: LinearConstraints | None
    ) -> tuple[Solution, Float[Tensor, " s"]]:
        """Return the minimiser of all rows, twice."""
        return _unconstrained(system, damping)


def _unconstrained(system: LeastSquares, damping: float) -> tuple[Solution, Tensor]:
    solution = system.solve(damping)
    return solution, solution.x


@dataclass(frozen=True, eq=False)
class ConstraintSet:
    """The functionals that an edit holds.

    Attributes:
        functionals: What is held.
        holding: How.
        names: Of the functionals in records.
        targets: Value or bound of each.
        scales: What the gap of each is relative to: its target, or where that is zero the area of the surface.
        tolerance: Relative gap that is left after each step.
        enforcement: How a step's least squares meet them.
        fine: Cells along the longest side of the bounds on which the targets were measured.
        errors: Estimated error of each target over its scale; 0 of one that the caller gave.
        errors_of_steps: The same of each value as the steps measure it.
        first: The surface at the start as the steps measure it; None where nothing is held.
    """

    functionals: tuple[Functional, ...]
    holding: Holding
    names: tuple[str, ...]
    targets: tuple[float, ...]
    scales: tuple[float, ...]
    tolerance: float
    enforcement: Enforcement
    fine: int
    errors: tuple[float, ...] = ()
    errors_of_steps: tuple[float, ...] = ()
    first: Measurement | None = None

    @classmethod
    def of(
        cls, field: Field, functionals: Sequence[Functional], holding: Holding, columns: Sequence[str] = ()
    ) -> ConstraintSet:
        """Return the set whose targets are, where none is given, the values of a field's surface.

        Args:
            field: At the start of the edit.
            columns: Names in the records of the edit, which no functional may have.

        Raises:
            TypeError: One is no functional.
            ValueError: A bound or a name will not do, or the field has no surface.
        """
        functionals = checked_constraints(functionals)
        names = _names(functionals, columns)
        default = 1e-8 if field.dtype == torch.float64 else 1e-5
        price = holding.penalty * field.size ** (field.dimension + 1)
        enforcements: dict[Enforce, Enforcement] = {
            "rows": HardRows(),
            "projection": KernelProjection(),
            "penalty": Penalty(price),
        }
        # Where nothing is held, nothing is restored either.
        enforcement = enforcements[holding.enforce] if functionals else Penalty(price)
        free = cls(functionals, holding, names, (), (), holding.tolerance or default, enforcement, holding.fine)
        if not functionals:
            return free
        start = free._resolved(field)
        area = float(start.measured.sample.weights.sum())
        targets = [v if c.target is None else c.target for c, v in zip(functionals, start.measured.values, strict=True)]
        scales = [abs(t) if t != 0 else area for t in targets]
        errors = [found.error / s for found, s in zip(start.integrals, scales, strict=True)]
        stepped = free.measure(field)
        off = [abs(a - b) / s for a, b, s in zip(stepped.values, start.measured.values, scales, strict=True)]
        return replace(
            free,
            targets=tuple(targets),
            scales=tuple(scales),
            fine=start.cells,
            errors=tuple(e if c.target is None else 0.0 for c, e in zip(functionals, errors, strict=True)),
            errors_of_steps=tuple(e + o for e, o in zip(errors, off, strict=True)),
            first=stepped,
        )

    def _resolved(self, field: Field) -> _Start:
        """Return the functionals on the first fine quadrature whose estimated errors are within the tolerance."""
        cells, known = self.fine, {}
        measured = self.measure(field, cells=cells)
        while True:
            known[cells] = measured.values
            integrals = with_errors(field, self.functionals, measured.surface, cells, known)
            start = _Start(cells, measured, integrals, known)
            finer = next_finer(cells, self.holding.finest)
            within = all(found.error <= self.holding.resolved * abs(found.value) for found in integrals)
            if within or finer == cells:
                return start
            cells = finer
            try:
                measured = self.measure(field, cells=cells)
            except SurfaceError:  # such cells may show that the surface leaves the bounds: the estimate tells enough
                return start

    def measure(self, field: Field, *, cells: int | None = None) -> Measurement:
        """Return the surface of a field with the values on it.

        Args:
            cells: Along the longest side of the bounds, those refined that do not resolve the surface; None is as in
                each step, with all cells of one size.

        Raises:
            ValueError: It has none any more, or its gradient vanishes there.
        """
        if cells is None:
            surface = meshed_quadrature(field, self.holding.resolution)
        else:
            surface = refined_quadrature(field, cells)
        return self._on(field, surface, cells)

    def measure_again(self, field: Field, before: Measurement, *, cells: int | None = None) -> Measurement:
        """Return what `measure` does of a field that has hardly changed since: its quadrature is carried along.

        Where the surface has moved too far for that it is meshed anew.
        """
        surface = carried(field, before.surface)
        return self.measure(field, cells=cells) if surface is None else self._on(field, surface, cells)

    def _on(self, field: Field, surface: MeshedSample, cells: int | None) -> Measurement:
        if cells is None:
            return Measurement(surface, tuple(c.value_on(field, surface) for c in self.functionals))
        return Measurement(surface, tuple(c.value(field, surface.sample) for c in self.functionals))

    def values(self, measured: Measurement | None) -> dict[str, float]:
        """Return the measured values by name; none where nothing was measured."""
        return {} if measured is None else dict(zip(self.names, measured.values, strict=True))

    def violation(self, measured: Measurement | None) -> float:
        """Return the largest relative distance of a value from its target or bound; 0 where nothing is held."""
        if measured is None:
            return 0.0
        return max((abs(g) / s for g, s in zip(self._gaps(measured), self.scales, strict=True)), default=0.0)

    def error(self, at_end: Sequence[Integral] | None = None) -> float:
        """Return the largest relative error with which a value is known to be at its target; 0 where nothing is held.

        Args:
            at_end: The functionals on the fine quadrature of an edit's end; None is for a value measured in a step.
        """
        if at_end is None:
            ends: Sequence[float] = self.errors_of_steps
        else:
            ends = [found.error / s for found, s in zip(at_end, self.scales, strict=True)]
        return max((a + b for a, b in zip(self.errors, ends, strict=True)), default=0.0)

    def unresolved(self, error: float) -> list[str]:
        """Return what to say of values that are known less well than they are to be held; nothing where they are.

        Args:
            error: The largest relative error with which a value is known to be at its target.
        """
        if not self.functionals or not self.enforcement.restores:
            return []
        wanted = 2 * self.holding.resolved
        if error > wanted:
            return [
                f"What is held is known to {error:.2g} of its value only, not to {wanted:.2g}: on up "
                f"to {self.holding.finest} cells along the longest side the quadrature does not resolve the surface. "
                "Raise fine_resolution and finest_resolution of Holding, or thicken what is thin."
            ]
        if self.holding.tolerance is None and error > TOLD:
            return [
                f"What is held is known to {error:.2g} of its value, by an estimate that is above most errors. Where "
                "that is not enough, give the tolerance of Holding, to which the quadrature is then refined."
            ]
        return []

    def linearised(
        self, field: Field, space: DeformationSpace, measured: Measurement | None, curved: Sequence[float] = ()
    ) -> LinearConstraints | None:
        """Return the functionals to first order about a field, or None where nothing is held.

        Args:
            measured: The surface of the field.
            curved: What each value will change by beyond the first order, where that can be told beforehand.
        """
        if not self.functionals or measured is None:
            return None
        like = field.theta
        gap = [t - v for t, v in zip(self.targets, measured.values, strict=True)]
        if curved:
            gap = [g - c for g, c in zip(gap, curved, strict=True)]
        return LinearConstraints(
            self._sensitivities(field, space, measured),
            like.new_tensor(gap),
            like.new_tensor(self._signs),
            like.new_tensor(self.scales),
        )

    def beyond_first_order(self, measured: Measurement, curved: Sequence[float]) -> tuple[float, ...]:
        """Return by how much a step changed each value beyond the first order; 0 of bounds, which it need not meet.

        Args:
            measured: The surface after the step, before anything is restored.
            curved: What was taken for it in the step's rows, see `linearised`.
        """
        if not self.enforcement.restores:
            return ()
        curved = curved or [0.0] * len(self.functionals)
        values = zip(measured.values, self.targets, curved, self._signs, strict=True)
        return tuple(v - t + c if sign == 0 else 0.0 for v, t, c, sign in values)

    @property
    def _signs(self) -> list[int]:
        return [SIGNS[functional.bound] for functional in self.functionals]

    def _gaps(self, measured: Measurement) -> list[float]:
        """Return target minus value, zero where a bound is met."""
        gaps = [t - v for t, v in zip(self.targets, measured.values, strict=True)]
        return [g if s == 0 or g * s > 0 else 0.0 for g, s in zip(gaps, self._signs, strict=True)]

    def _sensitivities(self, field: Field, space: DeformationSpace, measured: Measurement) -> Float[Tensor, "m n"]:
        steering = _steering(measured.sample)
        lengths = field.gradient_length(field.gradient(steering.points))
        C = field.theta.new_zeros(len(self.functionals), space.size)
        for k, constraint in enumerate(self.functionals):
            density = steering.weights * constraint.shape_gradient(field, steering)
            C[k, : space.parameters] = space.basis.transposed(adjoint(field, steering.points, density, lengths))
        return C

    def restore(
        self,
        field: Field,
        x: Float[Tensor, " n"],
        space: DeformationSpace,
        correction: Correction,
        *,
        measured: Measurement | None = None,
        cells: int | None = None,
    ) -> tuple[Float[Tensor, " n"], Measurement]:
        """Return the step x with corrections by Newton's method, and the surface after it.

        Args:
            field: At the start of the step.
            x: The step's unknowns.
            correction: From C and r to the change of x with C change = r that disturbs the step least.
            measured: The surface after the step x, where it is known.
            cells: Of a fine quadrature to measure on, to come as near as the precision allows, as at the end; None is
                as in each step.

        Raises:
            NotHeldError: The values do not come within a thousand tolerances of their targets.
            ValueError: The surface is lost.
        """
        tolerance = self.tolerance if cells is None else min(self.tolerance, 1e-8)
        C: Tensor | None = None
        last = best_gap = float("inf")
        best: tuple[Tensor, Measurement] | None = None
        for steps in range(CORRECTIONS):
            moved = field.with_theta(field.theta + space.split(x)[0])
            if measured is None:
                measured = self.measure(moved, cells=cells)
            elif steps:
                measured = self.measure_again(moved, measured, cells=cells)
            gap = self.violation(measured)
            if gap < best_gap:
                best, best_gap = (x, measured), gap
            if gap <= tolerance:
                return x, measured
            if gap > 0.5 * last:
                break  # rounding sets a floor
            if C is None or gap > 0.1 * last:
                C = self._sensitivities(moved, space, measured)
            last = gap
            gaps = field.theta.new_tensor(self._gaps(measured))
            held = (gaps != 0) | (gaps.new_tensor(self._signs) == 0)
            x = x + correction(C[held], gaps[held])
        if best is None or best_gap > max(1e3 * self.tolerance, 1e-4):
            raise NotHeldError(f"A constraint is {best_gap:.2g} from its target.")
        return best

    def restore_at_end(
        self, field: Field, space: DeformationSpace, correction: Correction
    ) -> tuple[Float[Tensor, " n"], Measurement, float]:
        """Return the correction that restores the values at the end of an edit, the surface, and the error left.

        The quadrature is the one of the start, refined where its estimated error is above the tolerance.

        Raises:
            NotHeldError: The values do not come within a thousand tolerances of their targets.
            ValueError: The surface is lost.
        """
        cells = self.fine
        x, measured = self.restore(field, field.theta.new_zeros(space.size), space, correction, cells=cells)
        while True:
            moved = field.with_theta(field.theta + space.split(x)[0])
            integrals = with_errors(moved, self.functionals, measured.surface, cells, {cells: measured.values})
            finer = next_finer(cells, self.holding.finest)
            within = all(f.error <= self.holding.resolved * s for f, s in zip(integrals, self.scales, strict=True))
            if within or finer == cells:
                return x, measured, self.error(integrals)
            cells = finer
            try:
                x, measured = self.restore(field, x, space, correction, cells=cells)
            except (NotHeldError, SurfaceError):
                return x, measured, self.error(integrals)


@dataclass(frozen=True, eq=False)
class _Start:
    """The functionals at the start of an edit: on the fine quadrature with their errors, and on all others by cells."""

    cells: int
    measured: Measurement
    integrals: tuple[Integral, ...]
    known: dict[int, Values]


def _names(functionals: Sequence[Functional], columns: Sequence[str]) -> tuple[str, ...]:
    """Return the name of each functional in records, with its number where several have the same."""
    plain = [functional.name for functional in functionals]
    names = [name if plain.count(name) == 1 else f"{name}_{k + 1}" for k, name in enumerate(plain)]
    for k, (functional, name) in enumerate(zip(functionals, names, strict=True)):
        # These two measure just what the column of their name holds.
        same = type(functional) in (Volume, Area)
        if names.count(name) > 1 or (name in columns and not same):
            raise ValueError(
                f"constraints[{k}] is called {name!r}, but the records of an edit have a column of that name already. "
                "Give its class another name, or a `name` of its own."
            )
    return tuple(names)


def _steering(sample: SurfaceSample) -> SurfaceSample:
    """Return the points of a quadrature at which sensitivities are taken: all of a coarse one, a part of a fine one."""
    if len(sample) <= 2 * STEERING_POINTS:
        return sample
    # One from each of many strips of equal area: cells come in the order in which the grid was gone over.
    amounts = sample.weights.double()
    chosen = one_a_strip(amounts, amounts.new_full((STEERING_POINTS,), 0.5))
    equal = (amounts.sum() / STEERING_POINTS).to(sample.weights).expand(STEERING_POINTS)
    return SurfaceSample(sample.points[chosen], sample.normals[chosen], equal)
