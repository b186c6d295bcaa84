"""Triangles over a closed loop of vertices, for holes of meshes and for polygons that no plane fits."""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from meshref.check import FLATTEST_FACE, MeshError, place
from meshref.topology import FloatArray, IntArray

# Loops up to this length are filled; the time grows with the cube: 5 s for 590 edges.
LONGEST_FILLED_LOOP = 600


def least_area_triangles(V: FloatArray, loop: IntArray, existing: Container[tuple[int, int]]) -> IntArray:
    """Return triangles over a closed loop of vertices, of least area, with no new vertex and no edge there is already.

    best[i, j] is the cheapest triangulation of the polygon i..j, by splitting off the triangle i, k, j.
    Source: Barequet and Sharir, "Filling gaps in the boundary of a polyhedron", 1995.

    Raises:
        MeshError: The loop is too long, or every way has a flat triangle or an edge that is there.
    """
    n = len(loop)
    if n > LONGEST_FILLED_LOOP:
        raise MeshError(
            f"a hole of {n} edges at {place(V[loop[0]])} is too long to fill (limit {LONGEST_FILLED_LOOP}). Close it "
            "in a mesh editor, or pass closed=False and a lower hole_limit to leave it open."
        )
    P = V[loop]
    squared = ((P[:, None] - P[None]) ** 2).sum(axis=2)
    taken = np.zeros((n, n), dtype=bool)
    for i, v in enumerate(loop.tolist()):
        for j in range(i + 2, n):
            w = int(loop[j])
            taken[i, j] = (min(v, w), max(v, w)) in existing and (i, j) != (0, n - 1)
    best = np.full((n, n), np.inf)
    split = np.zeros((n, n), dtype=np.int64)
    best[np.arange(n - 1), np.arange(1, n)] = 0
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            if taken[i, j]:
                continue
            between = slice(i + 1, j)
            doubled = np.linalg.norm(np.cross(P[between] - P[i], P[j] - P[i]), axis=1)
            longest = np.maximum(squared[i, j], np.maximum(squared[i, between], squared[between, j]))
            # In a flat hole all ways have one area: the second term prefers short edges. Flat triangles never.
            cost = doubled / 2 + 1e-3 * longest + np.where(doubled > FLATTEST_FACE * longest, 0.0, np.inf)
            cost = cost + best[i, between] + best[between, j]
            at = int(np.argmin(cost))
            best[i, j], split[i, j] = cost[at], i + 1 + at
    if not np.isfinite(best[0, n - 1]):
        raise MeshError(
            f"the hole of {n} edges at {place(P[0])} cannot be closed without faces that lie on others. "
            "Close it in a mesh editor."
        )
    triangles: list[list[int]] = []
    stack = [(0, n - 1)]
    while stack:
        i, j = stack.pop()
        if j - i < 2:
            continue
        k = int(split[i, j])
        triangles.append([int(loop[i]), int(loop[k]), int(loop[j])])
        stack += [(i, k), (k, j)]
    return np.array(triangles, dtype=np.int64)
