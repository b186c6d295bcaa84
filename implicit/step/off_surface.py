"""The field away from the surface: tied to the surface's own motion, so that no stray pieces arise there.

Boundary sensitivity sees the surface alone. A long edit leaves the field elsewhere to chance, and where it drifts
through zero a piece appears out of nothing. Were f a distance, moving the nearest surface point x of y outward by u
would lower f(y) by u. So the energy of a step is, with s the mean |df/dx| on the surface and d the signed distance,

    strength / size  int w (df / s + u(x) - restore (d - f / s))^2 dV,     w = (m / (m + |d|))^2,  m = size / 20

The weight w counts errors relative to the distance: far away only the sign matters.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.step.energies import FieldTarget
from implicit.surface.quadrature import SurfaceSample

NEAR = 1 / 20  # of the field's size: up to here errors count fully


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
    """Return the energy that lets the field off the surface follow the surface.

    Args:
        field: A field in its present state.
        sample: Points on its surface, M of them.
        motion: Their wanted motion along the normal (M,), a length; what lies nearest to a NaN is asked to stay as it
            is. None ties each point to the motion that the step itself gives the surface.
        strength: Weight of the energy beside an integral of squared motions over the surface.
        restore: Share of the field's deviation from a distance that a step is to undo: 0 leaves its profile as it is,
            as a field that is no distance (an occupancy, say) needs.
        points: How many points are drawn in the bounds.
        seed: Seed of the draw.
    """
    generator = torch.Generator().manual_seed(seed)
    lower, upper = field.bounds
    draw = torch.rand(points, field.dimension, generator=generator, dtype=torch.float64).to(field.theta)
    y = lower + draw * (upper - lower)
    near = NEAR * field.size
    m = points // 2
    j = torch.linspace(0, len(sample) - 1, m, device=field.device).long()
    offset = (2 * draw[:m, :1] - 1) * near
    y[:m] = sample.points[j] + offset * sample.normals[j]
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
    return FieldTarget(y, target, weights, torch.full_like(target, scale), tied)
