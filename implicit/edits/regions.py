"""Regions of space, in which an edit acts.

A region is any callable from points (N, D) to weights (N,) in [0, 1]; the ones here combine with & (both),
| (either) and ~ (all but). Their optional `falloff` lets the weight sink smoothly from 1 to 0 over that
length outside, by the quintic 1 - 10 t^3 + 15 t^4 - 6 t^5, twice continuously differentiable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.arguments import require_callable, require_numbers, require_positive

RegionLike = Callable[[Tensor], Tensor]
Vector = Sequence[float] | Tensor
Points = Sequence[Sequence[float | int]] | Tensor


class Region(ABC):
    """A part of space as weights in [0, 1]."""

    @abstractmethod
    def __call__(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return the weight of each point."""

    def __and__(self, other: RegionLike) -> Region:
        """Return the region of the points that lie in both."""
        require_callable("The other region", other, "a region, or a function from points (N, D) to weights (N,)")
        words = f"({self!r} & {described(other)})"
        return _Combined(lambda points: torch.minimum(self(points), other(points)), words)

    def __or__(self, other: RegionLike) -> Region:
        """Return the region of the points that lie in either."""
        require_callable("The other region", other, "a region, or a function from points (N, D) to weights (N,)")
        words = f"({self!r} | {described(other)})"
        return _Combined(lambda points: torch.maximum(self(points), other(points)), words)

    def __invert__(self) -> Region:
        """Return the region of all other points."""
        return _Combined(lambda points: 1 - self(points), f"~{self!r}")

    def __repr__(self) -> str:
        return described_fields(self)


class _Combined(Region):
    def __init__(self, weight: RegionLike, words: str) -> None:
        self._weight, self._words = weight, words

    def __call__(self, points: Tensor) -> Tensor:
        return self._weight(points)

    def __repr__(self) -> str:
        return self._words


@dataclass(frozen=True, repr=False)
class Ball(Region):
    """Points within `radius` of `center`.

    Args:
        center: Point (D,).
        radius: Length, positive.
        falloff: Length outside over which the weight sinks smoothly from 1 to 0; 0 ends it at once.
    """

    center: Vector
    radius: float
    falloff: float = 0.0

    def __post_init__(self) -> None:
        require_place("center of a Ball", self.center)
        _require_positive("Ball", "radius", self.radius)
        require_positive("falloff of a Ball", self.falloff, "length", or_zero=True)

    def __call__(self, points: Tensor) -> Tensor:
        return _sink((points - like(self.center, points)).norm(dim=1) - self.radius, self.falloff)


@dataclass(frozen=True, repr=False)
class Box(Region):
    """Points between the corners `lower` and `upper`.

    Args:
        lower, upper: Corners (D,), lower < upper in each coordinate.
        falloff: Length outside over which the weight sinks smoothly from 1 to 0; 0 ends it at once.
    """

    lower: Vector
    upper: Vector
    falloff: float = 0.0

    def __post_init__(self) -> None:
        lower, upper = require_place("lower of a Box", self.lower), require_place("upper of a Box", self.upper)
        require_positive("falloff of a Box", self.falloff, "length", or_zero=True)
        if lower.shape != upper.shape or not bool((lower < upper).all()):
            raise ValueError(f"Box needs lower < upper in each coordinate, but got {self.lower} and {self.upper}.")

    def __call__(self, points: Tensor) -> Tensor:
        outside = torch.maximum(like(self.lower, points) - points, points - like(self.upper, points)).clamp(min=0)
        return _sink(outside.norm(dim=1), self.falloff)


@dataclass(frozen=True, repr=False)
class HalfSpace(Region):
    """Points on the side of the plane through `point` that `normal` points to.

    Args:
        point: Point (D,) of the plane.
        normal: Vector (D,) of any length, into the region.
        falloff: Length outside over which the weight sinks smoothly from 1 to 0; 0 ends it at once.
    """

    point: Vector
    normal: Vector
    falloff: float = 0.0

    def __post_init__(self) -> None:
        require_place("point of a HalfSpace", self.point)
        normal = require_place("normal of a HalfSpace", self.normal)
        _require_positive("HalfSpace", "length of normal", float(normal.norm()))
        require_positive("falloff of a HalfSpace", self.falloff, "length", or_zero=True)

    def __call__(self, points: Tensor) -> Tensor:
        normal = like(self.normal, points)
        return _sink(-(points - like(self.point, points)) @ (normal / normal.norm()), self.falloff)


@dataclass(frozen=True, eq=False, repr=False)
class NearPoints(Region):
    """Points within `radius` of any of `centers`: a set picked on a mesh, for instance.

    Args:
        centers: Points (M, D).
        radius: Length, positive.
        falloff: Length outside over which the weight sinks smoothly from 1 to 0; 0 ends it at once.
    """

    centers: Float[Tensor, "m d"] | Sequence[Sequence[float | int]]
    radius: float
    falloff: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("NearPoints", "radius", self.radius)
        require_positive("falloff of NearPoints", self.falloff, "length", or_zero=True)
        centers = require_numbers("centers of NearPoints", self.centers, "points (M, D)")
        if centers.ndim != 2 or len(centers) == 0:
            raise ValueError("NearPoints needs centers of shape (M, D) with M >= 1; pick at least one point.")

    def __call__(self, points: Tensor) -> Tensor:
        centers = like(self.centers, points)
        nearest = torch.cat([torch.cdist(part, centers).amin(dim=1) for part in points.split(4096)])
        return _sink(nearest - self.radius, self.falloff)


