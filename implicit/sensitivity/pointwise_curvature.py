"""Test of whether second derivatives tell how a surface bends, measured and not guessed from the field's class.

Along a short way d across the surface the normal turns by

    n(x + d) - n(x - d) = int_(-1)^1 S(x + t d) d dt,      S = dn/dx, made of second derivatives of f.

Of a field that is smooth over the way, Simpson's rule gives the right-hand side but for O(|d|^5). Of a piecewise linear
one S is zero almost everywhere, and all the turning is in jumps that no sampled derivative sees; of an operation whose
second derivative torch does not know it is zero as well. The measure is the part of the turning that is explained,

    explained = 1 - sum |turning - Simpson| / sum |turning|,

near 1 where curvature can be sampled at points, near 0 where it has to be had in weak form (.weak_curvature).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field

# Of the turning, the part that must be explained. Measured (tests and the bundled fields): smooth networks and formulas
# 0.7 to 1 (trained ones above 0.99), ReLU behind Fourier features 0.53 (pointwise smoothing of which loses 23 % less
# area than the mesh flow), grids with linear interpolation 0.2 to 0.4, ReLU and shapes with flat sides 0 to 0.1.
LEAST_EXPLAINED = 0.65

# Length of the way to each side, in units of the field's size: a quarter of a cell of the quadrature of an edit.
REACH = 1 / 192

# Points at which it is measured.
POINTS = 256

# Mean turning, in radians, below which the surface is as good as flat everywhere, and rounding would be measured.
FLAT = 1e-4


@dataclass(frozen=True)
class NormalTurning:
    """Turning of a field's normals over short ways, and how much of it second derivatives explain.

    Attributes:
        explained: The part that they explain, at most 1; 1 of a flat surface. Below 0 they say more than there is.
        mean: Mean turning over a way, in radians.
        reach: Half the length of a way.
    """

    explained: float
    mean: float
    reach: float

    @property
    def is_smooth(self) -> bool:
        """True if curvature can be sampled at points."""
        return self.explained >= LEAST_EXPLAINED

    def __str__(self) -> str:
        return (
            f"second derivatives explain {100 * max(self.explained, 0.0):.0f} % of how the normals turn over "
            f"{2 * self.reach:.3g}, where {100 * LEAST_EXPLAINED:.0f} % are wanted"
        )


def normal_turning(field: Field, points: Float[Tensor, "n d"], *, reach: float | None = None) -> NormalTurning:
    """Return how much of the turning of the normals about some points second derivatives explain.

    Args:
        field: The field.
        points: Points on the surface (N, D), in an order whose every part is spread evenly; POINTS of them are taken.
        reach: Half the length of a way; None is REACH of the field's size.

    Where second derivatives are missing nothing is explained.
    """
    reach = REACH * field.size if reach is None else reach
    x = field.require_points(points)[:: max(1, len(points) // POINTS)]
    generator = torch.Generator().manual_seed(0)
    way = torch.randn(x.shape, generator=generator, dtype=torch.float64).to(x)
    normal = _normal_and_slope(field, x, None)[0]
    way = way - normal * (normal * way).sum(dim=1, keepdim=True)
    way = reach * way / way.norm(dim=1, keepdim=True).clamp(min=1e-12)
    ends = [_normal_and_slope(field, x + side * way, None)[0] for side in (-1, 1)]
    turning = ends[1] - ends[0]
    simpson = torch.zeros_like(turning)
    if field.twice_differentiable:
        slopes = [_normal_and_slope(field, x + side * way, way)[1] for side in (-1, 0, 1)]
        simpson = (slopes[0] + 4 * slopes[1] + slopes[2]) / 3
    # A turning is at most two; what second derivatives of a nearly sharp edge say beyond it is no more wrong than that.
    missed = (turning - simpson).norm(dim=1).clamp(max=2.0).double()
    known = torch.isfinite(missed)  # where the gradient vanishes there is no normal
    mean = float(turning[known].norm(dim=1).double().mean()) if bool(known.any()) else 0.0
    if mean < 2 * FLAT:
        return NormalTurning(1.0, mean, reach)
    return NormalTurning(1 - float(missed[known].mean()) / mean, mean, reach)


def _normal_and_slope(field: Field, points: Tensor, way: Tensor | None) -> tuple[Tensor, Tensor]:
    """Return the normals at points, and how they change along a way to first order; NaN where the gradient vanishes."""
    if way is None:
        gradients = field.gradient(points)
        return gradients / gradients.norm(dim=1, keepdim=True), torch.zeros_like(points)
    gradients, hessians = field.gradient_and_hessian(points)
    length = gradients.norm(dim=1, keepdim=True)
    normal = gradients / length
    change = torch.einsum("nij,nj->ni", hessians, way) / length
    return normal, change - normal * (normal * change).sum(dim=1, keepdim=True)
