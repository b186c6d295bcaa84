"""H^-1 by conjugate gradients, for equations that are known by their products alone.

The diagonal damping D is scaled out, so that the iteration sees

    D^-1/2 A^T W A D^-1/2 + I,    whose eigenvalues are 1 but for the few that the equations decide
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.factors.factor import Factor

ITERATIONS = 1000


class ConjugateGradients(Factor):
    """The inverse by an iteration; nothing is factored, so neither the condition nor the rank is known.

    Args:
        apply: Product of A^T W A with a vector like `like`.
        ridge: Diagonal of D, positive, in float64.
        like: A tensor whose dtype and device the products take.
        tolerance: Relative residual at which to stop.
    """

    name = "cg"
    condition = float("nan")

    def __init__(
        self, apply: Callable[[Tensor], Tensor], ridge: Float[Tensor, " n"], like: Tensor, tolerance: float
    ) -> None:
        self._apply, self._like, self._tolerance = apply, like, tolerance
        self._root = ridge.sqrt()

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        columns = [self._one(column / self._root) / self._root for column in right.T]
        return torch.stack(columns, dim=1)

    def rank(self) -> float:
        return float("nan")

    def _scaled(self, x: Tensor) -> Tensor:
        """Return D^-1/2 A^T W A D^-1/2 x."""
        return self._apply((x / self._root).to(self._like)).double() / self._root

    def _one(self, right: Tensor) -> Tensor:
        x = torch.zeros_like(right)
        residual = right.clone()
        goal = self._tolerance * float(right.norm())
        direction, square = residual.clone(), float(residual @ residual)
        for _ in range(ITERATIONS):
            if float(residual.norm()) <= goal:
                return x
            image = self._scaled(direction) + direction
            length = square / float(direction @ image)
            x = x + length * direction
            residual = residual - length * image
            new = float(residual @ residual)
            direction, square = residual + (new / square) * direction, new
        self.converged = self.converged and float(residual.norm()) <= 1e3 * goal
        return x
