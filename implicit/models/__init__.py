"""Architectures that can be saved by name: each states itself in `describe()` and is made again by `build`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import nn

from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet, ImNetEncoder
from implicit.models.mlp import Mlp
from implicit.models.siren import Siren

__all__ = ["DeepSdf", "DualSdf", "ImNet", "ImNetEncoder", "Mlp", "Siren", "build", "register"]

_ARCHITECTURES: dict[str, Callable[..., nn.Module]] = {}


def register(name: str, make: Callable[..., nn.Module]) -> None:
    """Let `build` make modules of this name; their `describe()` returns {"name": name, "arguments": {...}}."""
    _ARCHITECTURES[name] = make


def build(description: dict[str, Any]) -> nn.Module:
    """The module that a description states, with weights yet to be loaded.

    Raises:
        ValueError: No architecture of that name is known.
    """
    import implicit.shapes  # noqa: F401  registers the analytic shapes

    name = description["name"]
    if name not in _ARCHITECTURES:
        raise ValueError(f"Architecture {name!r} is not known; known are {', '.join(sorted(_ARCHITECTURES))}.")
    return _ARCHITECTURES[name](**description["arguments"])


register("deepsdf", DeepSdf)
register("dualsdf", DualSdf)
register("imnet", ImNet)
register("siren", Siren)
register("mlp", Mlp)
