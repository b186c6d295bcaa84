"""The triangular factor L of a symmetric positive definite matrix L L^T, and products with its inverse."""

from __future__ import annotations

import torch
from jaxtyping import Float
from scipy.linalg import lapack
from torch import Tensor


class Cholesky:
    """Triangular factor of a symmetric positive definite matrix, and its inverse.

    On the CPU by LAPACK as scipy calls it, in place: torch copies the matrix into its order before it factors it, and
    the factor again for each solve.
    """

    def __init__(self, factor: Float[Tensor, "n n"]) -> None:
        self._factor = factor  # of its lower triangle only

    @classmethod
    def of(cls, matrix: Float[Tensor, "n n"]) -> Cholesky | None:
        """Factor the lower triangle of a matrix, which is used up; None if it is not positive definite.

        In its own precision, double or single.
        """
        if len(matrix) == 0 or matrix.device.type != "cpu":
            factor, info = torch.linalg.cholesky_ex(matrix)
            return cls(factor) if int(info) == 0 else None
        # The transpose is a Fortran-ordered view; the upper triangle there is the lower one here.
        factored = lapack.dpotrf if matrix.dtype == torch.float64 else lapack.spotrf
        result, info = factored(matrix.numpy().T, lower=0, clean=0, overwrite_a=1)
        return cls(torch.from_numpy(result.T)) if info == 0 else None

    def __len__(self) -> int:
        return len(self._factor)

    def __repr__(self) -> str:
        return f"Cholesky({len(self)} x {len(self)}, {self._factor.device})"

    @property
    def device(self) -> torch.device:
        """Device of the factor."""
        return self._factor.device

    def solve(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        """Return the inverse of the matrix times the columns, in their precision."""
        mine = right.to(self._factor.dtype)
        if len(self) == 0 or self.device.type != "cpu":
            return torch.cholesky_solve(mine, self._factor).to(right.dtype)
        solved = lapack.dpotrs if mine.dtype == torch.float64 else lapack.spotrs
        solution, _ = solved(self._factor.numpy().T, mine.numpy(), lower=0)
        return torch.from_numpy(solution).to(right.dtype)

    def condition(self) -> float:
        """Estimate the condition of the matrix, from below; 1 without unknowns."""
        if len(self) == 0:
            return 1.0
        diagonal = self._factor.diagonal().abs()
        return float((diagonal.max() / diagonal.min()) ** 2)
