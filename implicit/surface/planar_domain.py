"""A triangulation of the inside of a curve f = 0 in the plane: what a planar shape is made of when it bends.

The curve is divided evenly, the inside is filled with a lattice of equilateral triangles as wide, and Delaunay's
triangulation of both is kept where it lies inside. Where a side of the curve is no edge of it, all is done again with
shorter sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from implicit.field.field import Field, SurfaceError
from implicit.surface.extraction import marched_surface
from implicit.surface.projection import newton_to_surface

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Cells along the longest side at which the curve is found.
CELLS = 192

# Least distance of an inner vertex from those of the curve, in sides; fewest vertices of a loop.
CLEAR = 0.6
FEWEST = 12

# Attempts to have every side of the curve as an edge, each with sides shorter by SHORTER.
ATTEMPTS, SHORTER = 4, 0.7


@dataclass(frozen=True, eq=False)
class PlanarDomain:
    """Triangles of the inside of a curve.

    Attributes:
        vertices: Positions (V, 2), those of the curve first.
        triangles: Corners (m, 3), counterclockwise.
        sides: Ends of the segments of the curve (B, 2), the inside on their left; its vertices are the first B.
    """

    vertices: FloatArray
    triangles: IntArray
    sides: IntArray


def planar_domain(field: Field, count: int) -> PlanarDomain:
    """Return the inside of a field's curve with about so many vertices.

    Args:
        field: A field in 2D.
        count: About how many vertices.

    Raises:
        SurfaceError: There is no curve in the bounds, it leaves them, or parts of it are too near each other for sides
            as short as was tried.
    """
    points, segments = (part.cpu().numpy() for part in marched_surface(field.to(torch.float64), CELLS))
    loops = _loops(points.astype(np.float64), segments)
    area = abs(sum(_area(loop) for loop in loops))
    side = float((area / (count * np.sqrt(3) / 2)) ** 0.5)
    for _ in range(ATTEMPTS):
        curve, sides = _divided(field, loops, side)
        vertices = np.concatenate([curve, _lattice(field, curve, side)])
        triangles = Delaunay(vertices).simplices.astype(np.int64)
        middles = vertices[triangles].mean(axis=1)
        triangles = _counterclockwise(vertices, triangles[_inside(field, middles)])
        if _bounded_by(triangles, sides):
            return _without_unused(PlanarDomain(vertices, triangles, sides))
        side *= SHORTER
    raise SurfaceError(
        f"The inside of the curve could not be divided into triangles with sides of {side / SHORTER:.2g}: parts of the "
        "curve are nearer to each other than that. Ask for more points."
    )


def _loops(points: FloatArray, segments: IntArray) -> list[FloatArray]:
    """Return the vertices of each closed curve, in order (n, 2)."""
    following = np.empty(len(points), dtype=np.int64)
    following[segments[:, 0]] = segments[:, 1]
    left, loops = np.ones(len(points), dtype=bool), []
    for first in range(len(points)):
        loop = []
        k = first
        while left[k]:
            left[k] = False
            loop.append(k)
            k = int(following[k])
        if len(loop) > 2:
            loops.append(points[loop])
    return loops


def _area(loop: FloatArray) -> float:
    x, y = loop.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def _divided(field: Field, loops: list[FloatArray], side: float) -> tuple[FloatArray, IntArray]:
    """Return points evenly spaced along the loops, brought onto the curve, and the segments between them."""
    parts, sides, before = [], [], 0
    for loop in loops:
        closed = np.concatenate([loop, loop[:1]])
        way = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
        n = max(FEWEST, round(way[-1] / side))
        at = np.arange(n) / n * way[-1]
        parts.append(np.stack([np.interp(at, way, axis) for axis in closed.T], axis=1))
        number = before + np.arange(n)
        sides.append(np.stack([number, np.roll(number, -1)], axis=1))
        before += n
    start = torch.from_numpy(np.concatenate(parts)).to(field.theta)
    found, arrived = newton_to_surface(field, start, reach=side)
    placed = torch.where(arrived[:, None], found, start)
    return placed.double().cpu().numpy(), np.concatenate(sides)


def _lattice(field: Field, curve: FloatArray, side: float) -> FloatArray:
    """Return the points of a lattice of equilateral triangles that lie inside, clear of the curve."""
    low, high = curve.min(axis=0), curve.max(axis=0)
    rows = np.arange(low[1], high[1], side * np.sqrt(3) / 2)
    columns = np.arange(low[0] - side, high[0] + side, side)
    x = columns[None, :] + np.where(np.arange(len(rows)) % 2, side / 2, 0.0)[:, None]
    points = np.stack([x.ravel(), np.repeat(rows, len(columns))], axis=1)
    clear = cKDTree(curve).query(points)[0] > CLEAR * side
    points = points[clear]
    return points[_inside(field, points)]


def _inside(field: Field, points: FloatArray) -> NDArray[np.bool_]:
    values = field.value(torch.from_numpy(points).to(field.theta))
    return np.asarray((values < 0).cpu().numpy())


def _counterclockwise(vertices: FloatArray, triangles: IntArray) -> IntArray:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    across = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return np.where((across < 0)[:, None], triangles[:, ::-1], triangles)


def _bounded_by(triangles: IntArray, sides: IntArray) -> bool:
    """Return whether the edges that belong to one triangle are just the sides of the curve, in their sense."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    count = int(max(ends.max(initial=0), sides.max())) + 1
    forth, back = ends[:, 0] * count + ends[:, 1], ends[:, 1] * count + ends[:, 0]
    alone = np.sort(forth[~np.isin(forth, back)])
    return np.array_equal(alone, np.sort(sides[:, 0] * count + sides[:, 1]))


def _without_unused(domain: PlanarDomain) -> PlanarDomain:
    """Return the domain without vertices that no triangle has; those of the curve all have one."""
    used = np.zeros(len(domain.vertices), dtype=bool)
    used[domain.triangles] = True
    number = np.cumsum(used) - 1
    return PlanarDomain(domain.vertices[used], number[domain.triangles], domain.sides)
