"""Handles as plain data: a part of the surface and how it is to move, in a field's coordinates or in the user's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

if TYPE_CHECKING:  # torch takes seconds to import, and handles are read where nothing is computed
    from torch import Tensor

    from implicit import Handle, RigidMotion

# What each kind of region and motion takes: its numbers, by the argument names of the classes in `implicit`.
REGIONS = {
    "ball": ("center", "radius", "falloff"),
    "box": ("lower", "upper", "falloff"),
    "halfspace": ("point", "normal", "falloff"),
    "points": ("centers", "radius", "falloff"),
    "nearest": ("point", "radius", "falloff"),
    "vertices": ("vertices", "radius", "falloff"),
}
ON_A_SHAPE = ("nearest", "vertices")  # which compare.cases.placing makes balls and points of
MOTIONS = {
    "vector": ("vector",),
    "along": ("distance",),
    "rigid": ("rotation", "translation", "center"),
    "similar": ("factor", "center", "rotation", "translation"),
}

OPTIONAL = {"falloff", "rotation", "translation"}
SCALARS = {"radius", "falloff", "distance", "factor"}  # the others are points or vectors
LISTS = {"centers"}  # of points
# How each changes from the user's coordinates to the field's; rotations and normals are the same in both.
PLACES = {"center", "centers", "lower", "upper", "point"}
LENGTHS = {"radius", "falloff", "distance", "vector", "translation"}
POSITIVE = {"radius": 0.0, "falloff": 0.0, "factor": 0.0}


@dataclass(frozen=True, repr=False)
class HandleSpec:
    """A part of the surface and how it is to move, in the field's coordinates unless its case says otherwise.

    Args:
        region: {"kind": "ball", "center": [x, y, z], "radius": r}; "box" with lower and upper; "halfspace" with point
            and normal (the side that the normal points to); "points" with centers and radius, what lies within the
            radius of any of them; "nearest" with point and radius, a ball round the place of the surface that is
            nearest to the point; or "vertices" with vertices and radius, balls round vertices of the mesh in the
            shape's file, counted from 0. Each may have "falloff", a width over which the weight sinks smoothly from 1
            to 0. The displacement of a geometric edit sinks with it.
        motion: {"kind": "vector", "vector": [x, y, z]}; "along" with distance, outward along the normal; "rigid"
            with rotation (a vector: axis times angle in radians), translation and center; or "similar", which scales
            by factor about center as well.
    """

    region: Mapping[str, Any]
    motion: Mapping[str, Any]

    def __post_init__(self) -> None:
        _require_numbers("region", self.region, REGIONS)
        _require_numbers("motion", self.motion, MOTIONS)

    def __repr__(self) -> str:
        """Return the kinds and numbers in one line."""
        return f"HandleSpec({_words(self.region)}; {_words(self.motion)})"

    @property
    def holds(self) -> bool:
        """Return whether it is an anchor: a part that is to stay where it is."""
        return self.motion["kind"] == "vector" and not np.any(self.motion["vector"])

    def in_field(self, scale: float, offset: Sequence[float]) -> HandleSpec:
        """Return the handle in a field's coordinates x, where it is given in the user's, scale * x + offset."""
        motion = dict(self.motion)
        if motion["kind"] == "rigid":  # about the user's origin, which the field has elsewhere
            motion.setdefault("center", [0.0, 0.0, 0.0])
        return HandleSpec(_in_field(self.region, scale, offset), _in_field(motion, scale, offset))

    def build(self) -> Handle:
        """Return the handle for the editors of `implicit`."""
        import implicit

        region = {k: v for k, v in self.region.items() if k != "kind"}
        motion = {k: v for k, v in self.motion.items() if k != "kind"}
        kind = self.region["kind"]
        if kind in ON_A_SHAPE:
            raise ValueError(
                f"A region of the kind {kind!r} is placed on a shape first: run its case, or make it one with "
                "compare.cases.placing.placed."
            )
        where = {
            "ball": implicit.Ball,
            "box": implicit.Box,
            "halfspace": implicit.HalfSpace,
            "points": implicit.NearPoints,
        }[kind]
        if self.motion["kind"] == "vector":
            return implicit.Handle(where(**region), motion["vector"])
        if self.motion["kind"] == "along":
            return implicit.Handle(where(**region), implicit.Along(motion["distance"]))
        if self.motion["kind"] == "similar":
            return implicit.Handle(where(**region), _Similar(motion.pop("factor"), implicit.RigidMotion(**motion)))
        return implicit.Handle(where(**region), implicit.RigidMotion(**motion))


@dataclass(frozen=True, eq=False)
class _Similar:
    """Displacement of points that are scaled about the centre of a rigid motion, and then take that."""

    factor: float
    rigid: RigidMotion

    def __call__(self, points: Tensor) -> Tensor:
        center = points.new_tensor(self.rigid.center)
        return self.rigid.at(1.0, center + self.factor * (points - center)) - points


def rounded(point: ndarray) -> list[float]:
    """Return a point as a list of numbers that are short to read, without negative zeros."""
    return [round(float(x), 6) + 0.0 for x in point]


def _in_field(row: Mapping[str, Any], scale: float, offset: Sequence[float]) -> dict[str, Any]:
    changed = dict(row)
    for name, value in row.items():
        if name in PLACES:
            changed[name] = ((np.asarray(value, dtype=float) - np.asarray(offset, dtype=float)) / scale).tolist()
        elif name in LENGTHS:
            changed[name] = (np.asarray(value, dtype=float) / scale).tolist()
    return changed


def _words(row: Mapping[str, Any]) -> str:
    numbers = (f"{name}={value}" for name, value in row.items() if name != "kind")
    return " ".join((str(row["kind"]), *numbers))


def _require_numbers(what: str, given: Mapping[str, Any], kinds: Mapping[str, tuple[str, ...]]) -> None:
    if not isinstance(given, Mapping):
        raise TypeError(f"A {what} must be a dictionary with its kind and numbers, but is {given!r}.")
    kind = str(given.get("kind"))
    if kind not in kinds:
        raise ValueError(f"The kind of a {what} must be one of {', '.join(kinds)}, but is {kind!r}.")
    takes = kinds[kind]
    unknown, missing = set(given) - {"kind", *takes}, set(takes) - OPTIONAL - set(given)
    if unknown or (missing and kind != "rigid"):
        raise ValueError(f"A {what} of kind {kind!r} must have {', '.join(takes)}, but has {', '.join(given)}.")
    for name in takes:
        if name not in given:
            continue
        if name == "vertices":
            _require_vertices(given[name])
        elif name in LISTS:
            _require_points(name, given[name])
        else:
            _require_number(f"{name} of a {what}", given[name], POSITIVE.get(name), 1 if name in SCALARS else 3)
    if kind == "box" and not all(a < b for a, b in zip(given["lower"], given["upper"])):
        raise ValueError(f"lower must be below upper in the region, but they are {given['lower']}, {given['upper']}.")
    if kind == "halfspace" and not np.any(given["normal"]):
        raise ValueError("normal of a region must point somewhere, but is zero.")


def _require_vertices(given: Any) -> None:
    numbers = given if isinstance(given, list | tuple) else []
    if not numbers or not all(isinstance(v, int) and not isinstance(v, bool) and v >= 0 for v in numbers):
        raise ValueError(f"vertices of a region must be whole numbers from 0, at least one, but are {given!r:.100}.")


def _require_points(name: str, given: Any) -> None:
    try:
        points = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise ValueError(f"{name} of a region must be points of three finite numbers each, but are {given!r:.200}.")


def _require_number(name: str, value: Any, least: float | None, count: int) -> None:
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.full(count, np.nan)
    if numbers.shape != ((3,) if count == 3 else ()) or not np.isfinite(numbers).all():
        kind = "three finite numbers" if count == 3 else "a finite number"
        raise ValueError(f"{name} must be {kind}, but is {value!r}.")
    if least is not None and not (numbers > least if name.startswith(("radius", "factor")) else numbers >= least):
        raise ValueError(
            f"{name} must be {'positive' if name.startswith(('radius', 'factor')) else 'at least 0'}, but is {value!r}."
        )
