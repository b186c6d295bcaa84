"""Connections of the faces: half-edges, edges, fans of faces, boundary loops and connected parts.

Half-edge h = 3 f + c runs from corner c of face f to its corner c + 1 (modulo 3), so the three arrays
"half-edge", "corner" and "entry of F.ravel()" share one numbering. Nothing here looks at coordinates,
and nothing checks its input: the faces must be integers inside range(n_vertices), as check_mesh leaves them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class EdgeTable(NamedTuple):
    """The undirected edges of a mesh with e edges and m faces."""

    edges: IntArray  # (e, 2) vertices, the smaller first
    of_half_edge: IntArray  # (3m,) the edge that each half-edge lies on
    faces: IntArray  # (e,) number of faces at each edge: 1 on a boundary, 2 inside, more where not manifold


def half_edges(F: IntArray) -> IntArray:
    """Return the start and end vertex of every half-edge, (3m, 2)."""
    return np.stack([F, np.roll(F, -1, axis=1)], axis=-1).reshape(-1, 2)


def next_in_face(h: IntArray) -> IntArray:
    """Return the half-edge that follows h in its face."""
    return h - h % 3 + (h + 1) % 3


def edge_table(F: IntArray, n_vertices: int) -> EdgeTable:
    """Return every undirected edge once, with the half-edges that lie on it."""
    ends = half_edges(F)
    key = ends.min(axis=1) * n_vertices + ends.max(axis=1)
    unique, of_half_edge, count = np.unique(key, return_inverse=True, return_counts=True)
    edges = np.stack([unique // n_vertices, unique % n_vertices], axis=1)
    return EdgeTable(edges, of_half_edge.reshape(-1), count.astype(np.int64))


def paired_half_edges(table: EdgeTable) -> IntArray:
    """Return the two half-edges of every edge that has exactly two, (k, 2)."""
    order = np.argsort(table.of_half_edge, kind="stable")
    first = (np.cumsum(table.faces) - table.faces)[table.faces == 2]
    return np.stack([order[first], order[first + 1]], axis=1)


def corner_fans(F: IntArray, table: EdgeTable) -> tuple[int, IntArray]:
    """Number the fans of faces around the vertices: (number of fans, fan of each corner (3m,)).

    Two corners at one vertex belong to one fan if one can walk between them through faces that share an edge.
    A surface is manifold at a vertex exactly if the vertex has one fan.
    """
    ends = half_edges(F)
    a, b = paired_half_edges(table).T
    opposite = ends[a, 0] == ends[b, 1]  # neighbours that are oriented alike run along their edge in opposite ways
    start_of_a = np.where(opposite, next_in_face(b), b)
    end_of_a = np.where(opposite, b, next_in_face(b))
    rows = np.concatenate([a, next_in_face(a)])
    columns = np.concatenate([start_of_a, end_of_a])
    return _parts(F.size, rows, columns)


def boundary_loops(F: IntArray, table: EdgeTable) -> list[IntArray]:
    """Return the closed loops of vertices round the holes, each in the direction of its half-edges.

    Needs a mesh whose vertices have one fan each and whose faces are oriented alike: then every vertex on the
    boundary starts one half-edge and ends one.
    """
    open_ends = half_edges(F)[table.faces[table.of_half_edge] == 1]
    follower = dict(open_ends.tolist())
    loops = []
    while follower:
        start, vertex = follower.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            vertex = follower.pop(vertex)
        loops.append(np.array(loop, dtype=np.int64))
    return loops


def vertex_components(F: IntArray, n_vertices: int) -> tuple[int, IntArray]:
    """Return the connected parts: (number, part of each vertex (n,)). An unreferenced vertex is a part of its own."""
    return _parts(n_vertices, np.concatenate([F[:, 0], F[:, 1]]), np.concatenate([F[:, 1], F[:, 2]]))


def disagreeing_pairs(F: IntArray, table: EdgeTable) -> IntArray:
    """Return pairs of half-edges on one edge that run the same way, (k, 2): their faces are oriented oppositely."""
    ends = half_edges(F)
    pairs = paired_half_edges(table)
    return np.asarray(pairs[ends[pairs[:, 0], 0] == ends[pairs[:, 1], 0]], dtype=np.int64)


def flips_to_agree(F: IntArray, table: EdgeTable) -> tuple[BoolArray, int | None]:
    """Return which faces to turn, the fewer, so that neighbours agree; and a face of a one-sided part, or None.

    Every face appears twice in a graph, as it is and turned. Neighbours that agree connect like with like,
    neighbours that disagree connect crosswise: if a face connects to its own turned copy, the part is one-sided.
    """
    m = len(F)
    pairs = paired_half_edges(table)
    ends = half_edges(F)
    agree = ends[pairs[:, 0], 0] == ends[pairs[:, 1], 1]
    f, g = (pairs // 3).T
    turned_g = np.where(agree, g, g + m)
    rows, columns = np.concatenate([f, f + m]), np.concatenate([turned_g, (turned_g + m) % (2 * m)])
    _, label = _parts(2 * m, rows, columns)
    kept, turned = label[:m], label[m:]
    one_sided = np.flatnonzero(kept == turned)
    if one_sided.size:
        return np.zeros(m, dtype=bool), int(one_sided[0])
    # Of the two mirror-image labellings of a part, keep the one that most of its faces have already.
    votes = np.bincount(kept, minlength=int(label.max()) + 1)
    flip = (votes[kept] < votes[turned]) | ((votes[kept] == votes[turned]) & (kept > turned))
    return np.asarray(flip, dtype=np.bool_), None


def _parts(size: int, rows: IntArray, columns: IntArray) -> tuple[int, IntArray]:
    graph = sparse.coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(size, size))
    count, label = csgraph.connected_components(graph, directed=False)
    return int(count), np.asarray(label, dtype=np.int64)
