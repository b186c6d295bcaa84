"""Weighted linear equations a . x = y, with their matrix or by their products, and the two ways of holding many.

NormalMatrix     adds up A^T W A: for as many equations as unknowns, or more
KeptEquations    keeps them as they came: for fewer, or for those known by their products alone
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.factors import ConjugateGradients, Dual, Factor, Primal
from implicit.step.factors.traces import random_signs
from implicit.step.symmetric import add_gram, gram, times

# Most unknowns, and most equations known by their products, of which a dense matrix is made: beyond, its factor costs
# more than conjugate gradients.
DENSE_LIMIT = 8000

# Error of products that are summed in single precision, relative to their trace, up to which they are taken; and the
# equations of a block from which it is worth while. Dampings of a tenth of it are those of the least rigid motions.
ROUNDING, FEWEST_SINGLE = 2e-9, 200


class Rows(NamedTuple):
    """A block of weighted equations matrix @ x[first : first + m] = target, which leave the other unknowns out."""

    matrix: Float[Tensor, "k m"]
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]
    first: int = 0

    @property
    def columns(self) -> slice:
        """Unknowns that the equations hold."""
        return slice(self.first, self.first + self.matrix.shape[1])

    def rooted(self) -> Float[Tensor, "k m"]:
        """Return W^1/2 A."""
        return self.matrix * self.weights.sqrt()[:, None]

    def forward(self, x: Float[Tensor, " n"]) -> Float[Tensor, " k"]:
        """Return the left-hand sides A x."""
        return self.matrix @ x[self.columns]

    def add_adjoint(self, total: Float[Tensor, " n"], y: Float[Tensor, " k"]) -> None:
        """Add A^T y to the total, in place."""
        total[self.columns] += self.matrix.T @ y

    def __repr__(self) -> str:
        k, m = self.matrix.shape
        return f"Rows({k} equations in unknowns {self.first} to {self.first + m - 1}, {_dtype(self.matrix)})"


class Operator(NamedTuple):
    """Weighted equations known by their products alone."""

    forward: Callable[[Tensor], Tensor]  # x (n,) to the left-hand sides (k,)
    adjoint: Callable[[Tensor], Tensor]  # (k,) to (n,)
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]
    gram: Callable[[], Tensor] | None = None  # the products of the equations with each other (k, k), if they are cheap

    def add_adjoint(self, total: Float[Tensor, " n"], y: Float[Tensor, " k"]) -> None:
        """Add A^T y to the total, in place."""
        total += self.adjoint(y)

    def __repr__(self) -> str:
        known = "" if self.gram is None else ", Gram matrix known"
        return f"Operator({len(self.target)} equations by their products, {_dtype(self.target)}{known})"


class Equations(ABC):
    """Many equations in the same unknowns, held so that their damped normal matrix can be factored.

    Args:
        size: Number of unknowns.
        like: A tensor whose dtype and device the equations have.
        tolerance: Relative residual at which conjugate gradients stop.
        seed: Seed of the estimates of trace and rank.

    Attributes:
        right: A^T W y, in float64.
        weight: Sum of the weights.
        single_products: Whether products of equations in float64 may be summed in single precision, where the error
            that this is measured to make is below ROUNDING of their trace.
    """

    def __init__(self, size: int, like: Tensor, tolerance: float = 1e-12, seed: int = 0) -> None:
        self.size, self.like, self.tolerance, self.seed = size, like, tolerance, seed
        self.right = torch.zeros(size, dtype=torch.float64, device=like.device)
        self.square = 0.0  # the sum of w y^2
        self.weight = 0.0
        self.single_products = False

    @abstractmethod
    def add(self, rows: Rows) -> None:
        """Add a block of equations."""

    @abstractmethod
    def trace(self) -> float:
        """Return the trace of A^T W A; an estimate where the equations are known by their products alone."""

    @abstractmethod
    def objective(self, x: Float[Tensor, " n"]) -> float:
        """Return the weighted sum of squares of A x - y."""

    @abstractmethod
    def factorise(self, ridge: Float[Tensor, " n"]) -> Factor | None:
        """Return the inverse of A^T W A + diag(ridge); None where the ridge is too small for the precision."""

    def rooted_targets(self) -> Float[Tensor, " k"]:
        """Return W^1/2 y of the equations that are kept."""
        return self.right[:0]

    def _sum(self, equations: Rows | Operator) -> None:
        """Add what is known of the equations without their matrix."""
        equations.add_adjoint(self.right, equations.weights * equations.target)
        self.square += float((equations.weights * equations.target**2).sum())
        self.weight += float(equations.weights.sum())


class KeptEquations(Equations):
    """Equations as they came: factored with one unknown an equation, or not at all."""

    def __init__(self, size: int, like: Tensor, tolerance: float = 1e-12, seed: int = 0) -> None:
        super().__init__(size, like, tolerance, seed)
        self.rows: list[Rows] = []
        self.operators: list[Operator] = []

    @property
    def _all(self) -> list[Rows | Operator]:
        return [*self.rows, *self.operators]

    @property
    def is_tall(self) -> bool:
        """True if all have a matrix and they are as many as the unknowns, so that A^T W A is smaller than they."""
        return not self.operators and sum(len(rows.target) for rows in self.rows) >= self.size

    def add(self, rows: Rows) -> None:
        self._sum(rows)
        self.rows.append(rows)

    def add_operator(self, operator: Operator) -> None:
        """Add equations known by their products."""
        self._sum(operator)
        self.operators.append(operator)

    def rooted_targets(self) -> Float[Tensor, " k"]:
        parts = [equations.weights.double().sqrt() * equations.target.double() for equations in self._all]
        return torch.cat(parts) if parts else self.right[:0]

    def objective(self, x: Float[Tensor, " n"]) -> float:
        v = x.to(self.like)
        misses = [(equations.weights, equations.forward(v) - equations.target) for equations in self._all]
        return float(sum((weights * miss**2).sum() for weights, miss in misses))

    def trace(self) -> float:
        if not self.operators:
            diagonal = torch.zeros_like(self.right)
            for rows in self.rows:
                diagonal[rows.columns] += (rows.weights[:, None] * rows.matrix**2).sum(dim=0).double()
            return float(diagonal.sum())
        if self._has_gram:
            return float(self._gram.diagonal().sum())
        # Hutchinson's estimate: the mean of z^T G z over random signs z.
        z = random_signs(self.size, 4, self.seed).to(self.like)
        return float(sum(v @ self.apply(v) for v in z.T) / z.shape[1])

    def apply(self, x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Return A^T W A x."""
        total = torch.zeros_like(x)
        for equations in self._all:
            equations.add_adjoint(total, equations.weights * equations.forward(x))
        return total

    def factorise(self, ridge: Float[Tensor, " n"]) -> Factor | None:
        if not bool((ridge > 0).all()):
            return None  # both forms divide by the damping; the caller raises it
        if self.operators and not (self._has_gram and _is_even(ridge)):
            return self.conjugate_gradients(ridge)
        return self.dual(ridge)

    def conjugate_gradients(self, ridge: Float[Tensor, " n"]) -> ConjugateGradients:
        """Return the inverse by an iteration, whatever the equations."""
        return ConjugateGradients(self.apply, ridge, self.like, self.tolerance)

    def dual(self, ridge: Float[Tensor, " n"]) -> Dual | None:
        """Return the inverse with one unknown an equation.

        All equations have a matrix, or they are one operator that knows its Gram matrix and the ridge is one number.
        """
        if self.operators:
            (operator,) = self.operators
            root = operator.weights.double().sqrt()
            return Dual.of(
                self._gram / ridge[0],
                lambda x: root * operator.forward(x.to(self.like)).double(),
                lambda y: operator.adjoint((root * y).to(self.like)).double(),
                ridge,
                self.seed,
            )
        rows = self._rooted_rows()
        products = self._gram / ridge[0] if _is_even(ridge) else gram(rows / ridge.sqrt())
        return Dual.of(products, lambda x: rows @ x, lambda y: rows.T @ y, ridge, self.seed)

    @property
    def _has_gram(self) -> bool:
        """True if all there is is one operator that knows its Gram matrix, of not too many equations."""
        if len(self.operators) != 1 or self.rows:
            return False
        operator = self.operators[0]
        return operator.gram is not None and len(operator.target) <= min(self.size, DENSE_LIMIT)

    @cached_property
    def _gram(self) -> Float[Tensor, "k k"]:
        """Lower triangle of W^1/2 A A^T W^1/2; it serves every damping."""
        if not self.operators:
            return gram(self._rooted_rows())
        operator = self.operators[0]
        assert operator.gram is not None
        root = operator.weights.double().sqrt()
        return operator.gram().double().mul_(root).mul_(root[:, None])

    def _rooted_rows(self) -> Float[Tensor, "k n"]:
        """Return W^1/2 A in float64, over all unknowns."""
        blocks = []
        for rows in self.rows:
            precise = rows._replace(matrix=rows.matrix.double(), weights=rows.weights.double())
            others = rows.columns.start, self.size - rows.columns.stop
            blocks.append(torch.nn.functional.pad(precise.rooted(), others))
        return torch.cat(blocks) if blocks else self.right.new_zeros(0, self.size)

    def __repr__(self) -> str:
        count = sum(len(equations.target) for equations in self._all)
        return f"KeptEquations({count} equations in {self.size} unknowns, {_dtype(self.like)})"


