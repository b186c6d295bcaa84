"""Architectures that can be saved by name: each states itself in `describe()` and is made again by `build`.

The registry knows none of them: each registers itself where it is defined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from torch import nn

from implicit.arguments import require_callable

_ARCHITECTURES: dict[str, Callable[..., nn.Module]] = {}


def register(name: str, make: Callable[..., nn.Module]) -> None:
    """Let `build` make modules of this name; their `describe()` returns {"name": name, "arguments": {...}}.

    Raises:
        TypeError: The name is no text, or what makes the modules cannot be called.
    """
    if not isinstance(name, str) or not name:
        raise TypeError(f"name must be the name of an architecture, but is {name!r}.")
    require_callable("make", make, "a class or function that returns a torch module")
    _ARCHITECTURES[name] = make


def is_registered(name: object) -> bool:
    """Return whether `build` makes modules of this name."""
    return isinstance(name, str) and name in _ARCHITECTURES


def build(description: Mapping[str, Any]) -> nn.Module:
    """Make the module that a description states, with weights yet to be loaded.

    Raises:
        ValueError: No architecture of that name is known.
    """
    name = description["name"]
    if not is_registered(name):
        raise ValueError(f"Architecture {name!r} is not known; known are {', '.join(sorted(_ARCHITECTURES))}.")
    return _ARCHITECTURES[name](**description["arguments"])
