"""Targets that handles set the points of a surface: positions, weights, and what holds where handles overlap.

Handle k weighs the point x of the unedited surface by w_k(x), the weight of its region there, and takes it to m_k(x, t)
after the fraction t of its motion. Two rules join the handles that a point lies in:

    SummedTargets      x + sum_k w_k (m_k(x, t) - x)        weights scale the displacements, which add
    AveragedTargets    sum_k w_k m_k(x, t) / sum_k w_k      weights say how firmly the target is held

An edit that prescribes displacements takes the first, one that holds points by a penalty the second.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_between
from implicit.edits.handles import Handle
from implicit.edits.regions import described
from implicit.field.field import Units

Rest = Literal["fixed", "free"] | float


class HandleTargets(ABC):
    """Targets that handles set points of the unedited surface.

    Args:
        handles: Regions and their displacements; with none, all points are the rest.
        points, normals: Points of the unedited surface and their unit normals (N, D).

    Attributes:
        handle_weights: Weights of the points in the region of each handle, (N,) each.
        prescribed: Which points lie in a region (N,).
        weights: Weight of each point in the target (N,), 0 where it has none.
    """

    weights: Float[Tensor, " n"]

    def __init__(self, handles: Sequence[Handle], points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]) -> None:
        self.points, self.normals = points, normals
        self._handles = handles
        self.handle_weights = [handle.weights(points) for handle in handles]
        self.prescribed = torch.zeros(len(points), dtype=torch.bool, device=points.device)
        for weights in self.handle_weights:
            self.prescribed |= weights > 0

    @abstractmethod
    def positions(self, fraction: float) -> Float[Tensor, "n d"]:
        """Return where the points are to be after a fraction of the edit; those in no region stay."""

    def target(self) -> Float[Tensor, "n d"]:
        """Return the displacement that an edit is judged by, to the final positions; NaN where there is no target."""
        whole = self.positions(1.0) - self.points
        return torch.where((self.weights > 0)[:, None], whole, torch.full_like(whole, float("nan")))

    def require_points_in_each_region(self, units: Units | None = None) -> None:
        """Refuse a handle that holds none of the points.

        Args:
            units: Those of the field, for the message to say in the user's coordinates too where the surface is.
        """
        for k, weights in enumerate(self.handle_weights):
            if not bool((weights > 0).any()):
                raise ValueError(
                    f"No point of the surface lies in the region of handles[{k}]. In the field's coordinates, in which "
                    f"handles are given, the surface spans {_corners(self.points)}; move or widen the region."
                    f"{_in_user_units(self.points, units)}"
                )


def _corners(points: Tensor) -> str:
    return f"{described(points.amin(dim=0))} to {described(points.amax(dim=0))}"


def _in_user_units(points: Tensor, units: Units | None) -> str:
    """Return what to say to those whose own coordinates are others than the field's."""
    if units is None or (units.scale == 1 and not any(units.offset)):
        return ""
    return (
        f" In the user's coordinates, {units.scale:.6g} x + {described(units.offset)}, it spans "
        f"{_corners(units.to_user(points))}: take places from there by field.units.to_field(places), and divide "
        "lengths by field.units.scale."
    )


class SummedTargets(HandleTargets):
    """Targets of which the handles' displacements, each times the weight of its region, add up.

    Args:
        handles, points, normals: See HandleTargets.
        rest: Target of points in no region: "fixed" at zero, "free", or fixed with this weight.
        least_alignment: Points whose displacement makes a smaller cosine than this with the normal are left free:
            sliding along itself the surface hardly shows it, and asking for the rest would be noise.

    Attributes:
        weights: 1 in the regions, however small the weight there, and that of the rest outside (N,).
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
        super().__init__(handles, points, normals)
        weight = {"fixed": 1.0, "free": 0.0}.get(rest, rest) if isinstance(rest, str) else rest
        if not (isinstance(weight, int | float) and 0 <= weight < math.inf):
            raise ValueError(f'rest must be "fixed", "free" or a weight of at least 0, but is {rest!r}.')
        require_between("least_alignment", least_alignment, 0, 1)
        self.weights = torch.where(self.prescribed, 1.0, float(weight)).to(points)
        if least_alignment > 0:
            whole = self.positions(1.0) - points
            normal_part = (whole * normals).sum(dim=1).abs()
            self.weights[normal_part < least_alignment * whole.norm(dim=1)] = 0.0

    def displacement(self, fraction: float = 1.0) -> Float[Tensor, "n d"]:
        """Return sum_k w_k (m_k - x) after a fraction of the edit, zero outside the regions."""
        total = torch.zeros_like(self.points)
        for handle, weights in zip(self._handles, self.handle_weights, strict=True):
            total = total + weights[:, None] * (handle.position(fraction, self.points, self.normals) - self.points)
        return total

    def positions(self, fraction: float) -> Float[Tensor, "n d"]:
        """Return where the points are to be after a fraction of the edit."""
        return self.points + self.displacement(fraction)

    def directions(self) -> Float[Tensor, "n d"]:
        """Return the unit normals that the points take along, turned where a handle turns its region."""
        turned = self.normals.clone()
        for handle, weights in zip(self._handles, self.handle_weights, strict=True):
            turned = turned + weights[:, None] * (handle.turned(self.normals) - self.normals)
        return torch.nn.functional.normalize(turned, dim=1)

    def largest(self) -> float:
        """Return the longest displacement among the targets, a length."""
        return float((self.positions(1.0) - self.points).norm(dim=1).max())


class AveragedTargets(HandleTargets):
    """Targets that are the weighted mean of where the handles take a point.

    Args:
        handles, points, normals: See HandleTargets.

    Attributes:
        total: Sum of the handles' weights (N,).
        weights: The same, at most 1 (N,).
    """

    def __init__(self, handles: Sequence[Handle], points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]) -> None:
        super().__init__(handles, points, normals)
        self.total = torch.stack(self.handle_weights).sum(dim=0)
        self.weights = self.total.clamp(max=1)

    def positions(self, fraction: float) -> Float[Tensor, "n d"]:
        """Return where the points are to be after a fraction of the edit; those in no region stay."""
        total = torch.zeros_like(self.points)
        for handle, weights in zip(self._handles, self.handle_weights, strict=True):
            total += weights[:, None] * handle.position(fraction, self.points, self.normals)
        mean = total / self.total.clamp(min=torch.finfo(total.dtype).tiny)[:, None]
        return torch.where(self.prescribed[:, None], mean, self.points)


def checked_handles(handles: Sequence[Handle] | Handle) -> list[Handle]:
    """Return one handle or several as a list that is not empty.

    Raises:
        TypeError: They are no handles.
        ValueError: There are none.
    """
    listed = [handles] if isinstance(handles, Handle) else handles
    if not isinstance(listed, list | tuple) or not all(isinstance(handle, Handle) for handle in listed):
        raise TypeError(f"handles must be Handle(region, displacement) or a list of them, but are {handles!r}.")
    if not listed:
        raise ValueError("handles is empty. Give at least one Handle(region, displacement).")
    return list(listed)
