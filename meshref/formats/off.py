"""The .off of Geomview: counts, then vertices, then polygons."""

from __future__ import annotations

from collections.abc import Iterator

from meshref.formats.text import DamageError, as_mesh, exact, lines_of, numbers
from meshref.topology import FloatArray, IntArray


def read(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices and triangles of a file's content."""
    lines = lines_of(content)
    n, m = _counts(lines)
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line, words in lines:
        if len(vertices) < n:
            vertices.append(_point(words, line))
        elif len(polygons) < m:
            polygons.append(_polygon(words, line))
        else:
            break
    if len(vertices) < n or len(polygons) < m:
        raise DamageError(f"it ends after {len(vertices)} of {n} vertices and {len(polygons)} of {m} faces")
    return as_mesh(vertices, polygons)


def _counts(lines: Iterator[tuple[int, list[str]]]) -> tuple[int, int]:
    line, words = next(lines, (1, [""]))
    if words[0] not in ("OFF", "COFF", "NOFF", "CNOFF", "STOFF"):
        raise DamageError(f"it must begin with the word OFF, but begins with {words[0][:20]!r}")
    words = words[1:]
    if words[:1] == ["BINARY"]:
        raise DamageError("it is in the binary variant, which few programs read; save it as text")
    if not words:
        line, words = next(lines, (line, []))
    if len(words) < 2:
        raise DamageError("the numbers of vertices and faces are missing")
    n, m = (int(i) for i in numbers(words[:2], line, int))
    return n, m


def _point(words: list[str], line: int) -> list[float]:
    point = numbers(words[:3], line, float)
    if len(point) < 3:
        raise DamageError(f"line {line} has {len(point)} coordinates instead of 3")
    return point


def _polygon(words: list[str], line: int) -> list[int]:
    size = int(numbers(words[:1], line, int)[0])
    if size < 3 or len(words) < 1 + size:
        raise DamageError(f"line {line} has a face with {min(size, len(words) - 1)} corners")
    return [int(i) for i in numbers(words[1 : 1 + size], line, int)]


def written(V: FloatArray, F: IntArray) -> bytes:
    """Return the content of a file, whose coordinates come back to the last bit."""
    corners = [f"3 {a} {b} {c}" for a, b, c in F.tolist()]
    return "\n".join(["OFF", f"{len(V)} {len(F)} 0", *exact(V), *corners, ""]).encode()
