"""Triangles between clusters of the vertices of a finer mesh: where three clusters meet in a triangle of it.

So the points of a surface that are to carry an edit become a mesh without being moved: each vertex of a finer mesh of
the surface belongs to the point that is nearest to it, in the space of positions and normals, where the normals keep
two sheets apart that are closer than the points,

    |x - p|^2 + (NORMALS h)^2 |n_x - n_p|^2,     h the spacing of the points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from implicit.surface.topology import Topology, mesh_topology

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Weight of the normals beside the positions, in units of the spacing.
NORMALS = 0.5


def connected_points(
    points: FloatArray, normals: FloatArray, V: FloatArray, F: IntArray, topology: Topology
) -> IntArray | None:
    """Return triangles between points of a surface, outward (m, 3); None where they make no mesh of it.

    Args:
        points, normals: Of the surface, spread evenly (N, 3).
        V, F: A closed mesh of the same surface with at least some six times as many vertices.
        topology: Its pieces and handles.

    Returns:
        Triangles whose vertices are all the points, of the type of the finer mesh.
    """
    areas, _, mesh_normals = vertex_normals(V, F)
    spacing = (areas.sum() / len(points)) ** 0.5
    centres = np.concatenate([points, NORMALS * spacing * normals], axis=1)
    places = np.concatenate([V, NORMALS * spacing * mesh_normals], axis=1)
    cluster = in_one_piece(np.asarray(cKDTree(centres).query(places)[1], dtype=np.int64), F)
    triangles = dual_triangles(cluster, F)
    if len(np.unique(triangles)) < len(points) or not is_closed(triangles):
        return None
    return triangles if mesh_topology(points, triangles).same_type(topology) else None


def vertex_normals(V: FloatArray, F: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the areas of triangles (m,), and the share of area (V,) and unit normal of each vertex (V, 3)."""
    across = np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]) / 2
    areas = np.linalg.norm(across, axis=1)
    masses = np.bincount(F.ravel(), np.repeat(areas, 3), len(V)) / 3
    sums = [np.bincount(F.ravel(), np.repeat(part, 3), len(V)) for part in across.T]
    normals = np.stack(sums, axis=1).astype(np.float64)
    return areas, masses, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def dual_triangles(cluster: IntArray, F: IntArray) -> IntArray:
    """Return the triangles of clusters (k, 3) from the cluster of each vertex (V,) of a mesh with faces F (m, 3)."""
    corners = cluster[F]
    return np.asarray(corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)])


def in_one_piece(cluster: IntArray, F: IntArray) -> IntArray:
    """Return clusters in one piece each: what is apart from the largest piece goes to a neighbour's."""
    ends = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])  # of a closed mesh each way once
    cluster = cluster.copy()
    for _ in range(8):
        inner = ends[cluster[ends[:, 0]] == cluster[ends[:, 1]]]
        links = sparse.coo_array(
            (np.ones(len(inner), dtype=np.int8), (inner[:, 0], inner[:, 1])), shape=(len(cluster),) * 2
        )
        piece = csgraph.connected_components(links, directed=False)[1]
        sizes = np.bincount(piece)
        of_piece = np.zeros(len(sizes), dtype=np.int64)
        of_piece[piece] = cluster
        largest = np.zeros(cluster.max() + 1, dtype=np.int64)
        np.maximum.at(largest, of_piece, sizes)
        stray = sizes[piece] < largest[cluster]
        if not stray.any():
            break
        across = ends[stray[ends[:, 0]] & ~stray[ends[:, 1]]]
        cluster[across[:, 0]] = cluster[across[:, 1]]
    return cluster


def is_closed(F: IntArray) -> bool:
    """Return whether each half edge has just one opposite to it."""
    ends = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
    count = F.max() + 1 if len(F) else 1
    forth, back = np.sort(ends[:, 0] * count + ends[:, 1]), np.sort(ends[:, 1] * count + ends[:, 0])
    return len(F) > 0 and bool((np.diff(forth) > 0).all()) and bool((forth == back).all())
