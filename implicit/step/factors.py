"""The inverse of the damped normal matrix of a step, H = A^T W A + D, in four forms.

| form | what is factored | cost, n unknowns and k equations |
|---|---|---|
| Primal | H, by Cholesky | n^2 k to assemble, n^3 / 3 |
| Dual | I + W^1/2 A D^-1 A^T W^1/2, by Cholesky (Woodbury) | n k^2 to assemble, k^3 / 3 |
| Qr | the rows W^1/2 A above D^1/2, orthogonally: their condition is not squared | 2 n^2 (n + k) |
| Cg | nothing but a random sketch of H | products with H |

All work in float64, whatever the precision of the equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch
from jaxtyping import Float
from scipy.linalg import lapack
from torch import Tensor


class Factor(Protocol):
    """H^-1, and what is known of H."""

    name: str
    condition: float

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        """H^-1 times the columns."""

    def minimiser(self, right: Float[Tensor, " n"], target: Float[Tensor, " k"]) -> Float[Tensor, " n"]:
        """H^-1 A^T W y from right = A^T W y, or from target = W^1/2 y, whichever is more exact."""

    def rank(self) -> float:
        """trace of A^T W A H^-1, the number of unknowns that the equations decide; an estimate."""


class Cholesky:
    """Triangular factor of a symmetric positive definite matrix, and its inverse.

    On the CPU by LAPACK as scipy calls it, in place: torch copies the matrix into its order before it factors it, and
    the factor again for each solve.
    """

    def __init__(self, factor: Float[Tensor, "n n"]) -> None:
        self._factor = factor  # of its lower triangle only

    @classmethod
    def of(cls, matrix: Float[Tensor, "n n"]) -> Cholesky | None:
        """From the lower triangle of a float64 matrix, which is used up; None if it is not positive definite."""
        if len(matrix) == 0 or matrix.device.type != "cpu":
            factor, info = torch.linalg.cholesky_ex(matrix)
            return cls(factor) if int(info) == 0 else None
        # The transpose is a Fortran-ordered view; the upper triangle there is the lower one here.
        result, info = lapack.dpotrf(matrix.numpy().T, lower=0, clean=0, overwrite_a=1)
        return cls(torch.from_numpy(result.T)) if info == 0 else None

    def __len__(self) -> int:
        return len(self._factor)

    @property
    def device(self) -> torch.device:
        return self._factor.device

    def solve(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        """The inverse of the matrix times the columns."""
        if len(self) == 0 or self.device.type != "cpu":
            return torch.cholesky_solve(right, self._factor)
        solution, _ = lapack.dpotrs(self._factor.numpy().T, right.numpy(), lower=0)
        return torch.from_numpy(solution)

    def condition(self) -> float:
        """An estimate, from below, of the condition of the matrix."""
        return _condition(self._factor)


class _FromRight:
    """A factor that takes the right-hand side as it is."""

    def inverse(self, right: Tensor) -> Tensor:
        raise TypeError("Each factor has its own inverse.")

    def minimiser(self, right: Tensor, target: Tensor) -> Tensor:
        return self.inverse(right[:, None])[:, 0]


class _Direct(_FromRight):
    """A factor whose inverse is cheap enough to estimate the rank with it."""

    def __init__(self, ridge: Tensor, seed: int) -> None:
        self._ridge, self._seed = ridge, seed

    def rank(self) -> float:
        n = len(self._ridge)
        lost = _trace(n, lambda z: self._ridge[:, None] * self.inverse(z), self._ridge, self._seed)
        return min(float(n), max(0.0, n - lost))


class Primal(_Direct):
    """Cholesky factor of H."""

    name = "primal"

    def __init__(self, factor: Cholesky, ridge: Tensor, seed: int) -> None:
        super().__init__(ridge, seed)
        self._factor = factor
        self.condition = factor.condition()

    @classmethod
    def of(cls, normal: Float[Tensor, "n n"], ridge: Float[Tensor, " n"], seed: int) -> Primal | None:
        """From the lower triangle of A^T W A; None where it is not positive definite with so little damping."""
        damped = normal.to(torch.float64, copy=True)
        damped.diagonal().add_(ridge)
        factor = Cholesky.of(damped)
        return None if factor is None else cls(factor, ridge, seed)

    def inverse(self, right: Tensor) -> Tensor:
        return self._factor.solve(right)


class Qr(_Direct):
    """Triangular factor of the rows with the roots of the damping below."""

    name = "qr"

    def __init__(self, factor: Tensor, ridge: Tensor, seed: int) -> None:
        super().__init__(ridge, seed)
        self._factor = factor
        self.condition = _condition(factor)

    @classmethod
    def of(cls, rows: Float[Tensor, "k n"], ridge: Float[Tensor, " n"], seed: int) -> Qr | None:
        """From W^1/2 A; None where the rows and the damping leave an unknown undecided."""
        factor = torch.linalg.qr(torch.cat([rows, torch.diag(ridge.sqrt())]), mode="r")[1]
        diagonal = factor.diagonal().abs()
        return cls(factor, ridge, seed) if bool(diagonal.min() > 1e-15 * diagonal.max()) else None

    def inverse(self, right: Tensor) -> Tensor:
        inner = torch.linalg.solve_triangular(self._factor.T, right, upper=False)
        return torch.linalg.solve_triangular(self._factor, inner, upper=True)


class Dual(_FromRight):
    """Cholesky factor of I + W^1/2 A D^-1 A^T W^1/2.

    The minimiser is D^-1 A^T W^1/2 times what that factor makes of W^1/2 y; the general inverse subtracts, and loses
    as many digits as the damping is below the trace.
    """

    name = "dual"

    def __init__(
        self,
        factor: Cholesky,
        forward: Callable[[Tensor], Tensor],
        adjoint: Callable[[Tensor], Tensor],
        ridge: Tensor,
        seed: int,
    ) -> None:
        self._factor, self._forward, self._adjoint, self._ridge, self._seed = factor, forward, adjoint, ridge, seed
        self.condition = factor.condition() if len(factor) else 1.0

    @classmethod
    def of(
        cls,
        gram: Float[Tensor, "k k"],
        forward: Callable[[Tensor], Tensor],
        adjoint: Callable[[Tensor], Tensor],
        ridge: Float[Tensor, " n"],
        seed: int,
    ) -> Dual | None:
        """From the lower triangle of W^1/2 A D^-1 A^T W^1/2.

        Args:
            forward, adjoint: Products of W^1/2 A and of its transpose with vectors.
        """
        damped = gram.clone()
        damped.diagonal().add_(1.0)
        factor = Cholesky.of(damped)
        return None if factor is None else cls(factor, forward, adjoint, ridge, seed)

    def minimiser(self, right: Tensor, target: Tensor) -> Tensor:
        return self._adjoint(self._factor.solve(target[:, None])[:, 0]) / self._ridge

    def inverse(self, right: Tensor) -> Tensor:
        scaled = right / self._ridge[:, None]
        image = torch.stack([self._forward(column) for column in scaled.T], dim=1)
        inner = self._factor.solve(image)
        return scaled - torch.stack([self._adjoint(column) for column in inner.T], dim=1) / self._ridge[:, None]

    def rank(self) -> float:
        # Of the same trace, taken among the equations: their products with the unknowns may be passes of a network.
        k = len(self._factor)
        lost = _trace(k, self._factor.solve, self._ridge, self._seed)
        return min(float(k), max(0.0, k - lost))


class Cg(_FromRight):
    """Conjugate gradients on D^-1/2 A^T W A D^-1/2 + I, preconditioned by a low-rank approximation of its first term.

    The approximation is Nystrom's from products with random vectors [Frangella, Tropp, Udell, SIAM J. Matrix Anal.
    Appl. 2023, algorithm 2.1]; it takes the large eigenvalues out of the spectrum, which for the sensitivities of a
    network are few and all but fill it.
    """

    name = "cg"
    iterations = 1000

    def __init__(
        self, apply: Callable[[Tensor], Tensor], ridge: Tensor, like: Tensor, rank: int, tolerance: float, seed: int
    ) -> None:
        """apply: A^T W A times a vector like `like`."""
        self._apply, self._like, self._tolerance = apply, like, tolerance
        self._root = ridge.sqrt()
        self.converged = True
        n = len(ridge)
        self._basis, self._values = self._nystrom(n, rank, seed) if rank > 0 else (ridge.new_zeros(n, 0), ridge[:0])
        self.condition = float(self._values[0]) + 1 if len(self._values) else float("nan")

    def _scaled(self, x: Tensor) -> Tensor:
        """D^-1/2 A^T W A D^-1/2 x."""
        return self._apply((x / self._root).to(self._like)).double() / self._root

    def _nystrom(self, n: int, rank: int, seed: int) -> tuple[Tensor, Tensor]:
        generator = torch.Generator().manual_seed(seed)
        test = torch.randn(n, rank, generator=generator, dtype=torch.float64).to(self._root.device)
        test = torch.linalg.qr(test)[0]
        image = torch.stack([self._scaled(v) for v in test.T], dim=1)
        shift = float(torch.finfo(self._like.dtype).eps * image.norm())
        image = image + shift * test
        inner = test.T @ image
        factor, info = torch.linalg.cholesky_ex((inner + inner.T) / 2)
        if int(info) != 0:
            return test[:, :0], self._root[:0]
        half = torch.linalg.solve_triangular(factor, image.T, upper=False).T
        basis, values, _ = torch.linalg.svd(half, full_matrices=False)
        return basis, (values**2 - shift).clamp(min=0)

    def _precondition(self, x: Tensor) -> Tensor:
        if not len(self._values):
            return x
        part = self._basis.T @ x
        floor = self._values[-1] + 1
        return x + self._basis @ ((floor / (self._values + 1) - 1) * part)

    def inverse(self, right: Tensor) -> Tensor:
        columns = [self._one(column / self._root) / self._root for column in right.T]
        return torch.stack(columns, dim=1)

    def _one(self, right: Tensor) -> Tensor:
        x = torch.zeros_like(right)
        residual = right.clone()
        goal = self._tolerance * float(right.norm())
        z = self._precondition(residual)
        direction, slope = z.clone(), float(residual @ z)
        for _ in range(self.iterations):
            if float(residual.norm()) <= goal:
                return x
            image = self._scaled(direction) + direction
            length = slope / float(direction @ image)
            x = x + length * direction
            residual = residual - length * image
            z = self._precondition(residual)
            new = float(residual @ z)
            direction, slope = z + (new / slope) * direction, new
        self.converged = self.converged and float(residual.norm()) <= 1e3 * goal
        return x

    def rank(self) -> float:
        return float((self._values / (self._values + 1)).sum()) if len(self._values) else float("nan")


def random_signs(n: int, count: int, seed: int) -> Float[Tensor, "n count"]:
    """Random signs, the probes of Hutchinson's estimates: the mean of z^T M z over them is the trace of M."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 2, (n, count), generator=generator).double() * 2 - 1


def _trace(n: int, apply: Callable[[Tensor], Tensor], like: Tensor, seed: int) -> float:
    """Trace of an operator on n numbers: exact where that is cheap, else to a few times its root."""
    if n <= 256:
        return float(apply(torch.eye(n).to(like)).diagonal().sum())
    z = random_signs(n, 8, seed).to(like)
    return float((z * apply(z)).sum() / z.shape[1])


def _condition(factor: Tensor) -> float:
    """An estimate, from below, of the condition of H from a triangular factor of it."""
    diagonal = factor.diagonal().abs()
    return float((diagonal.max() / diagonal.min()) ** 2)