@dataclass(frozen=True, eq=False, repr=False)
class PickedVertices(Region):
    """Points that are nearest to picked vertices of a mesh, of all its vertices: what lies about them up to halfway.

    Args:
        vertices: All vertices of a mesh of the surface (V, D), such as those of extract_mesh.
        picked: Numbers of the picked ones (k,), or True for each of them (V,).
    """

    vertices: Points
    picked: Sequence[int] | Sequence[bool] | Tensor

    def __post_init__(self) -> None:
        vertices = require_numbers("vertices of PickedVertices", self.vertices, "points (V, D)")
        if vertices.ndim != 2 or len(vertices) == 0:
            raise ValueError(
                f"vertices of PickedVertices must be points (V, D), but have shape {tuple(vertices.shape)}."
            )
        chosen = self._chosen(len(vertices))
        if not bool(chosen.any()):
            raise ValueError("PickedVertices needs at least one picked vertex, but got none.")

    def _chosen(self, count: int) -> Tensor:
        """Return which of the vertices are picked (V,)."""
        try:
            picked = torch.as_tensor(self.picked)
        except (TypeError, ValueError, RuntimeError):
            picked = torch.zeros(1)
        whole = picked.dtype in (torch.int16, torch.int32, torch.int64, torch.uint8, torch.int8)
        inside = whole and picked.ndim == 1 and (not len(picked) or 0 <= int(picked.min()) <= int(picked.max()) < count)
        if not inside and not (picked.dtype == torch.bool and picked.shape == (count,)):
            raise ValueError(
                f"picked of PickedVertices must be numbers of vertices from 0 to {count - 1}, or True for each that is "
                f"meant ({count},), but is {described(self.picked)}."
            )
        if picked.dtype == torch.bool:
            return picked
        chosen = torch.zeros(count, dtype=torch.bool)
        chosen[picked.long()] = True
        return chosen

    @cached_property
    def _tree(self) -> tuple[cKDTree, NDArray[np.bool_]]:
        vertices = require_numbers("vertices of PickedVertices", self.vertices, "points (V, D)")
        return cKDTree(vertices.cpu().numpy()), self._chosen(len(vertices)).cpu().numpy()

    def __call__(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        tree, chosen = self._tree
        if tree.m != points.shape[1]:
            raise ValueError(
                f"vertices of PickedVertices must be in the dimensions of the points, {points.shape[1]}, but are in "
                f"{tree.m} dimensions."
            )
        nearest = tree.query(points.detach().double().cpu().numpy())[1]
        return torch.from_numpy(chosen[nearest]).to(points)


def _sink(distance: Tensor, falloff: float) -> Tensor:
    """Return 1 at distance <= 0, sinking to 0 at `falloff`."""
    if falloff <= 0:
        return (distance <= 0).to(distance)
    t = (distance / falloff).clamp(0, 1)
    return (1 - t**3 * (10 - 15 * t + 6 * t**2)).clamp(0, 1)  # rounding leaves the range near both ends


def like(vector: Vector | Points, points: Tensor, name: str = "The region") -> Tensor:
    """Return a vector, or points, in the dtype and on the device of points; refuse other dimensions than theirs."""
    value = exact(vector, points)
    if value.shape[-1] != points.shape[1]:
        raise ValueError(
            f"{name} must be in the dimensions of the points, {points.shape[1]}, but is in "
            f"{value.shape[-1]} dimensions."
        )
    return value


def require_place(name: str, value: Vector) -> Tensor:
    """Return a point or vector (D,) in float64, to be looked at; refuse what is none."""
    place = require_numbers(name, value, "a point or vector (D,)")
    if place.ndim != 1:
        raise ValueError(f"{name} must be a point or vector (D,), but has the shape {tuple(place.shape)}.")
    return place


def exact(value: Vector | Points | float, of: Tensor) -> Tensor:
    """Return the value in the other's dtype; plain numbers go there without torch's default of single precision."""
    return value.to(of) if isinstance(value, Tensor) else torch.as_tensor(value, dtype=of.dtype, device=of.device)


def _require_positive(what: str, name: str, value: float) -> None:
    if isinstance(value, str) or not value > 0:
        raise ValueError(f"{what} needs a positive {name}, but got {value!r}.")


def described_fields(value: Any) -> str:
    """Return a dataclass's name and fields in a line, without those that are at their default."""
    words = [
        f"{part.name}={described(getattr(value, part.name))}"
        for part in fields(value)
        if getattr(value, part.name) is not part.default and described(getattr(value, part.name)) != repr(part.default)
    ]
    return f"{type(value).__name__}({', '.join(words)})"


def described(value: Any) -> str:
    """Return a vector, number or function in a few words: up to nine numbers as they are, of more the shape."""
    if isinstance(value, type(lambda: None)):
        return value.__qualname__.rpartition(".")[2]
    try:
        numbers = torch.as_tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError):
        return repr(value)
    if numbers.numel() > 9:
        return f"<{' x '.join(str(n) for n in numbers.shape)} numbers>"
    return _nested(numbers.tolist())


def _nested(value: Any) -> str:
    if not isinstance(value, list):
        return f"{value:.4g}"
    return f"({', '.join(_nested(part) for part in value)}{',' * (len(value) == 1)})"
