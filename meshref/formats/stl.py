"""Stereolithography .stl, text or binary: the corners of every face, in single precision."""

from __future__ import annotations

import numpy as np

from meshref.check import MeshError, place
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
        points = [numbers(words[1:4], line, float) for line, words in lines_of(content) if words[0].lower() == "vertex"]
        if any(len(p) != 3 for p in points) or len(points) % 3:
            raise DamageError(f"it has {len(points)} corners, which make no whole triangles. Was it cut short")
        corners = np.array(points, dtype=np.float64).reshape(-1, 3)
    else:
        raise DamageError(f"it has {len(content)} bytes, which fits neither text nor binary. Was it cut short")
    if len(corners) == 0:
        return corners, np.zeros((0, 3), dtype=np.int64)
    return merge_equal(corners, np.arange(len(corners)).reshape(-1, 3))


def merge_equal(V: FloatArray, F: IntArray) -> tuple[FloatArray, IntArray]:
    """Return one vertex for all that have equal coordinates, in the order of their first appearance."""
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
