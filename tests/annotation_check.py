"""Hold arrays to their annotations, "n 3" and kinds of numbers included: the type checker of the tests.

tests/conftest.py names it to jaxtyping's import hook, which has it check each function of the packages. The check comes
after the call. A function may refuse what does not fit, in the project's own words, as users meet them; what it may not
do is take an array that its annotation excludes and answer, or answer with another than it says. What is no array mypy
checks.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray


def checked(function: FunctionType) -> Callable[..., object]:
    """Return the function with the annotations of its arrays enforced.

    jaxtyping asks for two checks of each function: one of the arguments, with an empty body, before the call, and one
    of the arguments and the result together, after it. The first is left out.
    """
    if function.__code__.co_code == _does_nothing.__code__.co_code:
        return function
    arrays = {name: hint for name, hint in function.__annotations__.items() if _has_array(hint)}
    if not arrays:
        return function
    function.__annotations__ = {name: arrays.get(name, Any) for name in function.__annotations__}
    return beartype(function)


def _does_nothing() -> None:
    pass


def _has_array(hint: object) -> bool:
    """Return whether there is an array with a shape in an annotation."""
    if isinstance(hint, type) and issubclass(hint, AbstractArray):
        return True
    return any(_has_array(part) for part in get_args(hint))