class NormalMatrix(Equations):
    """A^T W A added up block by block; the equations themselves are let go."""

    def __init__(self, size: int, like: Tensor, tolerance: float = 1e-12, seed: int = 0) -> None:
        super().__init__(size, like, tolerance, seed)
        # The lower triangle alone.
        self._matrix = torch.zeros(size, size, dtype=like.dtype, device=like.device)

    @classmethod
    def of(cls, kept: KeptEquations) -> NormalMatrix:
        """Take over equations that have been kept so far."""
        normal = cls(kept.size, kept.like, kept.tolerance, kept.seed)
        normal.right, normal.square, normal.weight = kept.right, kept.square, kept.weight
        normal.single_products = kept.single_products
        for rows in kept.rows:
            normal._accumulate(rows)
        return normal

    def add(self, rows: Rows) -> None:
        self._sum(rows)
        self._accumulate(rows)

    def _accumulate(self, rows: Rows) -> None:
        if rows.matrix.numel() == 0:
            return
        rooted = rows.rooted()
        single = self._single(rooted) if self.single_products else None
        if single is not None:
            self._matrix[rows.columns, rows.columns].add_(single)
        elif rows.matrix.shape[1] == self.size:
            add_gram(self._matrix, rooted)
        else:
            self._matrix[rows.columns, rows.columns] += gram(rooted.T)

    def _single(self, rooted: Float[Tensor, "k m"]) -> Float[Tensor, "m m"] | None:
        """Return the lower triangle of rooted^T rooted, summed in single precision; None where that does not do.

        The error is measured on a vector of random signs, of which a symmetric matrix of independent errors makes half
        its norm.
        """
        if rooted.dtype != torch.float64 or len(rooted) < FEWEST_SINGLE:
            return None
        found = gram(rooted.to(torch.float32).T).double()
        signs = random_signs(rooted.shape[1], 1, self.seed)[:, 0].to(rooted)
        error = times(found, signs) - rooted.T @ (rooted @ signs)
        allowed = ROUNDING * float(found.diagonal().sum())
        return found if 2 * float(error.norm() / signs.norm()) <= allowed else None

    def trace(self) -> float:
        return float(self._matrix.diagonal().double().sum())

    def objective(self, x: Float[Tensor, " n"]) -> float:
        v = x.to(self._matrix)
        curved = float(v @ times(self._matrix, v))
        # Cancellation can leave a small negative number where the fit is all but exact.
        return max(0.0, self.square - 2 * float(self.right @ x) + curved)

    def factorise(self, ridge: Float[Tensor, " n"]) -> Factor | None:
        return Primal.of(self._matrix, ridge, self.seed)

    def __repr__(self) -> str:
        return f"NormalMatrix({self.size} unknowns, {_dtype(self.like)})"


def _is_even(ridge: Float[Tensor, " n"]) -> bool:
    return bool((ridge == ridge[0]).all())


def _dtype(tensor: Tensor) -> str:
    return str(tensor.dtype).removeprefix("torch.")
