"""The field away from the surface: tied to the surface's own motion, so that no stray pieces arise there.

Boundary sensitivity sees the surface alone. A long edit leaves the field elsewhere to chance, and where it drifts
through zero a piece appears out of nothing. Were f a distance, moving the nearest surface point x of y outward by u
would lower f(y) by u. So the energy of a step is, with s the mean |df/dx| on the surface and d the signed distance,

    strength / size  int w (df / s + u(x) - restore (d - f / s))^2 dV,     w = (m / (m + |d|))^2,  m = size / 20

The weight w counts errors relative to the distance: far away only the sign matters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.deformation import DeformationSpace
from implicit.field import Field
from implicit.sensitivity import adjoint, normal_displacement
from implicit.solve import Operator, Rows
from implicit.surface import SurfaceSample

NEAR = 1 / 20  # of the field's size: up to here errors count fully


@dataclass(frozen=True, eq=False)
class FieldTarget:
    """int w (df / scale + u(tied) - target)^2: how the field itself is to change at points anywhere.

    Args:
        points: Anywhere in the bounds, (N, D).
        target: Wanted change of f over the scale, a length if the scale is that of |df/dx|.
        weights: Of the points.
        scale: Units of f to a length.
        tied: Points of the surface (N, D) whose outward motion u is added to the change; None adds nothing.
    """

    points: Float[Tensor, "n d"]
    target: Float[Tensor, " n"]
    weights: Float[Tensor, " n"]
    scale: float
    tied: Float[Tensor, "n d"] | None = None

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        for where, matrix in space.value_rows(self.points):
            rows = matrix.div_(self.scale)
            if self.tied is not None:
                rows += torch.cat([part for _, part in space.normal_rows(self.tied[where])])
            yield Rows(rows, self.target[where], self.weights[where])

    def operator(self, space: DeformationSpace) -> Operator:
        """The same equations by their products, for networks whose rows do not fit in memory."""
        field, p = space.field, space.parameters
        lengths = torch.full_like(self.target, -self.scale)  # a normal motion is -df / |df/dx|

        def forward(x: Tensor) -> Tensor:
            change = normal_displacement(field, self.points, x[:p], lengths)
            return change if self.tied is None else change + normal_displacement(field, self.tied, x[:p])

        def back(weights: Tensor) -> Tensor:
            theta = adjoint(field, self.points, weights, lengths)
            if self.tied is not None:
                theta = theta + adjoint(field, self.tied, weights)
            return torch.cat([theta, theta.new_zeros(space.size - p)])

        return Operator(forward, back, self.target, self.weights)


def off_surface(
    field: Field,
    sample: SurfaceSample,
    motion: Float[Tensor, " m"] | None = None,
    *,
    strength: float = 1e-2,
    restore: float = 0.0,
    points: int = 500,
    seed: int = 0,
) -> FieldTarget:
    """The energy that lets the field off the surface follow the surface.

    Args:
        field: A field in its present state.
        sample: Points on its surface, M of them.
        motion: Their wanted motion along the normal (M,), a length; what lies nearest to a NaN is asked to stay as it
            is. None ties each point to the motion that the step itself gives the surface.
        strength: Of the energy beside an integral of squared motions over the surface.
        restore: Share of the field's deviation from a distance that a step is to undo: 0 leaves its profile as it is,
            as a field that is no distance (an occupancy, say) needs.
        points: How many points are drawn in the bounds.
        seed: Of the draw.
    """
    generator = torch.Generator().manual_seed(seed)
    lower, upper = field.bounds
    draw = torch.rand(points, field.dimension, generator=generator, dtype=torch.float64).to(field.theta)
    y = lower + draw * (upper - lower)
    near = NEAR * field.size
    m = points // 2
    j = torch.linspace(0, len(sample) - 1, m, device=field.device).long()
    hh = (2 * draw[:m, :1] - 1) * near
    y[:m] = sample.points[j] + hh * sample.normals[j]
    scale = float(field.gradient(sample.points).norm(dim=1).mean())
    distance, nearest = torch.cdist(y, sample.points).min(dim=1)
    value = field.value(y) / scale
    target = restore * (torch.where(value < 0, -distance, distance) - value)
    tied = sample.points[nearest] if motion is None else None
    if motion is not None:
        target = target - torch.nan_to_num(motion)[nearest]
    weights = (near / (near + distance)).square() * (strength / field.size)
    weights[:m] *= float(sample.weights.sum()) * 2 * near / m
    weights[m:] *= float((upper - lower).prod()) / (points - m)
    return FieldTarget(y, target, weights, scale, tied)
