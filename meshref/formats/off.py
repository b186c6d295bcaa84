"""The .off of Geomview: counts, then vertices, then polygons."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain

from meshref.formats.polygons import as_mesh
from meshref.formats.text import DamageError, exact, lines_of, numbers
from meshref.topology import FloatArray, IntArray

HEADER = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z_])", re.IGNORECASE)


def read(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices and triangles of a file's content."""
    lines = lines_of(content)
    n, m, lines = _counts(lines)
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    while len(vertices) < n or len(polygons) < m:
        line, words = next(lines, (0, []))
        if not words:
            raise DamageError(f"it ends after {len(vertices)} of {n} vertices and {len(polygons)} of {m} faces")
        if len(vertices) < n:
            vertices.append(_point(words, line))
        else:
            polygons.append(_polygon(words, line, lines))
    return as_mesh(vertices, polygons)


Lines = Iterator[tuple[int, list[str]]]


def _counts(lines: Lines) -> tuple[int, int, Lines]:
    """Return the numbers of vertices and faces, and the lines after them."""
    line, words = next(lines, (1, [""]))
    header = HEADER.match(words[0])
    if header is None:
        raise DamageError(f"it must begin with the word OFF, but begins with {words[0][:20]!r}")
    if header[4] or header[5]:
        raise DamageError(f"it is an {header[0]}, whose vertices do not have three coordinates")
    rest = words[0][header.end() :]  # OFF8 6 12 is found too
    words = [*([rest] if rest else []), *words[1:]]
    if [word.upper() for word in words[:1]] == ["BINARY"]:
        raise DamageError("it is in the binary variant, which few programs read; save it as text")
    while len(words) < 2:
        line, more = next(lines, (line, []))
        if not more:
            raise DamageError("the numbers of vertices and faces are missing")
        words += more
    n, m = (int(i) for i in numbers(words[:2], line, int))
    if len(words) > 2:
        return n, m, lines
    # The number of edges, if it is there at all, may stand in a line of its own.
    first = next(lines, None)
    if first is None or (len(first[1]) == 1 and first[1][0].isdigit()):
        return n, m, lines
    return n, m, chain([first], lines)


def _point(words: list[str], line: int) -> list[float]:
    point = numbers(words[:3], line, float)
    if len(point) < 3:
        raise DamageError(f"line {line} has {len(point)} coordinates instead of 3")
    return point


def _polygon(words: list[str], line: int, lines: Lines) -> list[int]:
    size = int(numbers(words[:1], line, int)[0])
    while size >= 3 and len(words) < 1 + size:  # it goes on in the next line
        line, more = next(lines, (line, []))
        if not more:
            break
        words = words + more
    if size < 3 or len(words) < 1 + size:
        raise DamageError(f"line {line} has a face with {min(size, len(words) - 1)} corners")
    return [int(i) for i in numbers(words[1 : 1 + size], line, int)]


def written(V: FloatArray, F: IntArray) -> bytes:
    """Return the content of a file, whose coordinates come back to the last bit."""
    corners = [f"3 {a} {b} {c}" for a, b, c in F.tolist()]
    return "\n".join(["OFF", f"{len(V)} {len(F)} 0", *exact(V), *corners, ""]).encode()
