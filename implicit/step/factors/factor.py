"""The calls that every form of the inverse of a damped normal matrix H = A^T W A + D answers."""

from __future__ import annotations

from abc import ABC, abstractmethod

from jaxtyping import Float
from torch import Tensor


class Factor(ABC):
    """H^-1, and what is known of H.

    Attributes:
        name: Form of the factor, as the record of a step says it.
        condition: Estimate of the condition of the damped system; NaN where nothing tells it.
        converged: Whether all inverses taken so far are exact to the tolerance of an iteration, if it is one.
    """

    name: str
    condition: float
    converged: bool = True

    @abstractmethod
    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        """Return H^-1 times the columns."""

    @abstractmethod
    def rank(self) -> float:
        """Estimate the trace of A^T W A H^-1, the number of unknowns that the equations decide; NaN if unknown."""

    def minimiser(self, right: Float[Tensor, " n"], target: Float[Tensor, " k"]) -> Float[Tensor, " n"]:
        """Return H^-1 A^T W y from right = A^T W y, or from target = W^1/2 y where that is more exact."""
        return self.inverse(right[:, None])[:, 0]

    def __repr__(self) -> str:
        return f"{type(self).__name__}(condition={self.condition:.2g})"
