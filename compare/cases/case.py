"""A comparison to make: a shape, an operation, its handles and its settings, as plain data.

A case can be written to JSON and read back, and its key is a hash of its content (for a shape in a file, of the
file's content too), so a rerun knows which cases are done. Handles are given in the field's own coordinates, or in
those of the shape's file.
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

MESH_SUFFIXES = (".obj", ".off", ".ply", ".stl", ".glb", ".gltf", ".3mf", ".dae")
FIELD_SUFFIX = ".safetensors"
COORDINATES = ("field", "user")
OPTIONAL = {"module": None, "coordinates": "field"}  # left out of a row where they are so
BUNDLED = ("spot", "cactus", "bracket")  # implicit.shapes.BUNDLED, known here without importing torch


class NameOfFile(str):
    """Name of a user's function as a file says it: kept, shown and compared, but never imported.

    Whoever wants the code to run names it anew: dataclasses.replace(case, module="my_nets.py:make").
    """

    __slots__ = ()


@dataclass(frozen=True, repr=False)
class Case:
    """One shape under one operation, for both representations.

    Args:
        shape: A bundled shape's name, or a path to a mesh (see MESH_SUFFIXES) or to a field (.safetensors).
        operation: "geometric", "smooth", "rigid", or another that was registered; see compare.operations.
        handles: What is moved where; none for "smooth".
        parameters: Settings of the operation: "steps" and "step_size" for "smooth"; under "implicit" and under "mesh"
            keyword options of the editor of that side; under "fit" those of the fit, for a shape given as a mesh.
        vertices: About how many vertices the common mesh has.
        resolution: Cells along the longest side when the field's surface is extracted.
        seed: Of every random choice.
        module: Name of what builds the module of a field that is saved with a builder, "my_nets.py:make" or
            "package.module:function"; None for all other shapes. It is run where it is named in a call or a command,
            and not where a file of cases names it.
        coordinates: Of the handles: "field", or "user", those of the shape's file, which a fit moves and scales.
    """

    shape: str
    operation: str
    handles: tuple[HandleSpec, ...] = ()
    parameters: Mapping[str, Any] = default(default_factory=dict)
    vertices: int = 4000
    resolution: int = 96
    seed: int = 0
    module: str | None = None
    coordinates: str = "field"

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
        if self.module is not None:
            _require_name(self.module, self.shape)
        if self.coordinates not in COORDINATES:
            raise ValueError(f'coordinates must be "field" or "user", but are {self.coordinates!r}.')
        try:
            json.dumps(dict(self.parameters), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"parameters must be a dictionary that JSON can say, but are not: {error}.") from error

    def __repr__(self) -> str:
        """Return what the case is, with its handles counted and its settings named, in one line."""
        count = len(self.handles)
        handles = f", {count} handle{'s' * (count > 1)}" if count else ""
        settings = {"vertices": self.vertices, "resolution": self.resolution, "seed": self.seed} | dict(self.parameters)
        settings |= {} if self.module is None else {"module": self.module}
        settings |= {} if self.coordinates == "field" else {"coordinates": self.coordinates}
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
        row = {
            "shape": content_of(self.shape),
            "fit": self.parameters.get("fit", {}),
            "vertices": self.vertices,
            "resolution": self.resolution,
            "seed": self.seed,
        }
        return _digest(row if self.module is None else {**row, "module": self.module})

    @property
    def name(self) -> str:
        """Name of the shape without folders and suffix, for tables and file names."""
        return Path(self.shape).stem

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; the module only where there is one, the coordinates where they are the user's."""
        row = json.loads(json.dumps(dataclasses.asdict(self)))  # tuples become lists, as they will be when read
        return {name: value for name, value in row.items() if OPTIONAL.get(name, "") != value}

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Case:
        """Return the case that `to_dict` wrote. Its module, if it has one, is a NameOfFile, which is not run.

        Raises:
            ValueError: The row is no case.
        """
        known = {f.name for f in dataclasses.fields(cls)}
        whole = isinstance(row, Mapping) and known - set(OPTIONAL) <= set(row) <= known
        if not whole or not isinstance(row["handles"], list | tuple):
            raise ValueError(f"A case must be a row of {', '.join(sorted(known))}, but is {row!r:.200}.")
        handles = [HandleSpec(**handle) for handle in row["handles"]]
        name = row.get("module")
        module = NameOfFile(name) if isinstance(name, str) else name
        return cls(**{**row, "handles": tuple(handles), "module": module})

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
        content = path.read_bytes()
        if path.suffix.lower() == ".gltf":  # which names the files that hold the numbers
            named = (beside for beside in sorted(path.parent.iterdir()) if beside.name.encode() in content)
            content += b"".join(beside.read_bytes() for beside in named if beside.is_file())
        return "sha256:" + hashlib.sha256(content).hexdigest()
    return shape


def _require_whole(name: str, value: Any, least: int) -> None:
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} must be a whole number, at least {least}, but is {value!r}.")


def _require_name(module: Any, shape: str) -> None:
    if not isinstance(module, str) or ":" not in module:
        raise ValueError(f'module must be "my_nets.py:make" or "package.module:function", or None, but is {module!r}.')
    if Path(shape).suffix.lower() != FIELD_SUFFIX:
        raise ValueError(
            f"module builds the network of a field's file, ending in {FIELD_SUFFIX}, but the shape is {shape}. Leave "
            "module out, or save the field first."
        )


def _digest(row: Mapping[str, Any]) -> str:
    text = json.dumps(row, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
