"""The Cholesky factor of the damped normal matrix H = A^T W A + D itself: for more equations than unknowns."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.factors.cholesky import Cholesky
from implicit.step.factors.factor import Factor
from implicit.step.factors.traces import estimated_trace


class Primal(Factor):
    """Cholesky factor of H."""

    name = "primal"

    def __init__(self, factor: Cholesky, ridge: Float[Tensor, " n"], seed: int) -> None:
        self._factor, self._ridge, self._seed = factor, ridge, seed
        self.condition = factor.condition()

    @classmethod
    def of(cls, normal: Float[Tensor, "n n"], ridge: Float[Tensor, " n"], seed: int = 0) -> Primal | None:
        """Factor A^T W A + D; None where that is not positive definite with so little damping.

        Args:
            normal: A^T W A, of which the lower triangle is read.
            ridge: Diagonal of D, in float64.
            seed: Seed of the estimate of the rank.
        """
        damped = normal.to(torch.float64, copy=True)
        damped.diagonal().add_(ridge)
        factor = Cholesky.of(damped)
        return None if factor is None else cls(factor, ridge, seed)

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        return self._factor.solve(right)

    def rank(self) -> float:
        # n minus the trace of D H^-1.
        n = len(self._ridge)
        lost = estimated_trace(n, lambda z: self._ridge[:, None] * self.inverse(z), self._ridge, self._seed)
        return min(float(n), max(0.0, n - lost))
