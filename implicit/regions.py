"""Where an edit acts and what it asks: regions of space, motions, and handles that join the two.

A region is any callable from points (N, D) to weights (N,) in [0, 1]; the ones here combine with & (both),
| (either) and ~ (all but). Their optional `falloff` lets the weight sink smoothly from 1 to 0 over that
length outside, by the quintic 1 - 10 t^3 + 15 t^4 - 6 t^5, twice continuously differentiable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_callable, require_finite, require_numbers, require_positive

RegionLike = Callable[[Tensor], Tensor]
Vector = Sequence[float] | Tensor


class Region(ABC):
    """A part of space as weights in [0, 1]."""

    @abstractmethod
    def __call__(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Weight of each point."""

    def __and__(self, other: RegionLike) -> Region:
        require_callable("The other region", other, "a region, or a function from points (N, D) to weights (N,)")
        return _Combined(lambda points: torch.minimum(self(points), other(points)))

    def __or__(self, other: RegionLike) -> Region:
        require_callable("The other region", other, "a region, or a function from points (N, D) to weights (N,)")
        return _Combined(lambda points: torch.maximum(self(points), other(points)))

    def __invert__(self) -> Region:
        return _Combined(lambda points: 1 - self(points))


class _Combined(Region):
    def __init__(self, weight: RegionLike) -> None:
        self._weight = weight

    def __call__(self, points: Tensor) -> Tensor:
        return self._weight(points)


@dataclass(frozen=True)
class Ball(Region):
    """Points within `radius` of `center`."""

    center: Vector
    radius: float
    falloff: float = 0.0

    def __post_init__(self) -> None:
        _require_place("center of a Ball", self.center)
        _require_positive("Ball", "radius", self.radius)
        require_positive("falloff of a Ball", self.falloff, "length", or_zero=True)

    def __call__(self, points: Tensor) -> Tensor:
        return _sink((points - _like(self.center, points)).norm(dim=1) - self.radius, self.falloff)


@dataclass(frozen=True)
class Box(Region):
    """Points between the corners `lower` and `upper`."""

    lower: Vector
    upper: Vector
    falloff: float = 0.0

    def __post_init__(self) -> None:
        lower, upper = _require_place("lower of a Box", self.lower), _require_place("upper of a Box", self.upper)
        require_positive("falloff of a Box", self.falloff, "length", or_zero=True)
        if lower.shape != upper.shape or not bool((lower < upper).all()):
            raise ValueError(f"Box needs lower < upper in each coordinate, but got {self.lower} and {self.upper}.")

    def __call__(self, points: Tensor) -> Tensor:
        outside = torch.maximum(_like(self.lower, points) - points, points - _like(self.upper, points)).clamp(min=0)
        return _sink(outside.norm(dim=1), self.falloff)


@dataclass(frozen=True)
class HalfSpace(Region):
    """Points on the side of the plane through `point` that `normal` points to."""

    point: Vector
    normal: Vector
    falloff: float = 0.0

    def __post_init__(self) -> None:
        _require_place("point of a HalfSpace", self.point)
        normal = _require_place("normal of a HalfSpace", self.normal)
        _require_positive("HalfSpace", "length of normal", float(normal.norm()))
        require_positive("falloff of a HalfSpace", self.falloff, "length", or_zero=True)

    def __call__(self, points: Tensor) -> Tensor:
        normal = _like(self.normal, points)
        return _sink(-(points - _like(self.point, points)) @ (normal / normal.norm()), self.falloff)


@dataclass(frozen=True, eq=False)
class NearPoints(Region):
    """Points within `radius` of any of `centers` (M, D): a set picked on a mesh, for instance."""

    centers: Float[Tensor, "m d"]
    radius: float
    falloff: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("NearPoints", "radius", self.radius)
        require_positive("falloff of NearPoints", self.falloff, "length", or_zero=True)
        centers = require_numbers("centers of NearPoints", self.centers, "points (M, D)")
        if centers.ndim != 2 or len(centers) == 0:
            raise ValueError("NearPoints needs centers of shape (M, D) with M >= 1; pick at least one point.")

    def __call__(self, points: Tensor) -> Tensor:
        centers = _like(self.centers, points)
        nearest = torch.cat([torch.cdist(part, centers).amin(dim=1) for part in points.split(4096)])
        return _sink(nearest - self.radius, self.falloff)


@dataclass(frozen=True)
class Along:
    """Motion along the outward normal by a distance, one for all points or a function of them."""

    distance: float | Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        if not callable(self.distance):
            require_finite("distance of Along", self.distance, "length")


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Rotation about `center`, then translation: x -> R (x - center) + center + translation.

    Args:
        rotation: A rotation vector (3,), its length the angle in radians; a rotation matrix (3, 3); or in the
            plane an angle.
        translation: Added after the rotation; None is zero.
        center: Fixed by the rotation; None is the origin.
    """

    rotation: Vector | float | None = None
    translation: Vector | None = None
    center: Vector | None = None

    def __post_init__(self) -> None:
        for name, value in (("translation", self.translation), ("center", self.center)):
            if value is not None:
                _require_place(f"{name} of a RigidMotion", value)
        if self.rotation is not None:
            require_numbers("rotation of a RigidMotion", self.rotation, "a vector of 3, a matrix or an angle")

    def at(self, fraction: float, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Where the points are after a fraction of the motion: the angle and the translation grow evenly."""
        dimension = points.shape[1]
        zero = points.new_zeros(dimension)
        center = zero if self.center is None else _like(self.center, points, "center of a RigidMotion")
        shift = zero if self.translation is None else _like(self.translation, points, "translation of a RigidMotion")
        generator = _rotation_generator(self.rotation, dimension).to(points) * fraction
        return (points - center) @ torch.matrix_exp(generator).T + center + fraction * shift


