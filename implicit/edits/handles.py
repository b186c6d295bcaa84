"""Handles: a region of the surface, and its motion.

What a handle asks of a point, and what several ask of it together, is in implicit.edits.targets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_callable, require_finite, require_numbers
from implicit.edits.regions import RegionLike, Vector, described_fields, exact, like, require_place


@dataclass(frozen=True, repr=False)
class Along:
    """Motion along the outward normal by a distance, one for all points or a function of them."""

    distance: float | Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        if not callable(self.distance):
            require_finite("distance of Along", self.distance, "length")

    def at(self, fraction: float, points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return where the points are after a fraction of the distance."""
        distance = exact(self.distance(points) if callable(self.distance) else self.distance, points)
        if distance.numel() not in (1, len(points)):
            raise ValueError(
                f"The displacement Along must be one distance, or a function that gives one a point, "
                f"({len(points)},), but gave {tuple(distance.shape)}."
            )
        return points + fraction * distance.reshape(-1, 1) * normals

    def __repr__(self) -> str:
        return described_fields(self)


@dataclass(frozen=True, eq=False, repr=False)
class RigidMotion:
    """Rotation about `center`, then translation: x -> R (x - center) + center + translation.

    Args:
        rotation: A rotation vector (3,), its length the angle in radians; a rotation matrix (3, 3); or in the
            plane an angle.
        translation: Vector (D,) added after the rotation, a length; None is zero.
        center: Point (D,) that the rotation leaves where it is; None is the origin.
    """

    rotation: Vector | float | None = None
    translation: Vector | None = None
    center: Vector | None = None

    def __post_init__(self) -> None:
        for name, value in (("translation", self.translation), ("center", self.center)):
            if value is not None:
                require_place(f"{name} of a RigidMotion", value)
        if self.rotation is not None:
            require_numbers("rotation of a RigidMotion", self.rotation, "a vector of 3, a matrix or an angle")

    def at(self, fraction: float, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return where the points are after a fraction of the motion: the angle and the translation grow evenly."""
        dimension = points.shape[1]
        zero = points.new_zeros(dimension)
        center = zero if self.center is None else like(self.center, points, "center of a RigidMotion")
        shift = zero if self.translation is None else like(self.translation, points, "translation of a RigidMotion")
        generator = _rotation_generator(self.rotation, dimension).to(points) * fraction
        return (points - center) @ torch.matrix_exp(generator).T + center + fraction * shift

    def __repr__(self) -> str:
        return described_fields(self)


@dataclass(frozen=True, eq=False, repr=False)
class Scaling:
    """Scaling about `center`: x -> center + factor (x - center). The path grows by even factors.

    Args:
        factor: Positive number, or one for each axis (D,).
        center: Point (D,) that stays where it is; None is the origin.
    """

    factor: Vector | float
    center: Vector | None = None

    def __post_init__(self) -> None:
        factor = require_numbers("factor of a Scaling", self.factor, "a number, or one for each axis (D,)")
        if factor.ndim > 1 or not bool((factor > 0).all()):
            raise ValueError(
                f"factor of a Scaling must be a positive number, or one for each axis (D,), but is {self.factor!r}."
            )
        if self.center is not None:
            require_place("center of a Scaling", self.center)

    def at(self, fraction: float, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return where the points are after a fraction of the motion."""
        zero = points.new_zeros(points.shape[1])
        center = zero if self.center is None else like(self.center, points, "center of a Scaling")
        return center + self._factors(points) ** fraction * (points - center)

    def turned(self, vectors: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        """Return unit normals after the whole motion."""
        return torch.nn.functional.normalize(vectors / self._factors(vectors), dim=1)

    def _factors(self, points: Tensor) -> Tensor:
        factor = exact(self.factor, points)
        return factor if factor.ndim == 0 else like(factor, points, "factor of a Scaling")

    def __repr__(self) -> str:
        return described_fields(self)


Displacement = Vector | Callable[[Tensor], Tensor] | Along | RigidMotion | Scaling


@dataclass(frozen=True, eq=False, repr=False)
class Handle:
    """A region of the surface and how far its points are to move, in the field's own length units.

    Args:
        region: Any callable from points (N, D) to weights (N,) in [0, 1].
        displacement: A vector (D,), a function from points to vectors (N, D), Along(distance) for motion
            along the normal, RigidMotion, or Scaling.
    """

    region: RegionLike
    displacement: Displacement

    def __post_init__(self) -> None:
        require_callable(
            "region of a Handle", self.region, "a region, or a function from points (N, D) to weights (N,)"
        )
        if not (callable(self.displacement) or isinstance(self.displacement, Along | RigidMotion | Scaling)):
            require_place("displacement of a Handle", self.displacement)

    def weights(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return the region's weights of the points (N,).

        Raises:
            ValueError: The region gives something else than a weight in [0, 1] for each.
        """
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
        """Return unit normals (N, D) after the whole motion: only RigidMotion and Scaling turn them."""
        motion = self.displacement
        if isinstance(motion, Scaling):
            return motion.turned(vectors)
        if not isinstance(motion, RigidMotion):
            return vectors
        return motion.at(1.0, vectors) - motion.at(1.0, torch.zeros_like(vectors))

    def position(
        self, fraction: float, points: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]
    ) -> Float[Tensor, "n d"]:
        """Return where points of the unedited surface, with their normals there, are to be after a fraction.

        Raises:
            ValueError: The motion does not give a finite place for each point.
        """
        motion = self.displacement
        if isinstance(motion, RigidMotion | Scaling):
            moved = motion.at(fraction, points)
        elif isinstance(motion, Along):
            moved = motion.at(fraction, points, normals)
        else:
            moved = points + fraction * _vectors(motion, points)
        if not bool(torch.isfinite(moved).all()):
            raise ValueError("A handle's displacement is not finite. Mend the vector or the function that gives it.")
        return moved

    def __repr__(self) -> str:
        return described_fields(self)


def _vectors(motion: Vector | Callable[[Tensor], Tensor], points: Float[Tensor, "n d"]) -> Tensor:
    """Return the displacement as one vector (D,), or one a point (N, D)."""
    vectors = motion(points) if callable(motion) else motion
    if callable(motion) and not isinstance(vectors, Tensor):
        raise ValueError(
            f"The displacement must be a tensor of vectors (N, D), but the function gave a {type(vectors).__name__}."
        )
    vectors = exact(vectors, points)
    if vectors.shape not in (points.shape, points.shape[1:]):
        raise ValueError(
            f"A displacement must be a vector of {points.shape[1]} numbers or one a point, but has shape "
            f"{tuple(vectors.shape)}."
        )
    return vectors


def _rotation_generator(rotation: Vector | float | None, dimension: int) -> Tensor:
    """Return the skew-symmetric matrix (D, D) whose exponential is the rotation."""
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
