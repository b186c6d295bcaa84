"""Polygons of files as triangles, whatever their form: convex, concave, twisted, or with corners on a line.

| polygon | triangles |
|---|---|
| convex, seen along its normal | a fan from its first corner |
| any other | ear clipping of its projection (manifold3d), if that gives back its area |
| one whose projection crosses itself, or whose diagonals are edges already | of least area, without those diagonals |

A diagonal that is an edge of the mesh already would have four faces: neighbours that share three corners ask for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Sequence

import manifold3d
import numpy as np

from meshref.check import MeshError, place
from meshref.filling import LONGEST_FILLED_LOOP, least_area_triangles
from meshref.formats.text import DamageError
from meshref.topology import BoolArray, FloatArray, IntArray

# A turn is straight below this sine; a triangulation has the area of its polygon to this.
STRAIGHT = 1e-9
SAME_AREA = 1e-9


def as_mesh(vertices: list[list[float]], polygons: list[list[int]]) -> tuple[FloatArray, IntArray]:
    """Return arrays of vertices and of triangles over polygons."""
    V = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    try:
        return V, triangulated(V, polygons)
    except OverflowError:
        raise DamageError("a face names a vertex whose number has more than 18 digits") from None


def triangulated(V: FloatArray, polygons: Sequence[Sequence[int]] | IntArray) -> IntArray:
    """Return triangles (m, 3) over polygons, in their order and with their direction.

    Args:
        V: Vertices, (n, 3).
        polygons: The corners of each, all of one length as an array (k, c) or of several as lists.
    """
    sizes, of_size = _by_size(polygons)
    if all(size < 4 for size in of_size):
        return of_size[3][1] if 3 in of_size else np.zeros((0, 3), dtype=np.int64)
    every = [corners for _, corners in of_size.values()]
    if any(corners.size and (corners.min() < 0 or corners.max() >= len(V)) for corners in every):
        return _in_order(sizes, {size: _fans(corners) for size, (_, corners) in of_size.items()}, of_size)
    triangles = {}
    for size, (_, corners) in of_size.items():
        triangles[size] = _fans(corners)
        for i in np.flatnonzero(~_convex(V, corners)).tolist():
            triangles[size][i] = _clipped(V, corners[i])
    _avoid_edges(V, of_size, triangles)
    return _in_order(sizes, triangles, of_size)


OfSize = dict[int, tuple[IntArray, IntArray]]  # for each number of corners, which polygons have it, and their corners


def _by_size(polygons: Sequence[Sequence[int]] | IntArray) -> tuple[int, OfSize]:
    if isinstance(polygons, np.ndarray):
        corners = polygons.astype(np.int64)
        return len(corners), {corners.shape[1]: (np.arange(len(corners)), corners)} if corners.shape[1] > 2 else {}
    sizes = np.fromiter(map(len, polygons), dtype=np.int64, count=len(polygons))
    found: OfSize = {}
    for size in np.unique(sizes[sizes > 2]).tolist():
        which = np.flatnonzero(sizes == size)
        found[size] = which, np.array([polygons[i] for i in which.tolist()], dtype=np.int64)
    return len(polygons), found


def _in_order(count: int, triangles: dict[int, IntArray], of_size: OfSize) -> IntArray:
    """Return all triangles (m, 3) in the order of their polygons."""
    rows = np.concatenate([t.reshape(-1, 3) for t in triangles.values()])
    owner = np.concatenate([np.repeat(of_size[size][0], size - 2) for size in triangles])
    return rows[np.argsort(owner, kind="stable")]


def _fans(corners: IntArray) -> IntArray:
    """Return the triangles (k, c - 2, 3) of fans from the first corners of polygons (k, c)."""
    return np.stack([corners[:, [0, i, i + 1]] for i in range(1, corners.shape[1] - 1)], axis=1)


def _convex(V: FloatArray, corners: IntArray) -> BoolArray:
    """Return which polygons (k, c) turn the same way at every corner and once round; triangles always do."""
    if corners.shape[1] == 3:
        return np.ones(len(corners), dtype=np.bool_)
    # From the first corner: far from the origin, products of coordinates would have lost all digits.
    points = V[corners] - V[corners[:, :1]]
    normal = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)
    length = np.linalg.norm(normal, axis=1)
    with np.errstate(all="ignore"):
        normal /= length[:, None]
        sides = np.roll(points, -1, axis=1) - points
        sides /= np.linalg.norm(sides, axis=2, keepdims=True)
        turns = (np.cross(np.roll(sides, 1, axis=1), sides) * normal[:, None]).sum(axis=2)
        doubled = (np.cross(points[:, 1:-1], points[:, 2:]) * normal[:, None]).sum(axis=2)
        convex = (turns > STRAIGHT).all(axis=1) & (doubled > STRAIGHT * length[:, None]).all(axis=1)
    return np.asarray(convex | ~np.isfinite(points).all(axis=(1, 2)))


def _clipped(V: FloatArray, polygon: IntArray) -> IntArray:
    """Return triangles (c - 2, 3) of a polygon that is not convex; corners that repeat the last one make flat ones."""
    again = polygon == np.roll(polygon, 1)
    repeats = np.stack([polygon[again], polygon[again], np.roll(polygon, -1)[again]], axis=1)
    polygon = polygon[~again]
    if len(polygon) < 4:
        return np.concatenate([_fans(polygon[None])[0] if len(polygon) == 3 else repeats[: 2 - len(polygon)], repeats])
    points = V[polygon] - V[polygon[0]]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    along = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, along, axis=1)  # of the coordinates themselves, so that nothing is rounded
    if (normal[along] < 0) != (along == 1):
        flat = flat[:, ::-1]  # counterclockwise
    if normal[along] == 0:
        return np.concatenate([_fans(polygon[None])[0], repeats])  # all on a line: flat, whatever is taken
    triangles = np.asarray(manifold3d.triangulate([np.ascontiguousarray(flat)], allow_convex=False), dtype=np.int64)
    if len(triangles) == len(polygon) - 2 and np.array_equal(np.unique(triangles), np.arange(len(polygon))):
        a, b, c = flat[triangles].transpose(1, 0, 2)
        doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        if np.abs(doubled).sum() <= (1 + SAME_AREA) * np.abs(normal[along]):
            return np.concatenate([polygon[triangles], repeats])
    if len(np.unique(polygon)) < len(polygon) or len(polygon) > LONGEST_FILLED_LOOP:
        raise DamageError(
            f"its polygon of {len(polygon)} corners at {place(V[polygon[0]])} crosses itself, and how it is meant to "
            "be filled cannot be told"
        )
    return np.concatenate([_least_area(V, polygon, set()), repeats])


def _least_area(V: FloatArray, polygon: IntArray, existing: Container[tuple[int, int]]) -> IntArray:
    try:
        return least_area_triangles(V, polygon, existing)
    except MeshError:  # every way has a flat triangle or an edge that is there: mending removes or refuses these
        return _fans(polygon[None])[0]


def _avoid_edges(V: FloatArray, of_size: OfSize, triangles: dict[int, IntArray]) -> None:
    """Triangulate anew polygons one of whose diagonals is also an edge or a diagonal of another polygon."""
    n = len(V)
    keys = {size: _edge_keys(t, n) for size, t in triangles.items()}
    edges, number = np.unique(np.concatenate([k.ravel() for k in keys.values()]), return_inverse=True)
    crowded = edges[np.bincount(number.reshape(-1)) > 2]
    if not crowded.size:
        return
    first = {size: _first_alike(corners) for size, (_, corners) in of_size.items()}
    alone = {size: same == np.arange(len(same)) for size, same in first.items()}
    count: Counter[tuple[int, int]] = Counter()
    for size, every in keys.items():
        k = every[alone[size]].ravel()
        count.update(zip((k // n).tolist(), (k % n).tolist()))
    for size, (_, corners) in of_size.items():
        if size == 3:
            continue
        for i in np.flatnonzero(np.isin(keys[size], crowded).any(axis=1) & alone[size]).tolist():
            own = _diagonals(triangles[size][i], corners[i])
            count.subtract(dict.fromkeys(own, 2))  # each lies in two triangles of the polygon
            if any(count[edge] > 0 for edge in own):
                triangles[size][i] = _least_area(V, corners[i], {edge for edge in count if count[edge] > 0})
            count.update(dict.fromkeys(_diagonals(triangles[size][i], corners[i]), 2))
        for i in np.flatnonzero(~alone[size]).tolist():  # a doubled polygon has the triangles of its first
            j = int(first[size][i])
            turned = corners[i][(np.flatnonzero(corners[i] == corners[j][0])[0] + 1) % size] != corners[j][1]
            triangles[size][i] = triangles[size][j][:, ::-1] if turned else triangles[size][j]


def _first_alike(corners: IntArray) -> IntArray:
    """Return for each of the polygons (k, c) the first one that goes round the same corners, either way, (k,)."""
    c = corners.shape[1]
    start = (np.argmin(corners, axis=1)[:, None] + np.arange(c)) % c
    forth = np.take_along_axis(corners, start, axis=1)
    back = np.concatenate([forth[:, :1], forth[:, :0:-1]], axis=1)
    least = np.where((forth[:, 1] <= forth[:, -1])[:, None], forth, back)
    _, first, of = np.unique(least, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[of.reshape(-1)], dtype=np.int64)


def _edge_keys(triangles: IntArray, n: int) -> IntArray:
    """Return a number for each edge of the triangles (k, c, 3) of polygons, (k, 3 c)."""
    ends = np.stack([triangles, np.roll(triangles, -1, axis=2)], axis=3)
    return np.asarray((ends.min(axis=3) * n + ends.max(axis=3)).reshape(len(triangles), -1))


def _diagonals(triangles: IntArray, polygon: IntArray) -> set[tuple[int, int]]:
    def edges(corners: IntArray) -> set[tuple[int, int]]:
        return set(map(tuple, np.sort(_sides(corners), axis=1).tolist()))

    return {edge for t in triangles for edge in edges(t)} - edges(polygon)


def _sides(corners: IntArray) -> IntArray:
    return np.stack([corners, np.roll(corners, -1)], axis=1)
