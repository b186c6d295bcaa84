"""A module whose space is warped: where its surface was, without touching its own parameters.

    f(x) = g(phi(x)),      phi(x) = sum_k w_k(x) (q_k + A_k (x - c_k)),      w_k ~ (1 + |x - c_k|^2 / (8 s^2))^-4

phi takes a place of the moved shape to where it came from: an affine map about each centre c_k, blended by weights that
are a partition of unity. Where the maps about a place are one and the same phi is that map, but for the little that far
ones have in it: what moves rigidly keeps the surface of g in all its detail, whatever g can express. Near the centres
the weights fall like Gaussians of width s; far from them they spread with the distance, so that the space between two
parts goes over from one to the other smoothly. What is warped out of the bounds of g counts as on their border, for
beyond them g says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_positive, require_whole
from implicit.field.forms import Form
from implicit.models.registry import build, register

# Points at a time whose weights stay in the cache.
CHUNK = 1024


class Warp(nn.Module):
    """Module from points (N, D) to the values of another one in warped space (N,).

    Args:
        base: The other module.
        count: Centres K.
        dimension: D, 2 or 3.
        width: s, a length.
        form: How the other module takes points and where its values are; None takes points (N, D).

    Attributes:
        base: The other module.
        maps: A_k and q_k, the latter last: the row vector (x - c_k, 1) times the block is a place of g (K, D + 1, D).
        centres: c_k (K, D).
        bounds: Lower and upper corner of the box in which g says something (2, D).
    """

    maps: Tensor
    centres: Tensor
    bounds: Tensor

    def __init__(
        self,
        base: nn.Module,
        count: int,
        dimension: int = 3,
        *,
        width: float,
        form: Form | None = None,
    ) -> None:
        super().__init__()
        require_whole("count", count)
        require_whole("dimension", dimension, 2, "", 3)
        require_positive("width", width)
        self.base = base
        self.width = float(width)
        self._form = Form() if form is None else form
        still = torch.cat([torch.eye(dimension), torch.zeros(1, dimension)])
        self.maps = nn.Parameter(still.expand(count, -1, -1).clone())
        self.register_buffer("centres", torch.zeros(count, dimension))
        self.register_buffer("bounds", torch.tensor([[-1.0], [1.0]]).expand(2, dimension).clone())

    def _shares(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n k"]:
        """Return the weights up to a factor each point, in few passes over memory: that is what a warp costs."""
        c, scale = self.centres, 1 / (8 * self.width**2)
        here = torch.cat([points, (points**2).sum(dim=1, keepdim=True), torch.ones_like(points[:, :1])], dim=1)
        there = torch.cat([-2 * scale * c, torch.full_like(c[:, :1], scale), 1 + scale * (c**2).sum(1, True)], dim=1)
        grown: Tensor = here @ there.T
        return grown.reciprocal().square().square()  # a power costs ten times as much

    def weights(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n k"]:
        """Return the share of each centre at the points."""
        shares = self._shares(points)
        return shares / shares.sum(dim=1, keepdim=True)

    def warped(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return phi, where the points came from."""
        count, rows, D = self.maps.shape
        turned = self.maps[:, :D]
        shifts = self.maps[:, D] - (self.centres[:, None] @ turned)[:, 0]
        maps = torch.cat([turned, shifts[:, None]], dim=1).reshape(count, rows * D)
        maps = torch.cat([maps, torch.ones_like(maps[:, :1])], dim=1)
        summed = torch.cat([self._shares(part) @ maps for part in points.split(CHUNK)])
        blended = (summed[:, :-1] / summed[:, -1:]).reshape(len(points), rows, D)
        return (points[:, None] @ blended[:, :D])[:, 0] + blended[:, D]

    def forward(self, points: Float[Tensor, "n d"]) -> Tensor:
        """Return the values at the points."""
        there = self.warped(points)
        there = torch.minimum(torch.maximum(there, self.bounds[0]), self.bounds[1])
        values: Tensor = self._form.values(self.base(*self._form.arguments(there)))
        return values

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this module again.

        Raises:
            TypeError: The module within does not say how it was made.
        """
        describe = getattr(self.base, "describe", None)
        if not callable(describe):
            raise TypeError(f"The {type(self.base).__name__} within a Warp does not say how it was made.")
        count, _, D = self.maps.shape
        own = {"base": describe(), "count": count, "dimension": D, "width": self.width}
        return {"name": "warp", "arguments": own}


def _made(base: Mapping[str, Any], **arguments: Any) -> Warp:
    return Warp(build(base), **arguments)


register("warp", _made)