Displacement = Vector | Callable[[Tensor], Tensor] | Along | RigidMotion


@dataclass(frozen=True, eq=False)
class Handle:
    """A region of the surface and how far its points are to move, in the field's own length units.

    Args:
        region: Any callable from points (N, D) to weights (N,) in [0, 1].
        displacement: A vector (D,), a function from points to vectors (N, D), Along(distance) for motion
            along the normal, or RigidMotion.
    """

    region: RegionLike
    displacement: Displacement

    def __post_init__(self) -> None:
        require_callable(
            "region of a Handle", self.region, "a region, or a function from points (N, D) to weights (N,)"
        )
        if not (callable(self.displacement) or isinstance(self.displacement, Along | RigidMotion)):
            _require_place("displacement of a Handle", self.displacement)

    def weights(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The region's weights, checked."""
        weights = self.region(points)
        if not isinstance(weights, Tensor) or weights.shape != points.shape[:1]:
            came = tuple(weights.shape) if isinstance(weights, Tensor) else type(weights).__name__
            raise ValueError(
                f"A region must give a tensor of one weight a point, shape ({len(points)},), but gave {came}."
            )
        weights = weights.to(points)
        if not bool(((weights >= 0) & (weights <= 1)).all()):
            raise ValueError("A region's weights must lie in [0, 1]; clamp them.")
        return weights

    def turned(self, vectors: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Vectors (N, D), such as normals, after the whole motion: only RigidMotion turns them."""
        motion = self.displacement
        if not isinstance(motion, RigidMotion):
            return vectors
        return motion.at(1.0, vectors) - motion.at(1.0, torch.zeros_like(vectors))

    def position(
        self, fraction: float, points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        """Where points of the unedited surface, with their normals there, are to be after a fraction of the motion."""
        motion = self.displacement
        if isinstance(motion, RigidMotion):
            moved = motion.at(fraction, points)
        elif isinstance(motion, Along):
            distance = _exact(motion.distance(points) if callable(motion.distance) else motion.distance, points)
            if distance.numel() not in (1, len(points)):
                raise ValueError(
                    f"The displacement Along must be one distance, or a function that gives one a point, "
                    f"({len(points)},), but gave {tuple(distance.shape)}."
                )
            moved = points + fraction * distance.reshape(-1, 1) * normals
        else:
            vectors = motion(points) if callable(motion) else motion
            if callable(motion) and not isinstance(vectors, Tensor):
                raise ValueError(
                    f"The displacement must be a tensor of vectors (N, D), but the function gave a "
                    f"{type(vectors).__name__}."
                )
            vectors = _exact(vectors, points)
            if vectors.shape not in (points.shape, points.shape[1:]):
                raise ValueError(
                    f"A displacement must be a vector of {points.shape[1]} numbers or one a point, but has shape "
                    f"{tuple(vectors.shape)}."
                )
            moved = points + fraction * vectors
        if not bool(torch.isfinite(moved).all()):
            raise ValueError("A handle's displacement is not finite. Mend the vector or the function that gives it.")
        return moved


def _rotation_generator(rotation: Vector | float | None, dimension: int) -> Tensor:
    """The skew-symmetric matrix whose exponential is the rotation."""
    zero = torch.zeros(dimension, dimension, dtype=torch.float64)
    if rotation is None:
        return zero
    value = torch.as_tensor(rotation, dtype=torch.float64)
    if dimension == 2 and value.numel() == 1:
        angle = float(value)
        return torch.tensor([[0.0, -angle], [angle, 0.0]], dtype=torch.float64)
    if value.shape == (3, 3):
        from scipy.spatial.transform import Rotation

        if (value.T @ value - torch.eye(3, dtype=torch.float64)).abs().max() > 1e-6 or torch.linalg.det(value) < 0:
            raise ValueError("rotation is no rotation matrix: it must be orthogonal with determinant +1.")
        value = torch.from_numpy(Rotation.from_matrix(value.numpy()).as_rotvec())
    if value.shape != (3,) or dimension != 3:
        raise ValueError(
            f"rotation must be a vector of 3, a 3 x 3 matrix, or in the plane an angle, but has shape "
            f"{tuple(value.shape)} in {dimension} dimensions."
        )
    x, y, z = value.tolist()
    return torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)


def _sink(distance: Tensor, falloff: float) -> Tensor:
    """1 at distance <= 0, sinking to 0 at `falloff`."""
    if falloff <= 0:
        return (distance <= 0).to(distance)
    t = (distance / falloff).clamp(0, 1)
    return (1 - t**3 * (10 - 15 * t + 6 * t**2)).clamp(0, 1)  # rounding leaves the range near both ends


def _like(vector: Vector | Tensor, points: Tensor, name: str = "The region") -> Tensor:
    value = _exact(vector, points)
    if value.shape[-1] != points.shape[1]:
        raise ValueError(
            f"{name} must be in the dimensions of the points, {points.shape[1]}, but is in "
            f"{value.shape[-1]} dimensions."
        )
    return value


def _require_place(name: str, value: Vector) -> Tensor:
    place = require_numbers(name, value, "a point or vector (D,)")
    if place.ndim != 1:
        raise ValueError(f"{name} must be a point or vector (D,), but has the shape {tuple(place.shape)}.")
    return place


def _exact(value: Vector | float, like: Tensor) -> Tensor:
    """The value in the other's dtype; plain numbers go there without torch's default of single precision."""
    return value.to(like) if isinstance(value, Tensor) else torch.as_tensor(value, dtype=like.dtype, device=like.device)


def _require_positive(what: str, name: str, value: float) -> None:
    if isinstance(value, str) or not value > 0:
        raise ValueError(f"{what} needs a positive {name}, but got {value!r}.")
