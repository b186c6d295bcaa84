"""A function of the user's own code, by the name that the user gives it in a call or on the command line.

    my_nets.py:make            the function make of the file my_nets.py
    package.module:function    the function of an installed module

Importing runs the code. So the name must come from the user, never out of a file that may be from elsewhere.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from torch import nn

FORMS = '"my_nets.py:make" (a file and a function in it) or "package.module:function"'


def named_function(name: str) -> Callable[..., Any]:
    """Return the function of a name, importing the code that defines it.

    Args:
        name: "my_nets.py:make" or "package.module:function".

    Raises:
        ValueError: The name has another form, there is no such file or module, or it holds no such function; or
            importing it failed.
    """
    place, function = split_name(name)
    code = _of_file(Path(place), name) if place.endswith(".py") else _of_package(place, name)
    found: Any = code
    for part in function.split("."):
        found = getattr(found, part, None)
    if not callable(found):
        defined = [key for key, value in vars(code).items() if callable(value) and not key.startswith("_")]
        raise ValueError(
            f"{name}: {place} defines no function {function}. It defines {', '.join(sorted(defined)) or 'none'}."
        )
    return found


def split_name(name: str) -> tuple[str, str]:
    """Return the place of the code and the name of the function in it, with nothing imported.

    Raises:
        TypeError: The name is no text.
        ValueError: It has another form.
    """
    if not isinstance(name, str):
        raise TypeError(f"The name of a function must be {FORMS}, but is {name!r}.")
    place, colon, function = name.rpartition(":")
    dotted = place.endswith(".py") or (place != "" and all(part.isidentifier() for part in place.split(".")))
    if not colon or not dotted or not all(part.isidentifier() for part in function.split(".")):
        raise ValueError(f"The name of a function must be {FORMS}, but is {name!r}.")
    return place, function


def build_module(make: Callable[..., Any], arguments: Mapping[str, Any]) -> nn.Module:
    """Return the module that a function builds from keyword arguments.

    Raises:
        ValueError: The function fails, or returns no torch module.
    """
    name = getattr(make, "__qualname__", repr(make))
    try:
        module = make(**arguments)
    except Exception as error:
        raise ValueError(
            f"{name} could not build a module from the arguments {dict(arguments)}: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(module, nn.Module):
        raise ValueError(f"{name} must return a torch module, but returned a {type(module).__name__}.")
    return module


def _of_file(path: Path, name: str) -> ModuleType:
    if not path.is_file():
        raise ValueError(f"{name}: there is no file {path}. Name it as seen from the current folder, or in full.")
    # One module a file and content, whatever path it is reached by: its classes stay the same until it is changed.
    own = "implicit_named_" + hashlib.sha256(str(path.resolve()).encode() + path.read_bytes()).hexdigest()[:16]
    if own in sys.modules:
        return sys.modules[own]
    spec = importlib.util.spec_from_file_location(own, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{name}: {path} cannot be read as Python.")
    code = importlib.util.module_from_spec(spec)
    sys.modules[own] = code  # as import does: dataclasses look themselves up there
    try:
        spec.loader.exec_module(code)
    except Exception as error:
        del sys.modules[own]
        raise ValueError(f"{name}: {path} could not be run: {type(error).__name__}: {error}") from error
    return code


def _of_package(place: str, name: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"{name}: there is no module {error.name} to import. Install it, or name its file: {FORMS}."
        ) from error
    except Exception as error:
        raise ValueError(f"{name}: {place} could not be imported: {type(error).__name__}: {error}") from error
