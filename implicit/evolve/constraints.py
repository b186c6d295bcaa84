"""What an edit holds: functionals measured on the surface, their rows in each step, and their restoration.

A hard row keeps a functional to first order in the step; Newton's method on the re-measured value then restores it.
The targets are measured at the start on a fine quadrature, and so is the end; in between a coarser one serves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_choice, require_positive
from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import adjoint
from implicit.sensitivity.shape_functionals import Functional, require_functional
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import Factorised, Rows
from implicit.surface.extraction import require_resolution
from implicit.surface.quadrature import MeshedSample, SurfaceSample, meshed_quadrature
from implicit.surface.sampling import subsample

Enforce = Literal["rows", "projection", "penalty"]

# Points for the sensitivities: they only steer, so a thousandth of error costs at most one more correction.
STEERING_POINTS = 4000
CORRECTIONS = 8


class NotHeldError(ValueError):
    """A functional could not be restored to its target."""


@dataclass(frozen=True)
class Holding:
    """How an edit holds its functionals.

    Attributes:
        enforce: "rows" holds by hard rows and Newton's method; "projection" takes what would change them out of the
            finished step, as the paper does; "penalty" charges their relative gaps, squared.
        tolerance: Of "rows": relative gap that is left after each step; None is 1e-8 in float64, 1e-5 in float32. The
            end is brought as near as the precision allows.
        resolution: Cells along the longest side of the bounds of the quadrature in each step.
        fine_resolution: The same at the start and at the end, where it decides how well the values agree.
        penalty: Of "penalty": the price of a squared relative gap of 1, in units of size^(D + 1).
    """

    enforce: Enforce = "rows"
    tolerance: float | None = None
    resolution: int = 48
    fine_resolution: int = 96
    penalty: float = 1.0

    def __post_init__(self) -> None:
        require_choice("enforce", self.enforce, get_args(Enforce))
        if self.tolerance is not None:
            require_positive("tolerance", self.tolerance)
        require_positive("penalty", self.penalty)
        require_resolution("resolution", self.resolution)
        require_resolution("fine_resolution", self.fine_resolution)


def checked_constraints(constraints: Sequence[Functional]) -> tuple[Functional, ...]:
    """Functionals to hold, or a clear refusal of what are none."""
    if not isinstance(constraints, list | tuple):
        raise TypeError(f"constraints must be a list such as [Volume()], but are {constraints!r}.")
    for k, constraint in enumerate(constraints):
        require_functional(f"constraints[{k}]", constraint)
    return tuple(constraints)


class Guard:
    """Measures the surface of an edit, and brings its functionals back to their targets.

    Args:
        field: At the start; a functional without a target keeps its value there.
        constraints: What to hold.
        holding: How.
        always: Whether to measure the surface even where nothing is held.
    """

    def __init__(self, field: Field, constraints: Sequence[Functional], holding: Holding, *, always: bool) -> None:
        self.constraints, self.holding = checked_constraints(constraints), holding
        for constraint in self.constraints:
            if constraint.bound not in ("equal", "at least", "at most"):
                raise ValueError(
                    f'bound of a constraint must be "equal", "at least" or "at most", but is {constraint.bound!r}.'
                )
        names = [c.name for c in self.constraints]
        self._names = [n if names.count(n) == 1 else f"{n}_{k + 1}" for k, n in enumerate(names)]
        self._signs = torch.tensor([{"equal": 0, "at least": 1, "at most": -1}[c.bound] for c in self.constraints])
        self.surface: MeshedSample | None = None
        self._tolerance = holding.tolerance or (1e-8 if field.dtype == torch.float64 else 1e-5)
        self._price = holding.penalty * field.size ** (field.dimension + 1)
        self._values: list[float] = []
        self._targets: list[float] = []
        self._scales: list[float] = []
        if self.constraints:
            self.look(field, fine=True)
            self._targets = [v if c.target is None else c.target for c, v in zip(self.constraints, self._values)]
            # Relative to the target, or where that is zero (a centred moment, say) to the area of the surface.
            area = float(self.sample.weights.sum())
            self._scales = [abs(t) if t != 0 else area for t in self._targets]
        if self.constraints or always:
            self.look(field)

    @property
    def sample(self) -> SurfaceSample:
        """The quadrature of the surface last looked at."""
        assert self.surface is not None
        return self.surface.sample

    @property
    def hard(self) -> bool:
        """Whether values are restored after each step."""
        return bool(self.constraints) and self.holding.enforce == "rows"

    @property
    def record(self) -> dict[str, Any]:
        """The values last measured, by the names of their functionals."""
        return dict(zip(self._names, self._values, strict=True))

    @property
    def gap(self) -> float:
        """Largest relative distance of a value from its target or bound."""
        return max((abs(g) / s for g, s in zip(self._gaps(), self._scales, strict=True)), default=0.0)

    def look(self, field: Field, *, fine: bool = False) -> None:
        """Measure the surface of a field.

        Raises:
            ValueError: It has none any more, or its gradient vanishes there.
        """
        resolution = max(self.holding.fine_resolution, self.holding.resolution) if fine else self.holding.resolution
        self.surface = meshed_quadrature(field, resolution)
        self._values = [c.value(field, self.sample) for c in self.constraints]

    def _gaps(self) -> list[float]:
        """Target minus value, zero where a bound is met."""
        gaps = [t - v for t, v in zip(self._targets, self._values, strict=True)]
        return [g if s == 0 or g * s > 0 else 0.0 for g, s in zip(gaps, self._signs.tolist(), strict=True)]

    # The step

    def rows(self, field: Field, space: DeformationSpace) -> tuple[Tensor, Tensor]:
        """C and r of all functionals: their sensitivities, and how far each value is from its target."""
        r = [t - v for t, v in zip(self._targets, self._values, strict=True)]
        return self._sensitivities(field, space), field.theta.new_tensor(r)

    def binding(self, C: Float[Tensor, "m n"], r: Float[Tensor, " m"], x: Float[Tensor, " n"] | None) -> Tensor:
        """Which rows must be held: all equalities, and the bounds that a step x would break (none known: none)."""
        signs = self._signs.to(r)
        if x is None or not bool((signs != 0).any()):
            return signs == 0
        return (signs == 0) | ((C @ x - r) * signs < 0)

    def charge(self, C: Float[Tensor, "m n"], r: Float[Tensor, " m"]) -> Rows:
        """The rows of "penalty"."""
        scales = r.new_tensor(self._scales)
        return Rows(C / scales[:, None], r / scales, torch.full_like(r, self._price))

    def _sensitivities(self, field: Field, space: DeformationSpace) -> Float[Tensor, "m n"]:
        steering = subsample(field, self.sample, STEERING_POINTS)
        lengths = field.gradient_length(field.gradient(steering.points))
        C = field.theta.new_zeros(len(self.constraints), space.size)
        for k, constraint in enumerate(self.constraints):
            density = steering.weights * constraint.shape_gradient(field, steering)
            C[k, : space.parameters] = space.reduced(adjoint(field, steering.points, density, lengths))
        return C

    def restore(
        self,
        field: Field,
        x: Float[Tensor, " n"],
        system: Factorised,
        space: DeformationSpace,
        *,
        fine: bool = False,
        looked: bool = False,
    ) -> Float[Tensor, " n"]:
        """The step x with corrections by Newton's method, each the one that disturbs the step least.

        Args:
            field: At the start of the step.
            fine: Whether to measure on the fine quadrature and come as near as the precision allows, as at the end.
            looked: Whether the surface after the step has been measured already.

        Raises:
            NotHeldError: The values do not come within a thousand tolerances of their targets.
            ValueError: The surface is lost.
        """
        C: Tensor | None = None
        last = float("inf")
        best, best_gap = x, float("inf")
        for _ in range(CORRECTIONS):
            moved = field.with_theta(field.theta + space.split(x)[0])
            if not looked:
                self.look(moved, fine=fine)
            looked = False
            gap = self.gap
            if gap < best_gap:
                best, best_gap = x, gap
            if gap <= (min(self._tolerance, 1e-8) if fine else self._tolerance):
                return x
            if gap > 0.5 * last:
                break  # quadrature cells switch as the surface moves; in float32 that and rounding set a floor
            if C is None or gap > 0.1 * last:
                C = self._sensitivities(moved, space)
            last = gap
            gaps = field.theta.new_tensor(self._gaps())
            held = (gaps != 0) | (self._signs.to(gaps) == 0)
            x = x + system.correction(C[held], gaps[held])
        if best_gap > max(1e3 * self._tolerance, 1e-4):
            raise NotHeldError(f"A constraint is {best_gap:.2g} from its target.")
        if best is not x:
            self.look(field.with_theta(field.theta + space.split(best)[0]), fine=fine)
        return best
