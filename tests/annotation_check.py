"""Hold arrays to their annotations, "n 3" and kinds of numbers included: the type checker of the tests.

`hold` has Python decorate the functions of the packages as it imports them. The check comes after the call. A function
may refuse what does not fit, in the project's own words, as users meet them; what it may not do is take an array that
its annotation excludes and answer, or answer with another than it says. What is no array mypy checks.

A check takes longer than many a function. So functions without arrays are left alone, those within functions too, and
of each the first CALLS calls of every test are checked (`begin_test`). jaxtyping's own hook wraps all, and made the
tests take half as long again.
"""

from __future__ import annotations

import ast
import functools
import importlib.machinery
import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from types import CodeType, FunctionType, ModuleType
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray, AbstractDtype, jaxtyped

CALLS = 3

_seen: Counter[object] = Counter()


def hold(packages: Sequence[str]) -> None:
    """Have the functions of some packages checked; call it before they are imported."""
    sys.meta_path.insert(0, _Finder(tuple(packages)))


def begin_test() -> None:
    """Check the first calls of each function anew."""
    _seen.clear()


def held(thing: Any) -> Any:
    """Return a function or dataclass with the arrays of its first calls in a test checked; others as they are."""
    if isinstance(thing, type):
        if any(_names_array(str(hint), vars(sys.modules[thing.__module__])) for hint in _own_annotations(thing)):
            thing.__init__ = held_function(thing.__init__)  # type: ignore[misc]
        return thing
    hints = " ".join(str(hint) for hint in thing.__annotations__.values())
    return held_function(thing) if _names_array(hints, thing.__globals__) else thing


def held_function(function: FunctionType) -> Callable[..., Any]:
    """Return the function with its first calls in a test checked; the check is made at the first, for it takes time."""
    with_check: list[Callable[..., Any]] = []

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        if _seen[function] >= CALLS:
            return function(*args, **kwargs)
        _seen[function] += 1
        if not with_check:
            with_check.append(jaxtyped(typechecker=checked)(function))
        return with_check[0](*args, **kwargs)

    return called


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


def _names_array(hints: str, known: dict[str, Any]) -> bool:
    """Return whether annotations, as they are written, name a kind of array or something made of one."""
    things = [known.get(name) for name in set(re.findall(r"\w+", hints))]
    return any((isinstance(thing, type) and issubclass(thing, AbstractDtype)) or _has_array(thing) for thing in things)


def _own_annotations(thing: type) -> list[object]:
    return list(vars(thing).get("__annotations__", {}).values()) if "__dataclass_fields__" in vars(thing) else []


class _Decorated(ast.NodeTransformer):
    """Functions and classes of a module with `held` on them, innermost on functions and outermost on classes."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.decorator_list.append(_decorator(node))
        return node  # those within it are left alone

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.ClassDef:
        node.decorator_list.insert(0, _decorator(node))
        self.generic_visit(node)
        return node


def _decorator(node: ast.AST) -> ast.expr:
    name = ast.Name("__held__", ast.Load())
    return ast.fix_missing_locations(ast.copy_location(name, node))


class _Loader(importlib.machinery.SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        """Return the decorated module, compiled anew, so that no file of other runs is read or written."""
        path = self.get_filename(fullname)
        tree = _Decorated().visit(ast.parse(self.get_data(path), path))
        code: CodeType = compile(tree, path, "exec", dont_inherit=True)
        return code

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["__held__"] = held
        super().exec_module(module)


class _Finder(importlib.machinery.PathFinder):
    def __init__(self, packages: tuple[str, ...]) -> None:
        self._packages = packages

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> Any:  # type: ignore[override]
        if fullname.split(".")[0] not in self._packages:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, importlib.machinery.SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec
