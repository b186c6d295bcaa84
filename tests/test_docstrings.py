"""Docstrings say first what a thing is or does, and every public name has one."""

import ast
import importlib
import inspect
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("implicit", "meshref", "compare")
FILES = sorted(str(file.relative_to(ROOT)) for package in PACKAGES for file in (ROOT / package).rglob("*.py"))

# Words that begin a clause: what follows them is neither what a thing is nor what it does.
CLAUSES = {"What", "Where", "How", "Whether", "When", "Of", "As", "Which", "Why"}

# Modules whose __all__ a user imports from.
MODULES = (*PACKAGES, "implicit.shapes", "implicit.models", "implicit.families")


def docstrings(source):
    """Yield the line, the name and the docstring of the module, its classes and its functions, where there is one."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield node.body[0].lineno, getattr(node, "name", "module"), text


def faults(source):
    """Return a line for each docstring that begins with a clause."""
    found = []
    for line, name, text in docstrings(source):
        first = text.split("\n\n")[0]
        if first.split()[0].strip(",:;.") in CLAUSES:
            found.append(f"{line}: {name} begins with a clause: {first[:60]}")
    return found


def public_names():
    """Yield each module of MODULES with a public name in it."""
    for module in MODULES:
        for name in importlib.import_module(module).__all__:
            yield module, name


def own_docstring(thing):
    """Return the docstring that someone wrote for a class or function, but not the signature that dataclasses make."""
    text = thing.__dict__.get("__doc__") if inspect.isclass(thing) else thing.__doc__
    return "" if text is None or text.startswith(f"{thing.__name__}(") else inspect.cleandoc(text)


def lacks(thing):
    """Return what the docstring of a public class or function lacks, or None."""
    text = own_docstring(thing)
    if not text:
        return "a docstring"
    if text.split()[0].strip(",:;.") in CLAUSES:
        return f"a subject and a verb: {text[:60]}"
    first = text.split("\n\n")[0].rstrip()
    if not first.endswith((".", ":", "]", ")")):
        return f"a sentence at its head: {first[-60:]}"
    if not inspect.isfunction(thing) or "Args:" in text or "arguments as for" in text.lower():
        return None
    # Two arguments that their types explain fit into one line; more need words of their own.
    unexplained = [
        name
        for name, parameter in inspect.signature(thing).parameters.items()
        if name not in text and parameter.kind is not inspect.Parameter.VAR_POSITIONAL
    ]
    return f"Args for {', '.join(unexplained)}" if len(unexplained) > 2 else None


@pytest.mark.parametrize("file", FILES)
def test_docstrings_begin_with_what_a_thing_is_or_does(file):
    assert not faults((ROOT / file).read_text())


@pytest.mark.parametrize(("module", "name"), list(public_names()))
def test_every_public_class_and_function_says_what_it_is_for(module, name):
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing) or inspect.isroutine(thing):
        assert lacks(thing) is None, f"{module}.{name} lacks {lacks(thing)}"


def test_the_check_finds_clauses_and_only_those():
    assert faults('"""Of which unknowns they are."""') == [
        "1: module begins with a clause: Of which unknowns they are."
    ]
    assert faults('def f():\n    """What: a number."""')
    assert faults('class A:\n    """How\n    it goes."""')
    assert not faults('"""Wherever f < 0 lies inside."""\n\ndef f():\n    """Return what it is."""')


def test_the_check_finds_public_names_without_meaning():
    def unexplained(radius, center, scale):
        """Return a number."""

    def explained(radius, center, scale):
        """Return scale (|x - center| - radius)."""

    def silent():
        pass

    assert lacks(unexplained) == "Args for radius, center, scale"
    assert lacks(explained) is None
    assert lacks(silent) == "a docstring"
