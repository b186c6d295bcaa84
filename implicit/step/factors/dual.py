"""The inverse of H = A^T W A + D with one unknown an equation, for fewer equations than unknowns (Woodbury):

H^-1 = D^-1 - D^-1 R^T (I + R D^-1 R^T)^-1 R D^-1,    R = W^1/2 A
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.factors.cholesky import Cholesky
from implicit.step.factors.factor import Factor
from implicit.step.factors.traces import estimated_trace


class Dual(Factor):
    """Cholesky factor of I + R D^-1 R^T.

    The minimiser is D^-1 R^T times what that factor makes of W^1/2 y; the general inverse subtracts, and loses as many
    digits as the damping is below the trace.
    """

    name = "dual"

    def __init__(
        self,
        factor: Cholesky,
        forward: Callable[[Tensor], Tensor],
        adjoint: Callable[[Tensor], Tensor],
        ridge: Float[Tensor, " n"],
        seed: int,
    ) -> None:
        self._factor, self._forward, self._adjoint, self._ridge, self._seed = factor, forward, adjoint, ridge, seed
        self.condition = factor.condition()

    @classmethod
    def of(
        cls,
        gram: Float[Tensor, "k k"],
        forward: Callable[[Tensor], Tensor],
        adjoint: Callable[[Tensor], Tensor],
        ridge: Float[Tensor, " n"],
        seed: int = 0,
    ) -> Dual | None:
        """Factor I + R D^-1 R^T; None where rounding made that indefinite.

        Args:
            gram: R D^-1 R^T, of which the lower triangle is read; it is used up.
            forward, adjoint: Products of R and of its transpose with vectors.
            ridge: Diagonal of D, positive, in float64.
            seed: Seed of the estimate of the rank.
        """
        gram.diagonal().add_(1.0)
        factor = Cholesky.of(gram)
        return None if factor is None else cls(factor, forward, adjoint, ridge, seed)

    def minimiser(self, right: Float[Tensor, " n"], target: Float[Tensor, " k"]) -> Float[Tensor, " n"]:
        return self._adjoint(self._factor.solve(target[:, None])[:, 0]) / self._ridge

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        scaled = right / self._ridge[:, None]
        image = torch.stack([self._forward(column) for column in scaled.T], dim=1)
        inner = self._factor.solve(image)
        return scaled - torch.stack([self._adjoint(column) for column in inner.T], dim=1) / self._ridge[:, None]

    def rank(self) -> float:
        # The same trace, taken among the equations: their products with the unknowns may be passes of a network.
        k = len(self._factor)
        lost = estimated_trace(k, self._factor.solve, self._ridge, self._seed)
        return min(float(k), max(0.0, k - lost))
