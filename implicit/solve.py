"""One step of every edit is this small problem:

    minimise over x   sum_k w_k (a_k . x - y_k)^2  +  x^T diag(damping) x      subject to   C x = r

The rows a_k arrive in blocks. With more rows than unknowns they are summed into the normal matrix; with fewer,
they are kept and the dual system, one unknown a row, is solved instead. Constraints enter by their multipliers
(the KKT system, eliminated blockwise), so they hold to rounding. This file knows no geometry.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import blas
from torch import Tensor

Method = Literal["auto", "primal", "dual"]


class Rows(NamedTuple):
    """A block of weighted equations matrix @ x = target."""

    matrix: Float[Tensor, "k n"]
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]


class SolveStatus(Enum):
    """How a solve ended; the value is the sentence a user reads."""

    SOLVED = "The least-squares problem was solved."
    DAMPED = "The system was too near to singular for the damping given; a larger damping was used."
    REDUNDANT_CONSTRAINTS = "Some constraints say the same or move nothing; they were met in the least-squares sense."
    FAILED = "The system holds NaN or infinite numbers; no step was computed. Check the field and the targets."


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimiser and how good it is."""

    x: Float[Tensor, " n"]
    residual: float  # root of the weighted mean square of a . x - y
    objective: float  # the weighted sum of squares, without the damping
    constraint_residual: float  # largest |C x - r|
    condition: float  # estimate for the damped system, from the factor's diagonal
    damping: float  # what was added to the diagonal, its largest entry
    method: str
    status: SolveStatus


# Damping where none is asked for, relative to the trace of the normal matrix. In float32 the normal matrix itself
# is only good to about 1e-7 of its trace; in float64 the figure trades fit against the size of the step and was
# chosen by the error of geometric edits in 16 parts (1e-8 beats 1e-6 and 1e-10).
RELATIVE_DAMPING = {torch.float32: 1e-7, torch.float64: 1e-8}


