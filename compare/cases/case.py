"""A comparison to make: a shape, an operation, its handles and its settings, as plain data.

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
from typing import Any

import numpy as np

from compare.cases.handles import HandleSpec
from compare.cases.registry import OPERATIONS

MESH_SUFFIXES = (".obj", ".off", ".ply", ".stl")
FIELD_SUFFIX = ".safetensors"
BUNDLED = ("spot", "cactus", "bracket")  # implicit.shapes.BUNDLED, known here without importing torch


@dataclass(frozen=True, repr=False)
class Case:
    """One shape under one operation, for both representations.

    Args:
        shape: A bundled shape's name, or a path to a mesh (.obj, .off, .ply, .stl) or to a field (.safetensors).
        operation: "geometric", "smooth", "rigid", or another that was registered; see compare.operations.
        handles: What is moved where; none for "smooth".
        parameters: Settings of the operation: "steps" and "step_size" for "smooth"; under "implicit" and under "mesh"
            keyword options of the editor of that side; under "fit" those of the fit, for a shape given as a mesh.
        vertices: About how many vertices the common mesh has.
        resolution: Cells along the longest side when the field's surface is extracted.
        seed: Of every random choice.
    """

    shape: str
    operation: str
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
        if OPERATIONS[self.operation].takes_handles != bool(self.handles):
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

    def __repr__(self) -> str:
        """Return what the case is, with its handles counted and its settings named, in one line."""
        count = len(self.handles)
        handles = f", {count} handle{'s' * (count > 1)}" if count else ""
        settings = {"vertices": self.vertices, "resolution": self.resolution, "seed": self.seed} | dict(self.parameters)
        return f"Case({self.shape}, {self.operation}{handles}, {', '.join(f'{k}={v}' for k, v in settings.items())})"

    @cached_property
    def key(self) -> str:
        """Hash of 16 hexadecimal digits that differ where the case or the content of its file differs."""
        row = self.to_dict()
        row["shape"] = content_of(self.shape)
        return _digest(row)

    @property
    def subject_key(self) -> str:
        """Hash of the parts alone that decide the field and the common mesh, which several cases share."""
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
        """Name of the shape without folders and suffix, for tables and file names."""
        return Path(self.shape).stem

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return json.loads(json.dumps(dataclasses.asdict(self)))  # tuples become lists, as they will be when read

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Case:
        """Return the case that `to_dict` wrote.

        Raises:
            ValueError: The row is no case.
        """
        known = {f.name for f in dataclasses.fields(cls)}
        if not isinstance(row, Mapping) or set(row) != known or not isinstance(row["handles"], list | tuple):
            raise ValueError(f"A case must be a row of {', '.join(sorted(known))}, but is {row!r:.200}.")
        handles = [HandleSpec(**handle) for handle in row["handles"]]
        return cls(**{**row, "handles": tuple(handles)})

    def to_json(self) -> str:
        """Return one line of JSON."""
        return json.dumps(self.to_dict(), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Case:
        """Return the case that `to_json` wrote.

        Raises:
            ValueError: The text is no case.
        """
        try:
            row = json.loads(text)
        except (TypeError, ValueError) as error:
            raise ValueError(f"A case must be a line of JSON, but is {text!r:.200} ({error}).") from error
        return cls.from_dict(row)


def content_of(shape: str) -> str:
    """Return what a shape's name stands for: the hash of the file's content, or the name of a bundled shape."""
    path = Path(shape)
    if path.suffix.lower() in (*MESH_SUFFIXES, FIELD_SUFFIX):
        return "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()
    return shape


def _require_whole(name: str, value: Any, least: int) -> None:
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, but is {value!r}.")


def _digest(row: Mapping[str, Any]) -> str:
    text = json.dumps(row, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
