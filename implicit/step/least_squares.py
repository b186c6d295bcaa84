"""One step of every edit is this small problem:

    minimise over x   sum_k w_k (a_k . x - y_k)^2  +  x^T diag(damping) x      subject to   C x = r

The equations are collected in a LeastSquares; with a damping they become a Factorised, which solves for any
constraints and knows the least change that meets new ones:

    system = LeastSquares(size, theta)            collect:   system.add(rows)
    factorised = system.factorise(damping)        factor:    one factor a damping
    factorised.solve((C, r))                      use:       as often as is wanted

| equations | what is factored (implicit.step.factors) |
|---|---|
| with a matrix, as many as unknowns or more | primal: the normal matrix |
| with a matrix, fewer | dual: the system with one unknown an equation |
| by their products, with a Gram matrix that is cheap | dual, up to DENSE_LIMIT of them |
| by their products otherwise | nothing: conjugate gradients |
| with sparse matrices | the smaller of primal and dual, among the unknowns that appear |

Constraints enter by their multipliers (implicit.step.kkt), so they hold to rounding in each. This file knows no
geometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.equations import DENSE_LIMIT, Equations, KeptEquations, NormalMatrix, Operator, Rows
from implicit.step.factors import Factor
from implicit.step.kkt import least_change
from implicit.step.sparse_equations import SparseEquations, SparseRows

__all__ = ["DENSE_LIMIT", "LeastSquares", "Factorised", "Solution", "SolveStatus", "Rows", "Operator"]

# Damping where none is asked for, relative to the trace of the normal matrix. In float32 the normal matrix itself
# is only good to about 1e-7 of its trace; in float64 the figure trades fit against the size of the step and was
# chosen by the error of geometric edits in 16 parts (1e-8 beats 1e-6 and 1e-10).
RELATIVE_DAMPING = {torch.float32: 1e-7, torch.float64: 1e-8}

# Factorisations tried, each at ten times the damping of the one before.
TRIES = 12

Constraints = tuple[Float[Tensor, "m n"], Float[Tensor, " m"]]


class SolveStatus(Enum):
    """Outcome of a solve; the value is the sentence a user reads."""

    SOLVED = "The least-squares problem was solved."
    DAMPED = "The system was too near to singular for the damping given; a larger damping was used."
    REDUNDANT_CONSTRAINTS = "Some constraints say the same or move nothing; they were met in the least-squares sense."
    SLOW = "Conjugate gradients stopped at the iteration limit before their tolerance; raise the damping."
    FAILED = "The system holds NaN or infinite numbers; no step was computed. Check the field and the targets."


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimiser and how good it is."""

    x: Float[Tensor, " n"]
    residual: float  # root of the weighted mean square of a . x - y
    objective: float  # the weighted sum of squares, without the damping
    constraint_residual: float  # largest |C x - r|
    condition: float  # estimate for the damped system, from the factor's diagonal; NaN of "cg"
    rank: float  # effective: trace of G (G + damping)^-1, the number of unknowns that the rows decide; NaN of "cg"
    damping: float  # what was added to the diagonal, its largest entry
    method: str  # name of the factor: "primal", "dual", "cg"; "none" where there is none
    status: SolveStatus
    factorised: Factorised | None = None  # what solved it, for corrections; None where the solve failed

    def __repr__(self) -> str:
        return (
            f"Solution({len(self.x)} unknowns, {self.method}, {self.status.name}, residual={self.residual:.3g}, "
            f"constraint_residual={self.constraint_residual:.2g}, rank={self.rank:.0f}, damping={self.damping:.2g})"
        )


