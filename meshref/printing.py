"""Results on one line: an array by its type and shape, a status by its name, a number by four digits."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np

# Longest tuple of numbers or words that is printed in full.
MOST_ENTRIES = 8


def brief(result: Any) -> str:
    """Return "Name(part=..., part=...)" for a dataclass or a named tuple, without the content of its arrays."""
    if dataclasses.is_dataclass(result):
        names = [part.name for part in dataclasses.fields(result) if part.repr]
    else:
        names = list(result._fields)
    return f"{type(result).__name__}({', '.join(f'{name}={_word(getattr(result, name))}' for name in names)})"


def counted(count: int, one: str, many: str) -> str:
    """Return a number with what it counts in plain English, one as a word: "one edge", "3 edges".

    Words after the noun, such as its verb, may stand in both: counted(k, "edge is", "edges are").
    """
    return f"one {one}" if count == 1 else f"{count} {many}"


def _word(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{list(value.shape)}"
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_word(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, tuple):
        if len(value) <= MOST_ENTRIES and all(isinstance(entry, int | float | str) for entry in value):
            return "(" + ", ".join(map(_word, value)) + ")"
        return f"<{len(value)} {'x ' + type(value[0]).__name__ if value else 'entries'}>"
    return repr(value)