class LeastSquares:
    """A problem being assembled, then solved, then asked again for corrections that keep the constraints.

    Args:
        size: Number of unknowns.
        like: A tensor whose dtype and device the rows have.
        method: "primal" sums the normal matrix (size x size), "dual" keeps the rows, "auto" takes the dual while
            the rows are fewer than the unknowns.
    """

    def __init__(self, size: int, like: Tensor, *, method: Method = "auto") -> None:
        if method not in ("auto", "primal", "dual"):
            raise ValueError(f'method must be "auto", "primal" or "dual", but is {method!r}.')
        self.size = size
        self._method = method
        self._like = like
        self._kept: list[Rows] = []
        self._kept_rows = 0
        self._normal: Tensor | None = None
        self._right = torch.zeros(size, dtype=torch.float64, device=like.device)
        self._square = 0.0
        self._weight = 0.0
        self._factor: _Primal | _Dual | None = None

    def add(self, rows: Rows) -> None:
        """Add a block of weighted equations."""
        matrix, target, weights = rows
        self._right += (matrix.T @ (weights * target)).double()
        self._square += float((weights * target * target).sum())
        self._weight += float(weights.sum())
        if self._normal is None:
            self._kept.append(rows)
            self._kept_rows += len(target)
            if self._method == "dual" or (self._method == "auto" and self._kept_rows < self.size):
                return
            # Only its lower triangle is kept.
            self._normal = torch.zeros(self.size, self.size, dtype=self._like.dtype, device=self._like.device)
            for kept in self._kept:
                self._accumulate(kept)
            self._kept = []
        else:
            self._accumulate(rows)

    def _accumulate(self, rows: Rows) -> None:
        assert self._normal is not None
        add_gram(self._normal, rows.matrix * rows.weights.sqrt()[:, None])

    def trace(self) -> float:
        """Trace of the normal matrix, the scale that a relative damping refers to."""
        if self._normal is not None:
            return float(self._normal.diagonal().sum())
        return float(sum((rows.weights[:, None] * rows.matrix**2).sum() for rows in self._kept))

    def diagonal(self) -> Float[Tensor, " n"]:
        """Diagonal of the normal matrix."""
        if self._normal is not None:
            return self._normal.diagonal().double()
        total = torch.zeros_like(self._right)
        for rows in self._kept:
            total += (rows.weights[:, None] * rows.matrix**2).sum(dim=0).double()
        return total

    def solve(
        self,
        damping: float | Float[Tensor, " n"] | None = None,
        constraints: tuple[Float[Tensor, "m n"], Float[Tensor, " m"]] | None = None,
        *,
        relative_damping: float | None = None,
    ) -> Solution:
        """The minimiser.

        Args:
            damping: Penalty on the squares of x, one for all or one each; None takes the relative one.
            constraints: C and r of the equations C x = r that must hold.
            relative_damping: Penalty in units of the trace of the normal matrix; None is RELATIVE_DAMPING.
        """
        if damping is None:
            relative = RELATIVE_DAMPING[self._like.dtype] if relative_damping is None else relative_damping
            damping = relative * self.trace()
        ridge = torch.as_tensor(damping, dtype=torch.float64, device=self._like.device).expand(self.size)
        if not (torch.isfinite(self._right).all() and torch.isfinite(self.diagonal()).all()):
            return self._failed(ridge)
        if bool((ridge < 0).any()):
            raise ValueError(f"damping must not be negative, but is {float(ridge.min()):.3g}.")
        status = SolveStatus.SOLVED
        for _ in range(12):
            factor = self._factorise(ridge)
            if factor is not None:
                break
            # Rounding made the matrix indefinite: the least damping that the precision can carry, then more.
            ridge = torch.maximum(10 * ridge, torch.full_like(ridge, 1e-14 * self.trace() + 1e-300))
            status = SolveStatus.DAMPED
        else:
            return self._failed(ridge)
        self._factor = factor
        x = factor.inverse(self._right[:, None])[:, 0]
        gap = 0.0
        if constraints is not None:
            C, r = (part.double() for part in constraints)
            if not (torch.isfinite(C).all() and torch.isfinite(r).all()):
                return self._failed(ridge)
            correction, redundant = _to_meet(factor, C, r - C @ x)
            x = x + correction
            gap = float((C @ x - r).abs().max()) if len(r) else 0.0
            status = SolveStatus.REDUNDANT_CONSTRAINTS if redundant else status
        if not bool(torch.isfinite(x).all()):
            return self._failed(ridge)
        objective = self._objective(x)
        return Solution(
            x=x.to(self._like.dtype),
            residual=(objective / self._weight) ** 0.5 if self._weight > 0 else 0.0,
            objective=objective,
            constraint_residual=gap,
            condition=factor.condition,
            damping=float(ridge.max()),
            method=factor.name,
            status=status,
        )

    def correction(self, C: Float[Tensor, "m n"], r: Float[Tensor, " m"]) -> Float[Tensor, " n"]:
        """The change of x with C x = r that raises the last solved problem's objective least."""
        if self._factor is None:
            raise RuntimeError("correction needs a solved problem: call solve first.")
        return _to_meet(self._factor, C.double(), r.double())[0].to(self._like.dtype)

    def _factorise(self, ridge: Tensor) -> _Primal | _Dual | None:
        if self._normal is not None:
            return _Primal.of(self._normal, ridge)
        return _Dual.of(self._kept, ridge, self._right)

    def _objective(self, x: Tensor) -> float:
        if self._normal is None:
            return float(sum((r.weights * (r.matrix @ x.to(r.matrix) - r.target) ** 2).sum() for r in self._kept))
        v = x.to(self._normal)
        half = self._normal.tril() @ v
        curved = float(2 * (v @ half) - v @ (self._normal.diagonal() * v))
        # Cancellation can leave a small negative number where the fit is all but exact.
        return max(0.0, self._square - 2 * float(self._right @ x) + curved)

    def _failed(self, ridge: Tensor) -> Solution:
        nan = float("nan")
        zero = torch.zeros(self.size, dtype=self._like.dtype, device=self._like.device)
        return Solution(zero, nan, nan, nan, nan, float(ridge.max()), "none", SolveStatus.FAILED)


def least_squares(
    blocks: Iterable[Rows],
    size: int,
    like: Tensor,
    *,
    damping: float | Tensor | None = None,
    constraints: tuple[Tensor, Tensor] | None = None,
    method: Method = "auto",
) -> Solution:
    """Assemble and solve in one call; see LeastSquares."""
    problem = LeastSquares(size, like, method=method)
    for rows in blocks:
        problem.add(rows)
    return problem.solve(damping, constraints)


