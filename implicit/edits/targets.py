"""Where handles ask the points of a surface to go, and along which line the result is judged.

    goal(x, t) = x + sum over handles of weight(x) (motion(x, t) - x),    t from 0 to 1

The weight is that of the handle's region at the point of the unedited surface.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_between
from implicit.edits.handles import Handle

Rest = Literal["fixed", "free"] | float


class Goal:
    """Where points of the unedited surface are to be after a fraction of the edit.

    Args:
        handles: Regions and their displacements; where several overlap, displacements add.
        points, normals: Of the unedited surface (N, D).
        rest: What becomes of points in no region: "fixed" at zero, "free", or fixed with this weight.
        least_alignment: Points whose displacement makes a smaller cosine than this with the normal are left free:
            sliding along itself the surface hardly shows it, and asking for the rest would be noise.

    Attributes:
        importance: Weight of each point in the target (N,); 0 where nothing is asked.
        prescribed: Which points lie in a region (N,).
    """

    def __init__(
        self,
        handles: Sequence[Handle],
        points: Float[Tensor, "n d"],
        normals: Float[Tensor, "n d"],
        rest: Rest = "fixed",
        *,
        least_alignment: float = 0.0,
    ) -> None:
        self._handles, self._start, self._normals = handles, points, normals
        self._weights = [handle.weights(points) for handle in handles]
        inside = [weights > 0 for weights in self._weights]
        self.prescribed = torch.stack(inside).any(dim=0)
        weight = {"fixed": 1.0, "free": 0.0}.get(rest, rest) if isinstance(rest, str) else rest
        if not (isinstance(weight, int | float) and 0 <= weight < math.inf):
            raise ValueError(f'rest must be "fixed", "free" or a weight of at least 0, but is {rest!r}.')
        require_between("least_alignment", least_alignment, 0, 1)
        self.importance = torch.where(self.prescribed, 1.0, float(weight)).to(points)
        if least_alignment > 0:
            way = self.at(1.0) - points
            along = (way * normals).sum(dim=1).abs()
            self.importance[along < least_alignment * way.norm(dim=1)] = 0.0

    def require_points_in_each_region(self) -> None:
        """Refuse a handle that holds none of the points."""
        for k, weights in enumerate(self._weights):
            if not bool((weights > 0).any()):
                raise ValueError(
                    f"No point of the surface lies in the region of handles[{k}]. The surface spans "
                    f"{self._start.amin(dim=0).tolist()} to {self._start.amax(dim=0).tolist()}; move or widen the "
                    "region."
                )

    def at(self, fraction: float) -> Float[Tensor, "n d"]:
        """Positions after the fraction."""
        way = torch.zeros_like(self._start)
        for handle, weights in zip(self._handles, self._weights, strict=True):
            way = way + weights[:, None] * (handle.position(fraction, self._start, self._normals) - self._start)
        return self._start + way

    def wanted(self) -> Float[Tensor, "n d"]:
        """The whole displacement; NaN where nothing is asked."""
        whole = self.at(1.0) - self._start
        return torch.where((self.importance > 0)[:, None], whole, torch.full_like(whole, float("nan")))

    def directions(self) -> Float[Tensor, "n d"]:
        """The unit normals that the points take along: those at the start, turned where a handle turns its region."""
        turned = self._normals.clone()
        for handle, weights in zip(self._handles, self._weights, strict=True):
            turned = turned + weights[:, None] * (handle.turned(self._normals) - self._normals)
        return torch.nn.functional.normalize(turned, dim=1)

    def largest(self) -> float:
        """The longest displacement asked for."""
        return float((self.at(1.0) - self._start).norm(dim=1).max())


def checked_handles(handles: Sequence[Handle] | Handle) -> list[Handle]:
    """One handle or several, as a list that is not empty."""
    listed = [handles] if isinstance(handles, Handle) else handles
    if not isinstance(listed, list | tuple) or not all(isinstance(handle, Handle) for handle in listed):
        raise TypeError(f"handles must be Handle(region, displacement) or a list of them, but are {handles!r}.")
    if not listed:
        raise ValueError("handles is empty. Give at least one Handle(region, displacement).")
    return list(listed)
