"""Changes of the parameters that a step may choose from, few of them where the parameters are many.

The sensitivities g_k = df/dtheta of K points span what matters of P parameters. Two forms of an orthonormal basis:

    d_theta = Q c                              Q from the QR factors of the rows themselves, a matrix (P, K)
    d_theta = sum_k (W c)_k g_k                W = V S^-1/2 of the products K = G G^T = V S V^T (few numbers)

In the second, rows r over the parameters become r G^T W, and the products r . g_k come from the factors of rows
(implicit.sensitivity.row_products): no number of P is made but d_theta itself, so that P may be a million.
"""

from __future__ import annotations

from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import parameter_gradient, parameter_gradient_and_slope
from implicit.sensitivity.closed_form import closed_form_of, factors, fits, has_closed_form
from implicit.sensitivity.row_factors import RowFactors
from implicit.sensitivity.row_products import row_products

# From so many parameters on the second form is taken where there is a closed form. Measured on one thread with 1500
# combinations: at P = 8641 both take the same time, at 33,665 the second takes a tenth.
MANY_PARAMETERS = 10_000

# Combinations whose length is below this part of the longest, squared, are left out: rounding has decided them.
LEAST_EIGENVALUE = 1e-13


class ParameterBasis(Protocol):
    """Linear map from few unknowns c to changes of the parameters.

    Attributes:
        count: Number of the unknowns.
    """

    count: int

    def change(self, c: Float[Tensor, " k"]) -> Float[Tensor, " p"]:
        """Return d_theta."""

    def transposed(self, gradient: Float[Tensor, " p"]) -> Float[Tensor, " k"]:
        """Return a linear function of d_theta as one of c."""

    def rows(
        self, field: Field, points: Float[Tensor, "n d"], combinations: Float[Tensor, "n q e"] | None = None
    ) -> Float[Tensor, "*n k"]:
        """Return df/dtheta . d_theta at points as rows over c (N, K), or combinations with its slopes (N, Q, K)."""

    def width(self, field: Field) -> int:
        """Return the numbers that are made at a point for each of its rows, so that memory is bounded."""


def gradient_rows(
    field: Field, points: Float[Tensor, "n d"], combinations: Float[Tensor, "n q e"] | None = None
) -> Float[Tensor, "*n p"]:
    """Return df/dtheta at points (N, P), or combinations with its slopes in space (N, Q, P)."""
    if combinations is None:
        return parameter_gradient(field, points)
    return combinations @ parameter_gradient_and_slope(field, points)


class AllParameters:
    """All parameters of a field themselves."""

    def __init__(self, field: Field) -> None:
        self.count = len(field.theta)

    def change(self, c: Float[Tensor, " k"]) -> Float[Tensor, " p"]:
        return c

    def transposed(self, gradient: Float[Tensor, " p"]) -> Float[Tensor, " k"]:
        return gradient

    def rows(
        self, field: Field, points: Float[Tensor, "n d"], combinations: Float[Tensor, "n q e"] | None = None
    ) -> Float[Tensor, "*n k"]:
        return gradient_rows(field, points, combinations)

    def width(self, field: Field) -> int:
        return self.count


class Directions:
    """Columns of a matrix.

    Args:
        matrix: Changes of the parameters, a column each (P, K).
    """

    def __init__(self, matrix: Float[Tensor, "p k"]) -> None:
        self.matrix, self.count = matrix, matrix.shape[1]

    def change(self, c: Float[Tensor, " k"]) -> Float[Tensor, " p"]:
        return self.matrix @ c

    def transposed(self, gradient: Float[Tensor, " p"]) -> Float[Tensor, " k"]:
        return gradient @ self.matrix

    def rows(
        self, field: Field, points: Float[Tensor, "n d"], combinations: Float[Tensor, "n q e"] | None = None
    ) -> Float[Tensor, "*n k"]:
        return gradient_rows(field, points, combinations) @ self.matrix

    def width(self, field: Field) -> int:
        return len(field.theta)


class PointSensitivities:
    """Orthonormal combinations of the sensitivities of some points, by their factors.

    Args:
        sensitivities: The rows df/dtheta of the points.
    """

    def __init__(self, sensitivities: RowFactors) -> None:
        eigenvalues, vectors = torch.linalg.eigh(sensitivities.gram())  # of which it reads the lower triangle
        kept = eigenvalues > LEAST_EIGENVALUE * eigenvalues[-1]
        self._sensitivities = sensitivities
        self._weights = vectors[:, kept] / eigenvalues[kept].sqrt()
        self.count = int(kept.sum())

    def change(self, c: Float[Tensor, " k"]) -> Float[Tensor, " p"]:
        return self._sensitivities.transposed_times((self._weights @ c.double()).to(c))

    def transposed(self, gradient: Float[Tensor, " p"]) -> Float[Tensor, " k"]:
        return (self._sensitivities.times(gradient).double() @ self._weights).to(gradient)

    def rows(
        self, field: Field, points: Float[Tensor, "n d"], combinations: Float[Tensor, "n q e"] | None = None
    ) -> Float[Tensor, "*n k"]:
        rows = row_products(factors(field, points, combinations), self._sensitivities) @ self._weights
        return rows.to(points) if combinations is None else rows.to(points).unflatten(0, combinations.shape[:2])

    def width(self, field: Field) -> int:
        form = closed_form_of(field)
        return max(len(self._weights), 2 * form.width if form is not None else 0)


def spanned(field: Field, on: Float[Tensor, "n d"], off: Float[Tensor, "m d"], count: int) -> ParameterBasis:
    """Return an orthonormal basis of the parameter changes that so many points' sensitivities span.

    Args:
        field: The field.
        on, off: Points on the surface and off it, each in an order whose every part is spread evenly. A quarter of
            those taken at most is off it. All parameters are taken where these are no more than the points.
        count: Number of points.
    """
    off = off[: count // 4]
    every = max(1, len(on) // max(1, count - len(off)))
    chosen = torch.cat([on[::every][: count - len(off)], off])
    if len(chosen) >= len(field.theta):
        return AllParameters(field)
    if len(field.theta) >= MANY_PARAMETERS and spans_by_factors(field, len(chosen)):
        return PointSensitivities(factors(field, chosen))
    return Directions(torch.linalg.qr(parameter_gradient(field, chosen).T)[0])


def spans_by_factors(field: Field, count: int) -> bool:
    """Return whether so many points' sensitivities can be combined by their factors, whatever the number of P."""
    return has_closed_form(field, in_space=True) and fits(field, count)