def add_gram(total: Float[Tensor, "n n"], rows: Float[Tensor, "k n"]) -> None:
    """Add the lower triangle of rows^T rows to the total, in place.

    On the CPU by the symmetric rank-k product of BLAS, half the work of a full one.
    """
    if total.device.type != "cpu" or total.dtype not in (torch.float32, torch.float64):
        total.addmm_(rows.T, rows)
        return
    product = blas.dsyrk if total.dtype == torch.float64 else blas.ssyrk
    # The transposes are Fortran-ordered views; the upper triangle there is the lower one here.
    out = total.numpy().T
    result = product(1.0, rows.contiguous().numpy().T, beta=1.0, c=out, overwrite_c=1)
    if result is not out and not np.shares_memory(result, out):
        out[...] = result


class _Primal:
    """Cholesky factor of the damped normal matrix, in float64 whatever the rows' precision."""

    name = "primal"

    def __init__(self, factor: Tensor) -> None:
        self._factor = factor
        diagonal = factor.diagonal()
        self.condition = float((diagonal.max() / diagonal.min()) ** 2)

    @classmethod
    def of(cls, normal: Tensor, ridge: Tensor) -> _Primal | None:
        damped = normal.double().clone()
        damped.diagonal().add_(ridge)
        factor, info = torch.linalg.cholesky_ex(damped)
        return cls(factor) if int(info) == 0 else None

    def inverse(self, right: Tensor) -> Tensor:
        return torch.cholesky_solve(right, self._factor)


class _Dual:
    """The inverse of A^T W A + D by way of A D^-1 A^T + W^-1, one unknown a row (Woodbury)."""

    name = "dual"

    def __init__(self, matrix: Tensor, ridge: Tensor, factor: Tensor) -> None:
        self._matrix, self._ridge, self._factor = matrix, ridge, factor
        diagonal = factor.diagonal()
        self.condition = float((diagonal.max() / diagonal.min()) ** 2) if len(diagonal) else 1.0

    @classmethod
    def of(cls, kept: list[Rows], ridge: Tensor, like: Tensor) -> _Dual | None:
        if not bool((ridge > 0).all()):
            return None  # without damping the dual has no meaning; the caller raises it
        # Rows of weight zero say nothing; scaling by the root of the weight makes W the identity.
        blocks = [rows.matrix.double() * rows.weights.double().sqrt()[:, None] for rows in kept]
        matrix = torch.cat(blocks) if blocks else like.new_zeros(0, len(like))
        gram = (matrix / ridge) @ matrix.T
        gram.diagonal().add_(1.0)
        factor, info = torch.linalg.cholesky_ex(gram)
        return cls(matrix, ridge, factor) if int(info) == 0 else None

    def inverse(self, right: Tensor) -> Tensor:
        scaled = right / self._ridge[:, None]
        inner = torch.cholesky_solve(self._matrix @ scaled, self._factor)
        return scaled - (self._matrix.T @ inner) / self._ridge[:, None]


def _to_meet(factor: _Primal | _Dual, C: Tensor, gap: Tensor) -> tuple[Tensor, bool]:
    """The cheapest x with C x = gap in the metric of the factor, and whether C was rank deficient."""
    if len(gap) == 0:
        return C.new_zeros(C.shape[1]), False
    # Scaling each constraint to unit length makes the test for rank independent of its units.
    length = C.norm(dim=1)
    live = length > 0
    unit, wanted = C[live] / length[live, None], gap[live] / length[live]
    if not bool(live.any()):
        return C.new_zeros(C.shape[1]), True
    lifted = factor.inverse(unit.T)
    schur = unit @ lifted
    schur = (schur + schur.T) / 2
    values, vectors = torch.linalg.eigh(schur)
    keep = values > 1e-13 * values.max()
    multipliers = vectors[:, keep] @ ((vectors[:, keep].T @ wanted) / values[keep])
    x = lifted @ multipliers
    # One refinement takes out the rounding of the first solve.
    again = wanted - unit @ x
    x = x + lifted @ (vectors[:, keep] @ ((vectors[:, keep].T @ again) / values[keep]))
    return x, not bool(keep.all() and live.all())
