"""Stereolithography .stl, text or binary: the corners of every face, in single precision."""

from __future__ import annotations

import numpy as np

from meshref.check import MeshError, place
from meshref.formats.polygons import triangulated
from meshref.formats.text import DamageError, lines_of, numbers
from meshref.measures import doubled_area_vectors, unit_or_zero
from meshref.topology import FloatArray, IntArray

ROW = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices, one for all equal corners, and triangles of a file's content."""
    count = int.from_bytes(content[80:84], "little")
    # The length decides: binary files beginning with the word "solid" are common.
    if len(content) >= 84 and len(content) == 84 + count * ROW.itemsize:
        corners = np.frombuffer(content, ROW, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    elif content.lstrip()[:5].lower() == b"solid":
        return merge_equal(*_facets(content))
    else:
        raise DamageError(
            f"it has {len(content)} bytes, which fits neither text nor binary, as if it had been cut short"
        )
    return merge_equal(corners, np.arange(len(corners)).reshape(-1, 3))


def _facets(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return the corners of the facets of a text, and triangles; a facet may have more than three corners."""
    points: list[list[float]] = []
    ends: list[int] = []  # of the facets, in points
    for line, words in lines_of(content):
        word = words[0].lower()
        if word == "vertex":
            points.append(numbers(words[1:4], line, float))
            if len(points[-1]) < 3:
                raise DamageError(f"line {line} has {len(points[-1])} coordinates instead of 3")
        elif word in ("endloop", "endfacet") and len(points) > (ends[-1] if ends else 0):
            ends.append(len(points))
            if ends[-1] - ([0, *ends][-2]) < 3:
                raise DamageError(f"line {line} ends a facet with less than 3 corners")
    if len(points) != (ends[-1] if ends else 0):
        raise DamageError(
            f"it has {len(points)} corners, and the last ones make no whole facet, as if it had been cut short"
        )
    V = np.array(points, dtype=np.float64).reshape(-1, 3)
    return V, triangulated(V, [list(range(*span)) for span in zip([0, *ends], ends)])


def merge_equal(V: FloatArray, F: IntArray) -> tuple[FloatArray, IntArray]:
    """Return one vertex for all that have equal coordinates, in the order of their first appearance."""
    if len(V) == 0:
        return V, F
    _, first, of_vertex = np.unique(V + 0.0, axis=0, return_index=True, return_inverse=True)  # -0 becomes 0
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return V[first[order]], rank[of_vertex.reshape(-1)][F].astype(np.int64)


def written(V: FloatArray, F: IntArray) -> bytes:
    """Return the content of a binary file."""
    largest = np.abs(V).max()
    if largest > np.finfo(np.float32).max:
        far = V[np.abs(V).max(axis=1).argmax()]
        raise MeshError(f"the point {place(far)} is too far away for the single precision of .stl. Write .ply instead.")
    rows = np.zeros(len(F), dtype=ROW)
    rows["corners"] = V[F]
    rows["normal"] = unit_or_zero(doubled_area_vectors(V, F))
    return b"written by meshref".ljust(80) + len(F).to_bytes(4, "little") + rows.tobytes()
