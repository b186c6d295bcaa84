"""Equations in which most unknowns do not appear, as of features on grids, and the smaller of their two forms.

An unknown that no equation holds has a damped solution of exactly zero, so that only the others are factored:

| among the n unknowns that appear, k equations | form |
|---|---|
| n <= k | primal: the normal matrix of those unknowns |
| k < n | dual: one unknown an equation |
| both above DIRECT_LIMIT | conjugate gradients with sparse products |

Columns that many equations hold (of a decoder, of a coarse level) are kept as a dense matrix, the others sparse.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse import csr_array, vstack
from torch import Tensor

from implicit.step.equations import Equations, Rows
from implicit.step.factors import ConjugateGradients, Dual, Factor, Primal

# The largest matrix that is factored. Measured on a dense grid, a hash grid and tri-planes: conjugate gradients take 50
# to 90 products at a relative damping of 1e-5 and 300 to 600 at 1e-7, which is less than the factor beyond 3000 or so.
DIRECT_LIMIT = 3000

# Columns of which more than this share is filled are dense.
DENSE_SHARE = 1 / 8


class SparseRows(NamedTuple):
    """A block of weighted equations matrix @ x = target over all unknowns, most of whose coefficients are zero."""

    matrix: csr_array  # (k, n), float64
    target: Float[Tensor, " k"]
    weights: Float[Tensor, " k"]

    def __repr__(self) -> str:
        k, n = self.matrix.shape
        return f"SparseRows({k} equations in {n} unknowns, {self.matrix.nnz / max(k, 1):.0f} in each)"


class SparseEquations(Equations):
    """Equations with sparse rows, all kept. They are held and multiplied on the CPU."""

    def __init__(self, size: int, like: Tensor, tolerance: float = 1e-12, seed: int = 0) -> None:
        super().__init__(size, like, tolerance, seed)
        self._blocks: list[csr_array] = []
        self._targets: list[Tensor] = []

    def add(self, rows: Rows | SparseRows) -> None:
        """Add a block of equations, with a sparse matrix or a dense one."""
        if isinstance(rows, Rows):
            part = csr_array(rows.matrix.double().cpu().numpy())
            columns, ends = part.indices + rows.first, part.indptr
            rows = SparseRows(
                csr_array((part.data, columns, ends), shape=(len(rows.target), self.size)), rows.target, rows.weights
            )
        root = rows.weights.double().sqrt()
        scaled = csr_array(rows.matrix.multiply(root.cpu().numpy()[:, None]))
        target = root * rows.target.double()
        self._blocks.append(scaled)
        self._targets.append(target)
        self.right += self._on_device(scaled.T @ target.cpu().numpy())
        self.square += float(target.square().sum())
        self.weight += float(rows.weights.sum())

    @cached_property
    def _matrix(self) -> csr_array:
        """W^1/2 A over all unknowns."""
        if not self._blocks:
            return csr_array((0, self.size))
        return self._blocks[0] if len(self._blocks) == 1 else vstack(self._blocks, format="csr")

    @cached_property
    def _split(self) -> _Split:
        return _Split.of(self._matrix)

    def rooted_targets(self) -> Float[Tensor, " k"]:
        return torch.cat(self._targets) if self._targets else self.right[:0]

    def trace(self) -> float:
        return float(np.square(self._matrix.data).sum())

    def objective(self, x: Float[Tensor, " n"]) -> float:
        return float((self._forward(x.double()) - self.rooted_targets()).square().sum())

    def factorise(self, ridge: Float[Tensor, " n"]) -> Factor | None:
        if not bool((ridge > 0).all()):
            return None  # of the unknowns that do not appear nothing but the damping tells
        split, count = self._split, self._matrix.shape[0]
        active = torch.from_numpy(split.active).to(ridge.device)
        if len(split.active) <= min(count, DIRECT_LIMIT):
            primal = Primal.of(self._on_device(split.normal()), ridge[active], self.seed)
            return None if primal is None else OfActive(primal, active, ridge)
        if count <= DIRECT_LIMIT:
            gram = self._on_device(split.gram(1 / ridge.cpu().numpy()))
            return Dual.of(gram, self._forward, self._adjoint, ridge, self.seed)
        products = ConjugateGradients(
            lambda x: self._on_device(split.product(x.cpu().numpy())), ridge[active], self.right, self.tolerance
        )
        return OfActive(products, active, ridge)

    def _forward(self, x: Tensor) -> Tensor:
        return self._on_device(self._matrix @ x.cpu().numpy())

    def _adjoint(self, y: Tensor) -> Tensor:
        return self._on_device(self._matrix.T @ y.cpu().numpy())

    def _on_device(self, numbers: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(numbers)).to(self.right.device)

    def __repr__(self) -> str:
        k, n = self._matrix.shape
        return f"SparseEquations({k} equations in {n} unknowns, {len(self._split.active)} of which appear)"


class OfActive(Factor):
    """The inverse of a matrix that is diagonal but for a block: that block's factor, and the diagonal elsewhere.

    Args:
        factor: Of the block.
        active: Unknowns of the block.
        ridge: Diagonal elsewhere (n,), in float64.
    """

    def __init__(self, factor: Factor, active: Tensor, ridge: Float[Tensor, " n"]) -> None:
        self._factor, self._active, self._ridge = factor, active, ridge
        self.name, self.condition = factor.name, factor.condition

    @property
    def converged(self) -> bool:  # type: ignore[override]  # it may change with each inverse
        """True if all inverses taken so far are exact to the tolerance."""
        return self._factor.converged

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        result = right / self._ridge[:, None]
        result[self._active] = self._factor.inverse(right[self._active])
        return result

    def rank(self) -> float:
        return self._factor.rank()


class _Split(NamedTuple):
    """The columns of a matrix that hold anything, in their order: the full ones dense, the others sparse."""

    active: np.ndarray  # the unknowns
    full: np.ndarray  # which of the active are dense (n,) bool
    dense: np.ndarray  # (k, q)
    sparse: csr_array  # (k, n - q)

    @classmethod
    def of(cls, matrix: csr_array) -> _Split:
        filled = np.bincount(matrix.indices, minlength=matrix.shape[1])
        active = np.flatnonzero(filled)
        full = filled[active] > DENSE_SHARE * matrix.shape[0]
        by_column = matrix.tocsc()
        return cls(active, full, by_column[:, active[full]].toarray(), csr_array(by_column[:, active[~full]]))

    def product(self, x: np.ndarray) -> np.ndarray:
        """Return A^T A x for the active unknowns (n,)."""
        image = self.sparse @ x[~self.full] + self.dense @ x[self.full]
        result = np.empty_like(x)
        result[~self.full], result[self.full] = self.sparse.T @ image, self.dense.T @ image
        return result

    def normal(self) -> np.ndarray:
        """Return A^T A of the active unknowns (n, n)."""
        total = np.empty((len(self.active), len(self.active)))
        sparse = self.sparse.T
        mixed = sparse @ self.dense
        total[np.ix_(self.full, self.full)] = self.dense.T @ self.dense
        total[np.ix_(~self.full, self.full)] = mixed
        total[np.ix_(self.full, ~self.full)] = mixed.T
        total[np.ix_(~self.full, ~self.full)] = (sparse @ self.sparse).toarray()
        return total

    def gram(self, scale: np.ndarray) -> np.ndarray:
        """Return A diag(scale) A^T (k, k).

        Args:
            scale: Of all unknowns.
        """
        own = scale[self.active]
        total = (self.sparse.multiply(own[None, ~self.full]) @ self.sparse.T).toarray()
        total += (self.dense * own[self.full]) @ self.dense.T
        return total
