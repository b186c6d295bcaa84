"""Architectures that can be saved by name: each states itself in `describe()` and is made again by `build`.

The registry knows none of them: each registers itself where it is defined.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import nn

_ARCHITECTURES: dict[str, Callable[..., nn.Module]] = {}


def register(name: str, make: Callable[..., nn.Module]) -> None:
    """Let `build` make modules of this name; their `describe()` returns {"name": name, "arguments": {...}}."""
    _ARCHITECTURES[name] = make


def build(description: dict[str, Any]) -> nn.Module:
    """Make the module that a description states, with weights yet to be loaded.

    Raises:
        ValueError: No architecture of that name is known.
    """
    name = description["name"]
    if name not in _ARCHITECTURES:
        raise ValueError(f"Architecture {name!r} is not known; known are {', '.join(sorted(_ARCHITECTURES))}.")
    return _ARCHITECTURES[name](**description["arguments"])
