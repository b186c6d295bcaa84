"""The strain of a displacement D = T + n s of the surface, as numbers that are linear in u, T and their slopes:

    J + J^T = s (dn/dx + dn/dx^T) + j + j^T,    j = dT/dx + n (ds/dx)^T,    s = u - n . T

with ds/dx = du/dx - (dn/dx)^T T - (dT/dx)^T n. All is in the surface's own axes: tangents first, the normal last.
"""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from implicit.sensitivity.frame import Frame


@dataclass(frozen=True, eq=False)
class LinearForm:
    """Numbers at points: speed_coefficients . (u, du) + sum_i tangential_coefficients[i] . (T_i, dT_i).

    The slopes du and dT_i are those along the axes, so each motion has E = 1 + D numbers.
    """

    speed_coefficients: Float[Tensor, "*n e"]
    tangential_coefficients: Float[Tensor, "*n d e"]

    def __add__(self, other: LinearForm) -> LinearForm:
        return LinearForm(
            self.speed_coefficients + other.speed_coefficients,
            self.tangential_coefficients + other.tangential_coefficients,
        )

    @property
    def T(self) -> LinearForm:
        """The transposed matrix of numbers at each point."""
        return LinearForm(self.speed_coefficients.transpose(1, 2), self.tangential_coefficients.transpose(1, 2))

    def entries(self, which: list[tuple[int, int]]) -> LinearForm:
        """Return some entries (a, b) of the matrix at each point."""
        a, b = (list(indices) for indices in zip(*which, strict=True))
        return LinearForm(self.speed_coefficients[:, a, b], self.tangential_coefficients[:, a, b])

    def __repr__(self) -> str:
        return f"LinearForm({' x '.join(map(str, self.speed_coefficients.shape[:-1]))} numbers)"


def sym(matrix: Float[Tensor, "n d d"]) -> Float[Tensor, "n d d"]:
    """Return the matrices with their transposes added."""
    return matrix + matrix.transpose(1, 2)


def strain(frame: Frame) -> LinearForm:
    """Return all entries of J + J^T, (N, D, D) numbers."""
    j = tangential_slopes(frame) + normal_slopes(frame)
    return normal_part(frame, sym(frame.normal_slopes_in_axes)) + j + j.T


def normal_part(frame: Frame, factors: Float[Tensor, "n d d"]) -> LinearForm:
    """Return s = u - n . T times the factors."""
    form = _zero(frame)
    form.speed_coefficients[..., 0] = factors
    form.tangential_coefficients[..., 0] = -factors[..., None] * frame.normals[:, None, None]
    return form


def tangential_slopes(frame: Frame) -> LinearForm:
    """Return dT/dx: entry (a, b) is the part along axis a of the slope along axis b."""
    form = _zero(frame)
    for b in range(frame.points.shape[1]):
        form.tangential_coefficients[:, :, b, :, 1 + b] = frame.axes
    return form


def normal_slopes(frame: Frame) -> LinearForm:
    """Return n (ds/dx)^T, whose last row alone is not zero."""
    form = _zero(frame)
    turning = frame.axes @ frame.normal_slopes.transpose(1, 2)  # row b: the slope of n along axis b
    for b in range(frame.points.shape[1]):
        form.speed_coefficients[:, -1, b, 1 + b] = 1
        form.tangential_coefficients[:, -1, b, :, 0] = -turning[:, b]
        form.tangential_coefficients[:, -1, b, :, 1 + b] = -frame.normals
    return form


def _zero(frame: Frame) -> LinearForm:
    n, d = frame.points.shape
    return LinearForm(frame.points.new_zeros(n, d, d, 1 + d), frame.points.new_zeros(n, d, d, d, 1 + d))
