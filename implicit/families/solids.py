"""Exact signed distances of the solids that the families are put together from, in the caller's dtype and device.

Coordinates and lengths are tensors that broadcast against each other, so that one call serves many shapes of many
points. Negative inside. Formulas: the distance to an interval, a box, a cylinder or a prism follows from the
distances q_i to the slabs or profiles whose product it is, |max(q, 0)| + min(max q_i, 0); to a polygon it is the least
distance to an edge, negative where every edge has the point on its left.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

Length = Tensor | float


def product(*distances: Tensor) -> Tensor:
    """Distance to the product of solids that lie in subspaces at right angles, from the distance to each."""
    outside = torch.stack([d.clamp(min=0) for d in distances])
    nearest = distances[0]
    for d in distances[1:]:
        nearest = torch.maximum(nearest, d)
    return length(*outside) + nearest.clamp(max=0)


def slab(x: Tensor, lower: Length, upper: Length) -> Tensor:
    """Distance to lower <= x <= upper."""
    return torch.maximum(lower - x, x - upper)


def box(
    x: Tensor,
    y: Tensor,
    z: Tensor,
    lower: tuple[Length, Length, Length],
    upper: tuple[Length, Length, Length],
    edge: float = 0.0,
) -> Tensor:
    """Distance to a box by its corners, its edges rounded with radius `edge`."""
    q = [slab(c, low + edge, high - edge) for c, low, high in zip((x, y, z), lower, upper, strict=True)]
    return product(*q) - edge


def capsule(across: Tensor, along: Tensor, lower: Length, upper: Length, radius: Length) -> Tensor:
    """Distance to all within `radius` of a segment: `across` is the distance to its line."""
    beyond = slab(along, lower + radius, upper - radius).clamp(min=0)
    return length(across, beyond) - radius


def cylinder(across: Tensor, along: Tensor, lower: Length, upper: Length, radius: Length, edge: float = 0.0) -> Tensor:
    """Distance to a cylinder, its rims rounded with radius `edge`."""
    return product(across - (radius - edge), slab(along, lower + edge, upper - edge)) - edge


def polygon(u: Tensor, v: Tensor, corners: Sequence[tuple[Length, Length]]) -> Tensor:
    """Distance to a convex polygon in the plane, its corners counter-clockwise."""
    square: Tensor | None = None
    inside: Tensor | None = None
    for (a, b), (c, d) in zip(corners, [*corners[1:], corners[0]], strict=True):
        along_u, along_v = torch.as_tensor(c - a), torch.as_tensor(d - b)
        part = ((u - a) * along_u + (v - b) * along_v) / (along_u**2 + along_v**2)
        part = part.clamp(0, 1)
        distance = (u - a - part * along_u) ** 2 + (v - b - part * along_v) ** 2
        left = along_u * (v - b) - along_v * (u - a) > 0
        square = distance if square is None else torch.minimum(square, distance)
        inside = left if inside is None else inside & left
    assert square is not None
    assert inside is not None
    away = torch.sqrt(square.clamp(min=1e-24))
    return torch.where(inside, -away, away)


def union(*distances: Tensor) -> Tensor:
    """The least of the distances: exact outside, and inside no deeper than the truth."""
    nearest = distances[0]
    for d in distances[1:]:
        nearest = torch.minimum(nearest, d)
    return nearest


def length(*coordinates: Tensor) -> Tensor:
    """Root of the sum of squares, with a derivative at zero."""
    total = sum(c * c for c in coordinates)
    assert isinstance(total, Tensor)
    return torch.sqrt(total.clamp(min=1e-24))
