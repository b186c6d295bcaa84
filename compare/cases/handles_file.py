"""Handles in a TOML file, in the coordinates of the shape's own file or in the field's.

    coordinates = "user"                    # those of the shape's file, the default; or "field"
    [[handles]]
    region = { kind = "ball", center = [100.0, 50.0, 10.0], radius = 8.0 }
    motion = { kind = "vector", vector = [0.0, 0.0, 5.0] }

A handle is as in HandleSpec, and as in the file of a study, whose handles are in the field's coordinates.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from compare.cases.case import COORDINATES
from compare.cases.handles import HandleSpec
from compare.errors import InputError

KEYS = {"coordinates", "handles"}


@dataclass(frozen=True)
class HandlesFile:
    """Handles, and the coordinates in which they are given: "user" or "field"."""

    handles: tuple[HandleSpec, ...]
    coordinates: str = "user"


def read_handles(path: str | PathLike[str]) -> HandlesFile:
    """Return the handles of a file.

    Raises:
        InputError: There is no such file, or it holds something else.
    """
    path = Path(path)
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"The handles {path} cannot be read: {error.strerror}. Name a TOML file with them.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is no TOML: {error}.") from error
    if unknown := sorted(set(given) - KEYS):
        raise InputError(f"There is no key {unknown[0]} in {path}; it takes coordinates and [[handles]].")
    coordinates = given.get("coordinates", "user")
    if coordinates not in COORDINATES:
        raise InputError(f'coordinates in {path} must be "user" or "field", but is {coordinates!r}.')
    rows = given.get("handles")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path} holds no handles. Write [[handles]] with a region and a motion, once for each.")
    return HandlesFile(tuple(_handle(row, k, path) for k, row in enumerate(rows, start=1)), coordinates)


def _handle(row: Any, number: int, path: Path) -> HandleSpec:
    if not isinstance(row, dict) or set(row) != {"region", "motion"}:
        raise InputError(f"Handle {number} in {path} must have a region and a motion, but is {row!r:.200}.")
    try:
        return HandleSpec(**row)
    except (ValueError, TypeError) as error:
        raise InputError(f"Handle {number} in {path} makes no sense: {error}") from error


def handles_text(handles: Sequence[HandleSpec], coordinates: str, *, digits: int = 17, remark: str = "") -> str:
    """Return the text of a file of handles.

    Args:
        handles: In the coordinates named.
        coordinates: "user" or "field".
        digits: Of each number; 17 are all of them.
        remark: To stand behind the coordinates.
    """
    rows = (
        f"\n[[handles]]\nregion = {_table(h.region, digits)}\nmotion = {_table(h.motion, digits)}\n" for h in handles
    )
    return f'coordinates = "{coordinates}"{remark}\n' + "".join(rows)


def _table(row: Mapping[str, Any], digits: int) -> str:
    return "{ " + ", ".join(f"{name} = {_value(value, digits)}" for name, value in row.items()) + " }"


def _value(value: Any, digits: int) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(part, digits) for part in value)}]"
    return repr(float(f"{value:.{digits}g}") + 0.0)
