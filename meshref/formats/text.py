"""Parts that the readers share: words of a text by lines, numbers among them, and polygons as triangles."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from meshref.topology import FloatArray, IntArray


class DamageError(Exception):
    """A fault inside a file; read_mesh adds the name of the file."""


def lines_of(content: bytes) -> Iterator[tuple[int, list[str]]]:
    """Yield the words of each line that has any, with its number; what follows a # is left out."""
    for number, line in enumerate(content.decode("latin-1").splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if words:
            yield number, words


def numbers(words: list[str], line: int, kind: Callable[[str], float]) -> list[float]:
    """Return words of a line as numbers."""
    try:
        return [kind(word) for word in words]
    except ValueError:
        raise DamageError(f"line {line} has {' '.join(words)[:40]!r} where numbers should be") from None


def as_mesh(vertices: list[list[float]], polygons: list[list[int]]) -> tuple[FloatArray, IntArray]:
    """Return arrays of vertices and of polygons, each split into a fan of triangles."""
    V = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    try:
        return V, np.array(fans, dtype=np.int64).reshape(-1, 3)
    except OverflowError:
        raise DamageError("a face names a vertex whose number has more than 18 digits") from None


def exact(V: FloatArray) -> list[str]:
    """Return a line for each vertex; repr is the shortest text that comes back to the last bit."""
    return [" ".join(map(repr, point)) for point in V.tolist()]