class LeastSquares:
    """The equations of a step, collected; none can be added once they have been factored.

    Args:
        size: Number of unknowns.
        like: A tensor whose dtype and device the equations have.
        tolerance: Relative residual at which conjugate gradients stop; None is 1e-12 in float64, 1e-5 in float32.
        seed: Seed of the estimates of trace and rank.
        sparse: Whether most unknowns appear in few equations or in none, so that only those that do are factored.
        single_products: Whether products of equations in float64 may be summed in single precision, where the measured
            error allows it: for dampings of some 1e-9 of the trace and more.
    """

    def __init__(
        self,
        size: int,
        like: Tensor,
        *,
        tolerance: float | None = None,
        seed: int = 0,
        sparse: bool = False,
        single_products: bool = False,
    ) -> None:
        if tolerance is None:
            tolerance = 1e-12 if like.dtype == torch.float64 else 1e-5
        self.size = size
        self._like = like
        self._equations: Equations = (SparseEquations if sparse else KeptEquations)(size, like, tolerance, seed)
        self._equations.single_products = single_products
        self._trace: float | None = None  # once it is known, nothing can be added

    @classmethod
    def of(cls, equations: Equations) -> LeastSquares:
        """Return the system of equations that are all known."""
        system = cls(0, equations.like)
        system.size, system._equations = equations.size, equations
        return system

    def add(self, rows: Rows | SparseRows) -> None:
        """Add a block of weighted equations.

        Raises:
            TypeError: Sparse ones are added to a system that is not.
            RuntimeError: The equations have been factored, or their trace taken.
        """
        self._require_open()
        if isinstance(rows, SparseRows):
            if not isinstance(self._equations, SparseEquations):
                raise TypeError("Sparse equations need a sparse system; make it by LeastSquares(..., sparse=True).")
            self._equations.add(rows)
            return
        self._equations.add(rows)
        if isinstance(self._equations, KeptEquations) and self._equations.is_tall:
            self._equations = NormalMatrix.of(self._equations)

    def add_operator(self, operator: Operator) -> None:
        """Add equations known by their products.

        Raises:
            ValueError: As many equations as unknowns were added with their matrix before.
            RuntimeError: The equations have been factored, or their trace taken.
        """
        self._require_open()
        if not isinstance(self._equations, KeptEquations):
            raise ValueError("Add equations known by their products before those with a matrix.")
        self._equations.add_operator(operator)

    def _require_open(self) -> None:
        if self._trace is not None:
            raise RuntimeError(
                "These equations have been factored, or their trace taken, and no more can be added; "
                "collect all of them first, or begin a new LeastSquares."
            )

    def trace(self) -> float:
        """Return the trace of the normal matrix, the scale that a relative damping refers to."""
        if self._trace is None:
            self._trace = self._equations.trace()
        return self._trace

    def factorise(
        self, damping: float | Float[Tensor, " n"] | None = None, *, relative_damping: float | None = None
    ) -> Factorised | None:
        """Return the damped normal matrix with its inverse; None where it holds NaN or infinite numbers.

        Args:
            damping: Penalty on the squares of x, one for all or one each; None takes the relative one. More is taken
                where rounding would make the matrix indefinite.
            relative_damping: Penalty in units of the trace of the normal matrix; None is RELATIVE_DAMPING.

        Raises:
            ValueError: The damping is negative.
        """
        scale = self.trace()
        if damping is None:
            damping = (RELATIVE_DAMPING[self._like.dtype] if relative_damping is None else relative_damping) * scale
        ridge = torch.as_tensor(damping, dtype=torch.float64, device=self._like.device).expand(self.size)
        if not (torch.isfinite(self._equations.right).all() and np.isfinite(scale)):
            return None
        if bool((ridge < 0).any()):
            raise ValueError(f"damping must not be negative, but is {float(ridge.min()):.3g}.")
        status = SolveStatus.SOLVED
        for _ in range(TRIES):
            factor = self._equations.factorise(ridge)
            if factor is not None:
                return Factorised(self._equations, factor, ridge, status)
            # Rounding made the matrix indefinite: the least damping that the precision can carry, then more.
            ridge = torch.maximum(10 * ridge, torch.full_like(ridge, 1e-14 * scale + 1e-300))
            status = SolveStatus.DAMPED
        return None

    def solve(
        self,
        damping: float | Float[Tensor, " n"] | None = None,
        constraints: Constraints | None = None,
        *,
        relative_damping: float | None = None,
    ) -> Solution:
        """Return the minimiser at one damping: factorise and Factorised.solve in one call."""
        factorised = self.factorise(damping, relative_damping=relative_damping)
        return _failed(self.size, self._like) if factorised is None else factorised.solve(constraints)

    def __repr__(self) -> str:
        return f"LeastSquares({self._equations!r})"


class Factorised:
    """Equations whose damped normal matrix H = A^T W A + D has been factored.

    Args:
        equations: The equations; none are added any more.
        factor: H^-1.
        ridge: Diagonal of D, in float64.
        status: How the factorisation ended.
    """

    def __init__(
        self,
        equations: Equations,
        factor: Factor,
        ridge: Float[Tensor, " n"],
        status: SolveStatus = SolveStatus.SOLVED,
    ) -> None:
        self._equations, self._factor, self._ridge, self._status = equations, factor, ridge, status

    @property
    def factor(self) -> Factor:
        """H^-1, in the form in which it is held."""
        return self._factor

    @property
    def right(self) -> Float[Tensor, " n"]:
        """A^T W y, in float64."""
        return self._equations.right

    def solve(self, constraints: Constraints | None = None) -> Solution:
        """Return the minimiser.

        Args:
            constraints: C and r of the equations C x = r that must hold.
        """
        equations, factor, status = self._equations, self._factor, self._status
        x = factor.minimiser(equations.right, equations.rooted_targets())
        gap = 0.0
        if constraints is not None:
            C, r = (part.double() for part in constraints)
            if not (torch.isfinite(C).all() and torch.isfinite(r).all()):
                return _failed(equations.size, equations.like)
            change, redundant = least_change(factor, C, r - C @ x)
            x = x + change
            gap = float((C @ x - r).abs().max()) if len(r) else 0.0
            status = SolveStatus.REDUNDANT_CONSTRAINTS if redundant else status
        if not bool(torch.isfinite(x).all()):
            return _failed(equations.size, equations.like)
        objective = equations.objective(x)
        return Solution(
            x=x.to(equations.like.dtype),
            residual=(objective / equations.weight) ** 0.5 if equations.weight > 0 else 0.0,
            objective=objective,
            constraint_residual=gap,
            condition=factor.condition,
            rank=factor.rank(),
            damping=float(self._ridge.max()),
            method=factor.name,
            status=status if factor.converged else SolveStatus.SLOW,
            factorised=self,
        )

    def correction(self, C: Float[Tensor, "m n"], r: Float[Tensor, " m"]) -> Float[Tensor, " n"]:
        """Return the change of x with C x = r that raises the damped objective least."""
        return least_change(self._factor, C.double(), r.double())[0].to(self._equations.like.dtype)

    def inverse(self, right: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Return H^-1 right, in float64."""
        return self._factor.inverse(right.double()[:, None])[:, 0]

    def __repr__(self) -> str:
        return f"Factorised({self._equations!r}, {self._factor!r}, damping={float(self._ridge.max()):.2g})"


def _failed(size: int, like: Tensor) -> Solution:
    nan = float("nan")
    zero = torch.zeros(size, dtype=like.dtype, device=like.device)
    return Solution(zero, nan, nan, nan, nan, nan, nan, "none", SolveStatus.FAILED)
