"""Docstrings as prose: plain text is no markup, names in backticks are code, formulas are set apart."""

import ast
import dataclasses
import inspect
import re
import textwrap
from typing import Any

from sphinx.application import Sphinx

SECTION = re.compile(r"^(Args|Attributes|Returns|Yields|Raises|Source|Note|Notes|Example|Examples):$")


def escaped(line: str) -> str:
    """Return a line of prose as reStructuredText that reads the same: |f| and a * b are no markup there."""
    pieces = re.split(r"(`+[^`]+`+)", line)
    for k, piece in enumerate(pieces):
        if k % 2:
            pieces[k] = f"``{piece.strip('`')}``"
            # A letter that follows at once (`field`s) would make it no code.
            if k + 1 < len(pieces) and re.match(r"\w", pieces[k + 1]):
                pieces[k] += "\\ "
        else:
            piece = re.sub(r"([\\*|])", r"\\\1", piece)
            pieces[k] = re.sub(r"(?<=\w)_(?!\w)", r"\\_", piece)
    return "".join(pieces)


def set_apart(lines: list[str]) -> list[str]:
    """Return the lines with formulas (indented by four and more after an empty line) as literal blocks.

    Below a head such as "Args:" indents mean something else, so that the first one ends the search.
    """
    made: list[str] = []
    literal = in_section = False
    for k, line in enumerate(lines):
        in_section = in_section or bool(SECTION.match(line))
        indented = line.startswith("    ")
        if not in_section and not literal and indented and k > 0 and not lines[k - 1].strip():
            made += ["::", ""]
            literal = True
        elif literal and line.strip() and not indented:
            literal = False
        made.append(line if literal else escaped(line))
    return made


def remarks(thing: type) -> list[str]:
    """Return an Attributes section from the comments behind the fields of a dataclass or named tuple."""
    source = textwrap.dedent(inspect.getsource(thing))
    lines = source.splitlines()
    (tree,) = ast.parse(source).body
    assert isinstance(tree, ast.ClassDef)
    found = []
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            remark = (
                lines[int(node.end_lineno or node.lineno) - 1][int(node.end_col_offset or 0) :]
                .partition("#")[2]
                .strip()
            )
            if remark and not node.target.id.startswith("_"):
                found.append(f"    {node.target.id}: {remark[0].upper()}{remark[1:]}.")
    return ["", "Attributes:", *found] if found else []


def process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the lines of a docstring in place, before its sections are read."""
    has_fields = what == "class" and (dataclasses.is_dataclass(thing) or hasattr(thing, "_fields"))
    if has_fields and "Attributes:" not in lines and "Args:" not in lines:
        lines += remarks(thing)
    lines[:] = set_apart(lines)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register, ahead of napoleon."""
    app.connect("autodoc-process-docstring", process, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
