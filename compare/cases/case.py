"""What is to be compared: a shape, an operation, its handles and its settings, as plain data.

A case can be written to JSON and read back, and its key is a hash of its content (for a shape in a file, of the
file's content too), so a rerun knows which cases are done. Handles are given in the field's own coordinates.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field as default
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

if TYPE_CHECKING:  # torch takes seconds to import, and cases are read where nothing is computed
    from implicit import Handle

Operation = Literal["geometric", "smooth", "rigid"]
OPERATIONS: tuple[Operation, ...] = get_args(Operation)
MESH_SUFFIXES = (".obj", ".off", ".ply", ".stl")
FIELD_SUFFIX = ".safetensors"

# What each kind of region and motion takes: its numbers, by the argument names of the classes in `implicit`.
REGIONS = {
    "ball": ("center", "radius", "falloff"),
    "box": ("lower", "upper", "falloff"),
    "halfspace": ("point", "normal", "falloff"),
}
MOTIONS = {
    "vector": ("vector",),
    "along": ("distance",),
    "rigid": ("rotation", "translation", "center"),
}

OPTIONAL = {"falloff", "rotation", "translation"}
SCALARS = {"radius", "falloff", "distance"}  # the others are points or vectors
POSITIVE = {"radius": 0.0, "falloff": 0.0}


@dataclass(frozen=True)
class HandleSpec:
    """A part of the surface and how it is to move, in the field's coordinates.

    Args:
        region: {"kind": "ball", "center": [x, y, z], "radius": r}, or "box" with lower and upper, or "halfspace" with
            point and normal (the side that the normal points to); each may have "falloff", a width over which the
            weight sinks smoothly from 1 to 0. The displacement of a geometric edit sinks with it.
        motion: {"kind": "vector", "vector": [x, y, z]}; "along" with distance, outward along the normal; or "rigid"
            with rotation (a vector: axis times angle in radians), translation and center.
    """

    region: Mapping[str, Any]
    motion: Mapping[str, Any]

    def __post_init__(self) -> None:
        _require_numbers("region", self.region, REGIONS)
        _require_numbers("motion", self.motion, MOTIONS)

    @property
    def holds(self) -> bool:
        """Whether it is an anchor: a part that is to stay where it is."""
        return self.motion["kind"] == "vector" and not np.any(self.motion["vector"])

    def build(self) -> Handle:
        """The handle for the editors of `implicit`."""
        import implicit

        region = {k: v for k, v in self.region.items() if k != "kind"}
        motion = {k: v for k, v in self.motion.items() if k != "kind"}
        where = {"ball": implicit.Ball, "box": implicit.Box, "halfspace": implicit.HalfSpace}[self.region["kind"]]
        if self.motion["kind"] == "vector":
            return implicit.Handle(where(**region), motion["vector"])
        if self.motion["kind"] == "along":
            return implicit.Handle(where(**region), implicit.Along(motion["distance"]))
        return implicit.Handle(where(**region), implicit.RigidMotion(**motion))


@dataclass(frozen=True)
class Case:
    """One shape under one operation, for both representations.

    Args:
        shape: A bundled shape's name, or a path to a mesh (.obj, .off, .ply, .stl) or to a field (.safetensors).
        operation: "geometric", "smooth" or "rigid".
        handles: What is moved where; none for "smooth".
        parameters: Settings of the operation: "steps" and "step_size" for "smooth"; under "implicit" and under "mesh"
            keyword options of the editor of that side; under "fit" those of the fit, for a shape given as a mesh.
        vertices: About how many vertices the common mesh has.
        resolution: Cells along the longest side when the field's surface is extracted.
        seed: Of every random choice.
    """

    shape: str
    operation: Operation
    handles: tuple[HandleSpec, ...] = ()
    parameters: Mapping[str, Any] = default(default_factory=dict)
    vertices: int = 4000
    resolution: int = 96
    seed: int = 0

    def __post_init__(self) -> None:
        if not isinstance(self.shape, str) or not self.shape:
            raise TypeError(f"shape must be the name of a bundled shape or of a file, but is {self.shape!r}.")
        if not isinstance(self.operation, str) or self.operation not in OPERATIONS:
            raise ValueError(f"operation must be one of {', '.join(OPERATIONS)}, but is {self.operation!r}.")
        if not isinstance(self.handles, tuple | list) or not all(isinstance(h, HandleSpec) for h in self.handles):
            raise TypeError(f"handles must be HandleSpecs in a tuple, but are {self.handles!r}.")
        if (self.operation == "smooth") == bool(self.handles):
            raise ValueError(
                f"A {self.operation} case {'takes no' if self.handles else 'needs'} handles, "
                f"but has {len(self.handles)}."
            )
        _require_whole("vertices", self.vertices, 100)
        _require_whole("resolution", self.resolution, 8)
        _require_whole("seed", self.seed, 0)
        try:
            json.dumps(dict(self.parameters), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"parameters must be a dictionary that JSON can say, but are not: {error}.") from error

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits that differ where the case or the content of its file differs."""
        row = self.to_dict()
        row["shape"] = content_of(self.shape)
        return _digest(row)

    @property
    def subject_key(self) -> str:
        """The same for the parts that decide the field and the common mesh, which several cases share."""
        return _digest(
            {
                "shape": content_of(self.shape),
                "fit": self.parameters.get("fit", {}),
                "vertices": self.vertices,
                "resolution": self.resolution,
                "seed": self.seed,
            }
        )

    @property
    def name(self) -> str:
        """The shape without folders and suffix, for tables and file names."""
        return Path(self.shape).stem

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return json.loads(json.dumps(dataclasses.asdict(self)))  # tuples become lists, as they will be when read

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Case:
        """The case that `to_dict` wrote.

        Raises:
            ValueError: The row is no case.
        """
        known = {f.name for f in dataclasses.fields(cls)}
        if not isinstance(row, Mapping) or set(row) != known or not isinstance(row["handles"], list | tuple):
            raise ValueError(f"A case must be a row of {', '.join(sorted(known))}, but is {row!r:.200}.")
        handles = [HandleSpec(**handle) for handle in row["handles"]]
        return cls(**{**row, "handles": tuple(handles)})

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps(self.to_dict(), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Case:
        """The case that `to_json` wrote.

        Raises:
            ValueError: The text is no case.
        """
        try:
            row = json.loads(text)
        except (TypeError, ValueError) as error:
            raise ValueError(f"A case must be a line of JSON, but is {text!r:.200} ({error}).") from error
        return cls.from_dict(row)


def content_of(shape: str) -> str:
    """What a shape's name stands for: the hash of the file's content, or the name of a bundled shape."""
    path = Path(shape)
    if path.suffix.lower() in (*MESH_SUFFIXES, FIELD_SUFFIX):
        return "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()
    return shape


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
        if name in given:
            _require_number(f"{name} of a {what}", given[name], POSITIVE.get(name), 1 if name in SCALARS else 3)
    if kind == "box" and not all(a < b for a, b in zip(given["lower"], given["upper"])):
        raise ValueError(f"lower must be below upper in the region, but they are {given['lower']}, {given['upper']}.")
    if kind == "halfspace" and not np.any(given["normal"]):
        raise ValueError("normal of a region must point somewhere, but is zero.")


def _require_number(name: str, value: Any, least: float | None, count: int) -> None:
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.full(count, np.nan)
    if numbers.shape != ((3,) if count == 3 else ()) or not np.isfinite(numbers).all():
        wanted = "three finite numbers" if count == 3 else "a finite number"
        raise ValueError(f"{name} must be {wanted}, but is {value!r}.")
    if least is not None and not (numbers > least if name.startswith("radius") else numbers >= least):
        raise ValueError(
            f"{name} must be {'positive' if name.startswith('radius') else 'at least 0'}, but is {value!r}."
        )


def _require_whole(name: str, value: Any, least: int) -> None:
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, but is {value!r}.")


def _digest(row: Mapping[str, Any]) -> str:
    text = json.dumps(row, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


BUNDLED = ("spot", "cactus", "bracket")  # implicit.shapes.BUNDLED, known here without importing torch
