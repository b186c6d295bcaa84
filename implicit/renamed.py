"""Options under their former names: taken for one version, with a warning that names the new one."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, ParamSpec, TypeVar, no_type_check

P = ParamSpec("P")
R = TypeVar("R")


def renamed(**names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that lets a function be called with the former names of some options.

    Args:
        names: The new name of each option under its former name.

    Returns:
        The decorator. The function warns of a former name with a DeprecationWarning, and refuses an option that is
        given under both names with a TypeError.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @no_type_check  # so that no check stands between the caller and the warning that names its line
        @wraps(function)
        def call(*args: P.args, **options: P.kwargs) -> R:
            current = current_names(call, options)
            for old in [name for name in names if name in options]:
                warnings.warn(
                    f"{function.__name__}({old}=...) is now {function.__name__}({names[old]}=...). The former name "
                    "goes with the next version.",
                    DeprecationWarning,
                    stacklevel=2,
                )
            return function(*args, **current)  # type: ignore[arg-type]

        setattr(call, _NAMES, names)
        return call

    return decorate


def former_names(function: Callable[..., Any]) -> Mapping[str, str]:
    """Return the new name of each option that a function still takes under a former one."""
    return getattr(function, _NAMES, {})


def current_names(function: Callable[..., Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of a function, as a file of before may name them, under their names of today.

    Raises:
        TypeError: An option is there under both names.
    """
    names = former_names(function)
    for old, new in names.items():
        if old in options and new in options:
            raise TypeError(f"{old} is the former name of {new}, but both are given. Leave {old} out.")
    return {names.get(name, name): value for name, value in options.items()}


_NAMES = "__former_names__"
