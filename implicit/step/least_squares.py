"""One step of every edit is this small problem:

    minimise over x   sum_k w_k (a_k . x - y_k)^2  +  x^T diag(damping) x      subject to   C x = r

| method | what it does | good for |
|---|---|---|
| primal | Cholesky factor of the normal matrix, in blocks | more rows than unknowns, up to some 8000 of these |
| dual | Cholesky factor of the system with one unknown a row (Woodbury) | fewer rows than unknowns |
| qr | orthogonal factor of the stacked rows | ill-conditioned systems with little damping |
| cg | conjugate gradients, preconditioned by a random sketch (Nystrom) | anything large; needs only products |

Constraints enter by their multipliers (the KKT system, eliminated blockwise), so they hold to rounding in each.
This file knows no geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import blas
from torch import Tensor

from implicit.step.factors import Cg, Dual, Factor, Primal, Qr, random_signs

Method = Literal["auto", "primal", "dual", "qr", "cg"]
METHODS = ("auto", "primal", "dual", "qr", "cg")

# Above this many unknowns (and rows) the factor of a dense matrix costs more than conjugate gradients.
DENSE_LIMIT = 8000


class Rows(NamedTuple):
    """A block of weighted equations matrix @ x[first : first + m] = target, which leave the other unknowns out."""

    matrix: Float[Tensor, "k m"]
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]
    first: int = 0

    @property
    def columns(self) -> slice:
        """Of which unknowns they are."""
        return slice(self.first, self.first + self.matrix.shape[1])

    def rooted(self) -> Float[Tensor, "k m"]:
        """W^1/2 A."""
        return self.matrix * self.weights.sqrt()[:, None]


class Operator(NamedTuple):
    """Weighted equations known by their products alone."""

    forward: Callable[[Tensor], Tensor]  # x (n,) to the left-hand sides (k,)
    adjoint: Callable[[Tensor], Tensor]  # (k,) to (n,)
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]
    gram: Callable[[], Tensor] | None = None  # the products of the equations with each other (k, k), if they are cheap


class SolveStatus(Enum):
    """How a solve ended; the value is the sentence a user reads."""

    SOLVED = "The least-squares problem was solved."
    DAMPED = "The system was too near to singular for the damping given; a larger damping was used."
    REDUNDANT_CONSTRAINTS = "Some constraints say the same or move nothing; they were met in the least-squares sense."
    SLOW = "Conjugate gradients stopped at the iteration limit before their tolerance; raise the damping or the rank."
    FAILED = "The system holds NaN or infinite numbers; no step was computed. Check the field and the targets."


@dataclass(frozen=True, eq=False)
class Solution:
    """The minimiser and how good it is."""

    x: Float[Tensor, " n"]
    residual: float  # root of the weighted mean square of a . x - y
    objective: float  # the weighted sum of squares, without the damping
    constraint_residual: float  # largest |C x - r|
    condition: float  # estimate for the damped system, from the factor's diagonal or the preconditioner
    rank: float  # effective: trace of G (G + damping)^-1, the number of unknowns that the rows decide; estimated
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
        method: See the table above. "auto" takes the dual while the rows are fewer than the unknowns, the primal up to
            DENSE_LIMIT unknowns, and conjugate gradients beyond or where equations are known by their products alone;
            of these it takes the dual where it can (see add_operator) and up to DENSE_LIMIT of them.
        rank: Of the preconditioner of "cg"; 0 for none.
        tolerance: Relative residual at which "cg" stops; None is 1e-12 in float64, 1e-5 in float32.
        seed: Of the preconditioner and of the estimate of the rank.
    """

    def __init__(
        self,
        size: int,
        like: Tensor,
        *,
        method: Method = "auto",
        rank: int = 200,
        tolerance: float | None = None,
        seed: int = 0,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"method must be one of {', '.join(METHODS)}, but is {method!r}.")
        self.size = size
        self._method = method
        self._like = like
        self._rank = min(rank, size)
        self._tolerance = tolerance if tolerance is not None else (1e-12 if like.dtype == torch.float64 else 1e-5)
        self._seed = seed
        self._kept: list[Rows] = []
        self._kept_rows = 0
        self._operators: list[Operator] = []
        self._normal: Tensor | None = None
        self._right = torch.zeros(size, dtype=torch.float64, device=like.device)
        self._square = 0.0
        self._weight = 0.0
        # Of what was added so far, kept from one solve to the next: a step tries several dampings.
        self._trace: float | None = None
        self._gram: Tensor | None = None
        self._factor: Factor | None = None

    def add(self, rows: Rows) -> None:
        """Add a block of weighted equations."""
        self._right[rows.columns] += (rows.matrix.T @ (rows.weights * rows.target)).double()
        self._count(rows)
        if self._normal is None:
            self._kept.append(rows)
            self._kept_rows += len(rows.target)
            few = self._kept_rows < self.size or self.size > DENSE_LIMIT
            if self._method in ("dual", "qr", "cg") or (self._method == "auto" and few):
                return
            # Only its lower triangle is kept.
            self._normal = torch.zeros(self.size, self.size, dtype=self._like.dtype, device=self._like.device)
            for kept in self._kept:
                self._accumulate(kept)
            self._kept = []
        else:
            self._accumulate(rows)

    def add_operator(self, operator: Operator) -> None:
        """Add equations known by their products, for conjugate gradients.

        The dual takes them if they are the only equations and know their Gram matrix, and the damping is one number.
        """
        if self._method not in ("auto", "cg", "dual"):
            raise ValueError(
                f'Equations known by their products need method "cg", "dual" or "auto", not {self._method!r}.'
            )
        if self._normal is not None:
            raise ValueError("Add equations known by their products before those with a matrix.")
        self._operators.append(operator)
        self._right += operator.adjoint(operator.weights * operator.target).double()
        self._count(operator)

    def _count(self, equations: Rows | Operator) -> None:
        self._trace = self._gram = None
        self._square += float((equations.weights * equations.target**2).sum())
        self._weight += float(equations.weights.sum())

    def _accumulate(self, rows: Rows) -> None:
        assert self._normal is not None
        if rows.matrix.shape[1] == self.size:
            add_gram(self._normal, rows.rooted())
        elif rows.matrix.numel() > 0:
            self._normal[rows.columns, rows.columns] += _gram(rows.rooted().T)

    def trace(self) -> float:
        """Trace of the normal matrix, the scale that a relative damping refers to."""
        if self._trace is None:
            if not self._operators:
                self._trace = float(self.diagonal().sum())
            elif self._method != "cg" and self._has_gram():
                self._trace = float(self._weighted_gram().diagonal().sum())
            else:
                # Hutchinson's estimate: the mean of z^T G z over random signs z.
                z = random_signs(self.size, 4, self._seed).to(self._like)
                self._trace = float(sum(v @ self._apply(v) for v in z.T) / z.shape[1])
        return self._trace

    def diagonal(self) -> Float[Tensor, " n"]:
        """Diagonal of the normal matrix, of the equations that have a matrix."""
        if self._normal is not None:
            return self._normal.diagonal().double()
        total = torch.zeros_like(self._right)
        for rows in self._kept:
            total[rows.columns] += (rows.weights[:, None] * rows.matrix**2).sum(dim=0).double()
        return total

    def _apply(self, x: Tensor) -> Tensor:
        """The normal matrix times x."""
        total = torch.zeros_like(x)
        for rows in self._kept:
            total[rows.columns] += rows.matrix.T @ (rows.weights * (rows.matrix @ x[rows.columns]))
        for operator in self._operators:
            total += operator.adjoint(operator.weights * operator.forward(x))
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
        scale = self.trace()
        if damping is None:
            damping = (RELATIVE_DAMPING[self._like.dtype] if relative_damping is None else relative_damping) * scale
        ridge = torch.as_tensor(damping, dtype=torch.float64, device=self._like.device).expand(self.size)
        if not (torch.isfinite(self._right).all() and np.isfinite(scale)):
            return self._failed(ridge)
        if bool((ridge < 0).any()):
            raise ValueError(f"damping must not be negative, but is {float(ridge.min()):.3g}.")
        status = SolveStatus.SOLVED
        for _ in range(12):
            factor = self._factorise(ridge)
            if factor is not None:
                break
            # Rounding made the matrix indefinite: the least damping that the precision can carry, then more.
            ridge = torch.maximum(10 * ridge, torch.full_like(ridge, 1e-14 * scale + 1e-300))
            status = SolveStatus.DAMPED
        else:
            return self._failed(ridge)
        self._factor = factor
        x = factor.minimiser(self._right, self._rooted_targets())
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
        if isinstance(factor, Cg) and not factor.converged:
            status = SolveStatus.SLOW
        objective = self._objective(x)
        return Solution(
            x=x.to(self._like.dtype),
            residual=(objective / self._weight) ** 0.5 if self._weight > 0 else 0.0,
            objective=objective,
            constraint_residual=gap,
            condition=factor.condition,
            rank=factor.rank(),
            damping=float(ridge.max()),
            method=factor.name,
            status=status,
        )

    def correction(self, C: Float[Tensor, "m n"], r: Float[Tensor, " m"]) -> Float[Tensor, " n"]:
        """The change of x with C x = r that raises the last solved problem's objective least."""
        if self._factor is None:
            raise RuntimeError("correction needs a solved problem: call solve first.")
        return _to_meet(self._factor, C.double(), r.double())[0].to(self._like.dtype)

    def inverse(self, right: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """(A^T W A + damping)^-1 right, of the last solved problem."""
        if self._factor is None:
            raise RuntimeError("inverse needs a solved problem: call solve first.")
        return self._factor.inverse(right.double()[:, None])[:, 0]

    @property
    def right(self) -> Float[Tensor, " n"]:
        """A^T W y, in float64."""
        return self._right

    def _factorise(self, ridge: Tensor) -> Factor | None:
        if self._normal is not None:
            return Primal.of(self._normal, ridge, self._seed)
        method = self._method
        even = bool((ridge == ridge[0]).all())
        if method == "auto" and self._operators:
            method = "dual" if even and self._has_gram() else "cg"
        elif method == "auto":
            method = "dual" if self._kept_rows <= DENSE_LIMIT else "cg"
        if method == "qr":
            return Qr.of(self._rooted_rows(), ridge, self._seed)
        if not bool((ridge > 0).all()):
            return None  # the dual and the scaling of "cg" divide by the damping; the caller raises it
        if method == "cg":
            return Cg(self._apply, ridge, self._like, self._rank, self._tolerance, self._seed)
        if self._operators:
            if not (even and self._has_gram()):
                raise ValueError(
                    'Method "dual" takes equations known by their products only if they are the only ones and know '
                    'their Gram matrix, and the damping is one number; take method "cg".'
                )
            root = self._operators[0].weights.double().sqrt()
            return Dual.of(
                self._weighted_gram() / ridge[0],
                lambda x: root * self._operators[0].forward(x.to(self._like)).double(),
                lambda y: self._operators[0].adjoint((root * y).to(self._like)).double(),
                ridge,
                self._seed,
            )
        rows = self._rooted_rows()
        if even:
            gram = self._weighted_gram() / ridge[0]
        else:
            gram = _gram(rows / ridge.sqrt())
        return Dual.of(gram, lambda x: rows @ x, lambda y: rows.T @ y, ridge, self._seed)

    def _has_gram(self) -> bool:
        """Whether all there is are equations known by products, those with each other included, and not too many."""
        if len(self._operators) != 1 or self._kept:
            return False
        operator = self._operators[0]
        return operator.gram is not None and len(operator.target) <= min(self.size, DENSE_LIMIT)

    def _weighted_gram(self) -> Tensor:
        """Lower triangle of W^1/2 A A^T W^1/2."""
        if self._gram is None:
            if self._operators:
                operator = self._operators[0]
                assert operator.gram is not None
                root = operator.weights.double().sqrt()
                self._gram = operator.gram().double().mul_(root).mul_(root[:, None])
            else:
                self._gram = _gram(self._rooted_rows())
        return self._gram

    def _rooted_rows(self) -> Tensor:
        """W^1/2 A."""
        blocks = []
        for rows in self._kept:
            precise = rows._replace(matrix=rows.matrix.double(), weights=rows.weights.double())
            others = rows.columns.start, self.size - rows.columns.stop
            blocks.append(torch.nn.functional.pad(precise.rooted(), others))
        return torch.cat(blocks) if blocks else self._right.new_zeros(0, self.size)

    def _rooted_targets(self) -> Tensor:
        """W^1/2 y of the equations that are kept."""
        kept: list[Rows | Operator] = [*self._kept, *self._operators]
        parts = [equations.weights.double().sqrt() * equations.target.double() for equations in kept]
        return torch.cat(parts) if parts else self._right[:0]

    def _objective(self, x: Tensor) -> float:
        if self._normal is None:
            v = x.to(self._like)
            misses = [(r.weights, r.matrix @ v[r.columns] - r.target) for r in self._kept]
            misses += [(o.weights, o.forward(v) - o.target) for o in self._operators]
            return float(sum((weights * miss**2).sum() for weights, miss in misses))
        v = x.to(self._normal)
        curved = float(v @ _of_lower(self._normal, v))
        # Cancellation can leave a small negative number where the fit is all but exact.
        return max(0.0, self._square - 2 * float(self._right @ x) + curved)

    def _failed(self, ridge: Tensor) -> Solution:
        nan = float("nan")
        zero = torch.zeros(self.size, dtype=self._like.dtype, device=self._like.device)
        return Solution(zero, nan, nan, nan, nan, nan, float(ridge.max()), "none", SolveStatus.FAILED)


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


def _of_lower(lower: Float[Tensor, "n n"], x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """The symmetric matrix with this lower triangle times x."""
    if x.device.type == "cpu" and x.dtype in (torch.float32, torch.float64) and len(x) > 0:
        product = blas.dsymv if x.dtype == torch.float64 else blas.ssymv
        return torch.from_numpy(product(1.0, lower.numpy().T, x.numpy(), lower=0))
    half = lower.tril()
    return half @ x + half.T @ x - lower.diagonal() * x


def _gram(rows: Float[Tensor, "k n"]) -> Float[Tensor, "k k"]:
    """Lower triangle of rows rows^T."""
    total = rows.new_zeros(len(rows), len(rows))
    add_gram(total, rows.T)
    return total


def _to_meet(factor: Factor, C: Tensor, gap: Tensor) -> tuple[Tensor, bool]:
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
