"""Wavefront .obj: triangles and polygons, by corners counted from 1 or backwards."""

from __future__ import annotations

from typing import Any

import numpy as np

from meshref.formats.polygons import as_mesh
from meshref.formats.text import DamageError, exact, lines_of, numbers
from meshref.topology import FloatArray, IntArray


def read(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices and triangles of a file's content."""
    plain = _read_plain(content)
    if plain is not None:
        return plain
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line, words in lines_of(content, continued="\\"):
        if words[0] == "v":
            point = numbers(words[1:4], line, float)
            if len(point) < 3:
                raise DamageError(f"line {line} has {len(point)} coordinates instead of 3")
            vertices.append(point)
        elif words[0] == "f":
            if len(words) < 4:
                raise DamageError(f"line {line} has a face with {len(words) - 1} corners")
            corners = [int(i) for i in numbers([word.split("/", 1)[0] for word in words[1:]], line, int)]
            # Counted from 1, or backwards from the last vertex so far.
            polygon = [i - 1 if i > 0 else len(vertices) + i for i in corners]
            if 0 in corners or min(polygon) < 0:
                raise DamageError(f"line {line} names vertex {min(corners)}, but they are counted from 1")
            polygons.append(polygon)
    return as_mesh(vertices, polygons)


def _read_plain(content: bytes) -> tuple[FloatArray, IntArray] | None:
    """Return the usual file, triangles counted from 1 with no more at their corners, in a fifth of the time; or None.

    Whatever is out of the ordinary, damage included, is left to the reader that goes line by line.
    """
    lines = content.splitlines()
    arrays: list[Any] = []
    for letter, kind in ((b"v", np.float64), (b"f", np.int64)):
        words = b" ".join([line for line in lines if line.startswith(letter + b" ")]).split()
        if len(words) % 4 or any(word != letter for word in words[::4]) or not words:
            return None
        try:
            arrays.append(np.array(words).reshape(-1, 4)[:, 1:].astype(kind))
        except (ValueError, OverflowError):
            return None
    V, F = arrays
    known = (b"v ", b"f ", b"#", b"vn", b"vt", b"o ", b"g ", b"s ", b"usemtl", b"mtllib")
    if F.min() < 1 or not all(line.startswith(known) for line in lines if line):
        return None
    return V, F - 1


def written(V: FloatArray, F: IntArray) -> bytes:
    """Return the content of a file, whose coordinates come back to the last bit."""
    corners = [f"f {a} {b} {c}" for a, b, c in (F + 1).tolist()]
    return "\n".join([*(f"v {point}" for point in exact(V)), *corners, ""]).encode()
