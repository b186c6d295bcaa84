"""Rows over the parameters, df/dtheta of some points, the last of them with those of others added.

    row_k = a_k g(x_k),                  k <= N - M,      g = df/dtheta
    row_k = a_k g(x_k) + b_k row_t(k),   the last M,      t(k) <= N - M

so that products with d_theta, and of all rows with each other, are those of the points' sensitivities.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import parameter_gradient
from implicit.sensitivity.closed_form import factors, fits
from implicit.sensitivity.row_factors import RowFactors
from implicit.step.equations import DENSE_LIMIT
from implicit.step.symmetric import gram

# Numbers of the rows at most that are made where they are not known by their factors.
MOST = 100_000_000


@dataclass(frozen=True, eq=False)
class PointRows:
    """Rows over the parameters, one a point.

    Attributes:
        sensitivities: a g of the points (N, P), in float64, by their factors where these are known.
        tied: Factor b of another row in the last M (M,).
        other: Number of that row (M,).
    """

    sensitivities: RowFactors | Float[Tensor, "n p"]
    tied: Float[Tensor, " m"]
    other: Int[Tensor, " m"]

    @classmethod
    def of(
        cls,
        field: Field,
        points: Float[Tensor, "n d"],
        own: Float[Tensor, " n"],
        tied: Float[Tensor, " m"],
        other: Int[Tensor, " m"],
    ) -> PointRows:
        """Return the rows of a field in float64 at some points."""
        if fits(field, len(points)):
            return cls(factors(field, points).scaled(own), tied, other)
        return cls(parameter_gradient(field, points).mul_(own[:, None]), tied, other)

    def times(self, d_theta: Float[Tensor, " p"]) -> Float[Tensor, " n"]:
        """Return the rows times a change of the parameters."""
        known, free = self.sensitivities, self._free
        changes = known.times(d_theta) if isinstance(known, RowFactors) else known @ d_theta
        changes[free:] += self.tied * changes[self.other]
        return changes

    def transposed(self, weights: Float[Tensor, " n"]) -> Float[Tensor, " p"]:
        """Return the weighted sum of the rows."""
        each = weights.index_add(0, self.other, self.tied * weights[self._free :])
        known = self.sensitivities
        return known.transposed_times(each) if isinstance(known, RowFactors) else each @ known

    @property
    def _free(self) -> int:
        known = self.sensitivities
        return (known.count if isinstance(known, RowFactors) else len(known)) - len(self.tied)

    def gram(self, dtype: torch.dtype = torch.float64) -> Float[Tensor, "n n"]:
        """Return the lower triangle of the products of the rows with each other; what is above it does not count."""
        known, free, at, by = self.sensitivities, self._free, self.other, self.tied[:, None].to(dtype)
        lower = known.gram(dtype) if isinstance(known, RowFactors) else gram(known.to(dtype))
        first = lower[:free, :free]
        before = torch.arange(free, device=at.device) <= at[:, None]
        whole = torch.where(before, first[at], first[:, at].T)  # of the rows that are added with all before the last
        across = lower[free:, :free]
        mixed = by * across[:, at].T  # of those that are added with the last
        lower[free:, free:] += mixed + mixed.T + by * whole[:, at] * by.T
        across += by * whole
        return lower

    def __repr__(self) -> str:
        kind = "by their factors" if isinstance(self.sensitivities, RowFactors) else "as a matrix"
        return f"PointRows({self._free} rows and {len(self.tied)} with others added, {kind})"


def room_for_rows(field: Field, count: int) -> bool:
    """Return whether so many rows of a field can be kept, by their factors or as a matrix, and their products made."""
    return count <= DENSE_LIMIT and (fits(field, count) or count * len(field.theta) <= MOST)
