"""Triangulated shapes with known answers, for tests, benchmarks and examples: closed, oriented outwards."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError, finite_points, require_positive, require_whole
from meshref.topology import FloatArray, IntArray, edge_table

# Each makes four faces of one; with ten an icosphere has twenty million.
MOST_SUBDIVISIONS = 10


def icosphere(
    subdivisions: int, radius: float = 1.0, center: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[FloatArray, IntArray]:
    """Return a sphere with 20 * 4**subdivisions faces: an icosahedron, split in four and pushed out again and again.

    Args:
        subdivisions: 0 is the icosahedron; 2, 3, 4 give 320, 1280, 5120 faces.
        radius: Distance of every vertex from the centre.
        center: The centre, (3,).
    """
    require_whole("subdivisions", subdivisions, 0, MOST_SUBDIVISIONS)
    require_positive("radius", radius, "length")
    middle = _place("center", center)
    golden = (1 + 5**0.5) / 2
    V = np.array([
        [-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0], [0, -1, golden], [0, 1, golden],
        [0, -1, -golden], [0, 1, -golden], [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1],
    ])  # fmt: skip
    F = np.array([
        [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6],
        [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7],
        [9, 8, 1],
    ], dtype=np.int64)  # fmt: skip
    V /= np.linalg.norm(V, axis=1, keepdims=True)
    for _ in range(subdivisions):
        V, F = split_in_four(V, F)
        V /= np.linalg.norm(V, axis=1, keepdims=True)
    return radius * V + middle, F


def torus(
    around: int, across: int, major_radius: float = 1.0, minor_radius: float = 0.35
) -> tuple[FloatArray, IntArray]:
    """Return a ring about the z axis: 2 * around * across faces, genus 1.

    Args:
        around: Points along the ring.
        across: Points round the tube.
        major_radius: Distance of the middle of the tube from the axis.
        minor_radius: Radius of the tube.
    """
    require_whole("around", around, 3)
    require_whole("across", across, 3)
    require_positive("major_radius", major_radius, "length")
    require_positive("minor_radius", minor_radius, "length")
    u, v = np.meshgrid(2 * np.pi * np.arange(around) / around, 2 * np.pi * np.arange(across) / across, indexing="ij")
    ring = major_radius + minor_radius * np.cos(v)
    V = np.stack([ring * np.cos(u), ring * np.sin(u), minor_radius * np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    here, there = i * across, (i + 1) % around * across
    k = (j + 1) % across
    return V, _quads(here + j, there + j, there + k, here + k)


def box(
    lower: ArrayLike = (0.0, 0.0, 0.0), upper: ArrayLike = (1.0, 1.0, 1.0), subdivisions: int = 0
) -> tuple[FloatArray, IntArray]:
    """Return an axis-parallel box with 12 * 4**subdivisions faces.

    Args:
        lower: The corner with the smallest coordinates, (3,).
        upper: The opposite corner, (3,).
        subdivisions: How often each triangle is split in four.
    """
    require_whole("subdivisions", subdivisions, 0, MOST_SUBDIVISIONS)
    lower, upper = _place("lower", lower), _place("upper", upper)
    if not (lower < upper).all():
        raise MeshError(f"upper must be above lower in each coordinate, but they are {upper} and {lower}.")
    V = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (upper - lower) + lower
    F = np.array([
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
        [1, 5, 7], [1, 7, 3],
    ], dtype=np.int64)  # fmt: skip
    for _ in range(subdivisions):
        V, F = split_in_four(V, F)
    return V, F


def cylinder(around: int, along: int, radius: float = 1.0, height: float = 2.0) -> tuple[FloatArray, IntArray]:
    """Return a solid cylinder about the z axis, its middle at the origin, with flat caps of one fan each.

    Args:
        around: Points on each ring.
        along: Strips of faces from bottom to top.
        radius: Radius of the rings.
        height: Distance from cap to cap.
    """
    require_whole("around", around, 3)
    require_whole("along", along)
    require_positive("radius", radius, "length")
    require_positive("height", height, "length")
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    levels = np.linspace(-height / 2, height / 2, along + 1)
    rings = [np.column_stack([circle, np.full(around, z)]) for z in levels]
    V = np.concatenate([*rings, [[0, 0, -height / 2], [0, 0, height / 2]]])
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    k = (i + 1) % around
    side = _quads(j * around + i, j * around + k, (j + 1) * around + k, (j + 1) * around + i)
    i, k = i[:, 0], k[:, 0]
    bottom, top, last = len(V) - 2, len(V) - 1, along * around
    caps = [np.column_stack([np.full(around, bottom), k, i])]
    caps += [np.column_stack([np.full(around, top), last + i, last + k])]
    return V, np.concatenate([side, *caps]).astype(np.int64)


def split_in_four(V: FloatArray, F: IntArray) -> tuple[FloatArray, IntArray]:
    """Return every triangle split in four at the middles of its sides; the surface stays where it is."""
    table = edge_table(F, len(V))
    a, b, c = (len(V) + table.of_half_edge.reshape(-1, 3)).T  # middles of the sides 01, 12, 20
    i, j, k = F.T
    faces = np.concatenate([np.stack(f, axis=1) for f in ((i, a, c), (a, j, b), (c, b, k), (a, b, c))])
    return np.concatenate([V, V[table.edges].mean(axis=1)]), faces


def _place(name: str, point: ArrayLike) -> FloatArray:
    """Return a point (3,) out of an argument."""
    rows = finite_points([point], name, "coordinates")  # type: ignore[arg-type]  # a point of any kind
    return rows[0]


def _quads(a: IntArray, b: IntArray, c: IntArray, d: IntArray) -> IntArray:
    corners = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    return np.stack(corners, axis=-2).reshape(-1, 3).astype(np.int64)
