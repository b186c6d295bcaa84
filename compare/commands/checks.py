"""Refusals before any work, common to several commands: outputs that cannot or must not be written over."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

from compare.errors import InputError


def require_lists(command: Any, arguments: Sequence[str]) -> None:
    """Refuse an option that takes several words and was given none."""
    for field in dataclasses.fields(command):
        option = f"--{field.name.replace('_', '-')}"
        if getattr(command, field.name) == () and (option in arguments or field.default):
            choices = get_args(get_args(get_type_hints(type(command))[field.name])[0])
            wanted = f"one or more of {', '.join(choices)}" if choices else "one or more after it"
            raise InputError(f"{option} names nothing. Name {wanted}, or leave {option} out.")


def require_new_safetensors(what: str, path: Path) -> None:
    """Refuse a file of another kind, one that is there already, or one in a folder where none can be written."""
    if path.suffix != ".safetensors":
        raise InputError(f"{what} is written to a file ending in .safetensors, but the output is {path}.")
    if path.exists():
        raise InputError(f"{path} is there already and is not written over. Name another file or remove it.")
    require_folder_for(path)


def absolute_name(module: str | None) -> str | None:
    """Return the name of a function with the path of its file in full, for workers that start from other folders."""
    if module is None or ".py:" not in module:
        return module
    place, _, function = module.rpartition(":")
    return f"{Path(place).absolute()}:{function}"


def require_seed(seed: int) -> None:
    """Refuse a number that random choices cannot begin with."""
    if seed < 0:
        raise InputError(f"--seed must be at least 0, but is {seed}.")


def require_hole_limit(diagonals: float) -> None:
    """Refuse a length of holes that is none."""
    if not diagonals >= 0:
        raise InputError(f"--hole-limit must be a number of diagonals, at least 0, but is {diagonals}.")


def require_budget(seconds: float | None) -> None:
    """Refuse a time in which nothing can be done."""
    if seconds is not None and not 0 < seconds < float("inf"):
        raise InputError(f"--budget must be a number of seconds above 0, but is {seconds}.")


def require_folder_for(path: Path) -> None:
    """Refuse a path unless the nearest folder above that exists is one, and writable."""
    above = path.absolute().parent
    while not above.exists():
        above = above.parent
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise InputError(f"{path} cannot be written: {above} is not a folder that you may write to. Name another.")
