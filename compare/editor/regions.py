"""Regions as they are picked on a surface, in the words of HandleSpec, in the field's coordinates.

| picked by | region |
|---|---|
| a click | ball about it, with a falloff |
| a brush | balls about all points that it went over |
| two corners | box |
| a click, or a plane | half-space: everything beyond the plane |
| a stroke across the view | half-space beyond the plane that the stroke and the line of sight span |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from compare.cases.handles import HandleSpec

Role = Literal["moves", "held"]


@dataclass(frozen=True)
class Picked:
    """A region of a session.

    Attributes:
        region: As in HandleSpec.
        role: "moves" goes with the hand, "held" is an anchor.
        grip: Place about which the region turns and is scaled, and where the gizmo sits.
    """

    region: dict[str, Any]
    role: Role
    grip: tuple[float, float, float]


def ball(center: ArrayLike, radius: float, falloff: float | None = None) -> dict[str, Any]:
    """Return a ball about a point.

    Args:
        center: Point (3,).
        radius: Length within which all moves as one.
        falloff: Length outside over which the motion sinks to nothing; None is as long as the radius.
    """
    falloff = radius if falloff is None else falloff
    return _checked({"kind": "ball", "center": _place(center), "radius": radius, "falloff": falloff})


def brush(points: ArrayLike, radius: float, falloff: float | None = None) -> dict[str, Any]:
    """Return the balls about all points (M, 3) that a brush went over.

    Args:
        points: Points (M, 3).
        radius, falloff: As for ball.
    """
    centers = np.atleast_2d(np.asarray(points, dtype=float)).tolist()
    falloff = radius if falloff is None else falloff
    return _checked({"kind": "points", "centers": centers, "radius": radius, "falloff": falloff})


def box(corner: ArrayLike, other: ArrayLike, falloff: float = 0.0) -> dict[str, Any]:
    """Return the box between two corners (3,), whichever they are.

    Args:
        corner, other: Corners (3,).
        falloff: Length outside over which the motion sinks to nothing.
    """
    both = np.stack([np.asarray(_place(corner)), np.asarray(_place(other))])
    lower, upper = both.min(axis=0).tolist(), both.max(axis=0).tolist()
    return _checked({"kind": "box", "lower": lower, "upper": upper, "falloff": falloff})


def half_space(point: ArrayLike, normal: ArrayLike, falloff: float = 0.0) -> dict[str, Any]:
    """Return everything beyond the plane through a point, on the side that the normal points to.

    Args:
        point, normal: Point and vector (3,).
        falloff: Length before the plane over which the motion sinks to nothing.
    """
    return _checked({"kind": "halfspace", "point": _place(point), "normal": _place(normal), "falloff": falloff})


def beyond_stroke(start: ArrayLike, end: ArrayLike, sight: ArrayLike, falloff: float = 0.0) -> dict[str, Any]:
    """Return everything beyond a stroke that was drawn across the view.

    Args:
        start, end: Ends of the stroke on the surface (3,). What lies to its left, as seen, is beyond.
        sight: Direction (3,) in which the viewer looks.
        falloff: Length before the plane over which the motion sinks to nothing.

    Raises:
        ValueError: The stroke is a point, or runs along the line of sight.
    """
    along = np.subtract(_place(end), _place(start))
    normal = np.cross(_place(sight), along)
    if not np.linalg.norm(normal) > 1e-9 * np.linalg.norm(along) * np.linalg.norm(_place(sight)):
        raise ValueError("A stroke must run across the view, but begins and ends at one place of it. Draw it longer.")
    # With the stroke to the right of the picture, sight x along points down in it, and left of the stroke is up.
    return half_space(start, -normal / np.linalg.norm(normal), falloff)


def held(region: dict[str, Any]) -> HandleSpec:
    """Return the handle that holds a region where it is."""
    return HandleSpec(region, {"kind": "vector", "vector": [0.0, 0.0, 0.0]})


def _place(point: ArrayLike) -> list[float]:
    return [float(number) for number in np.asarray(point, dtype=float).ravel()]


def _checked(region: dict[str, Any]) -> dict[str, Any]:
    """Return the region, which HandleSpec refuses where its numbers are none."""
    return dict(held(region).region)
