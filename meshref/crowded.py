"""Edges at which four or more faces meet, because solids touch there: the surface is cut apart along them.

Round such an edge, solid and empty wedges follow each other. Going round it in the positive sense, a solid wedge begins
with a face that runs along the edge backwards and ends with one that runs forwards: these two belong together.

    solid between  - and +      two boxes that share an edge:   - [solid] +   (empty)   - [solid] +   (empty)
"""

from __future__ import annotations

import numpy as np

from meshref.check import signed_volume
from meshref.topology import EdgeTable, FloatArray, IntArray, corner_fans, edge_table, half_edges

SAME_ANGLE = 1e-7  # radians; faces nearer to each other lie on each other, and which comes first cannot be told


def cut_apart(V: FloatArray, F: IntArray) -> tuple[IntArray, IntArray] | None:
    """Return the faces with copies of vertices, so that at most two meet in an edge, and what each copy is one of.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).

    Returns:
        Faces that number the vertices and after them the copies, and the vertex that each copy is one of, (c,). None
        where faces and wedges do not follow each other round an edge, or an edge would still have more than two faces.
    """
    table = edge_table(F, len(V))
    pairs = _pairs(V, F if signed_volume(V, F) > 0 else F[:, ::-1], table)
    if pairs is None:
        return None
    of_half_edge, faces = table.of_half_edge.copy(), table.faces.copy()
    extra = 0
    for edge, found in pairs.items():
        for k, pair in enumerate(found):
            of_half_edge[pair] = edge if k == 0 else len(faces) + extra
            extra += k > 0
        faces[edge] = 2
    single = EdgeTable(table.edges, of_half_edge, np.concatenate([faces, np.full(extra, 2)]))
    fans, fan = corner_fans(F, single)
    owner = np.zeros(fans, dtype=np.int64)
    owner[fan] = F.ravel()
    copies = np.setdiff1d(np.arange(fans), np.unique(owner, return_index=True)[1])
    vertex = owner.copy()
    vertex[copies] = len(V) + np.arange(len(copies))
    cut = vertex[fan].reshape(-1, 3)
    return (cut, owner[copies]) if edge_table(cut, len(V) + len(copies)).faces.max() <= 2 else None


def _pairs(V: FloatArray, F: IntArray, table: EdgeTable) -> dict[int, list[list[int]]] | None:
    """Return for each edge of more than two faces the half-edges of each of its solid wedges."""
    # Of the faces turned round, the half-edges in the order of those of the table, which knows no direction.
    ends = half_edges(F)
    number = edge_table(F, len(V)).of_half_edge
    found: dict[int, list[list[int]]] = {}
    for edge in np.flatnonzero(table.faces > 2).tolist():
        h = np.flatnonzero(number == edge)
        start, end = table.edges[edge]
        forwards = ends[h, 0] == start
        along = (V[end] - V[start]) / np.linalg.norm(V[end] - V[start])
        apex = V[F[h // 3, (h + 2) % 3]] - V[start]
        across = apex - np.outer(apex @ along, along)
        first = across[0] / np.linalg.norm(across[0])
        angle = np.arctan2(across @ np.cross(along, first), across @ first) % (2 * np.pi)
        order = np.argsort(angle)
        gaps = np.diff(np.append(angle[order], angle[order[0]] + 2 * np.pi))
        forwards, faces = forwards[order], h[order] // 3
        if len(h) % 2 or gaps.min() < SAME_ANGLE or (forwards == np.roll(forwards, 1)).any():
            return None
        shift = int(forwards[0])  # so that the first begins a wedge
        faces = np.roll(faces, -shift)
        found[edge] = [[_on_edge(table, edge, int(f)) for f in faces[k : k + 2]] for k in range(0, len(faces), 2)]
    return found


def _on_edge(table: EdgeTable, edge: int, face: int) -> int:
    """Return the half-edge of a face that lies on an edge."""
    return 3 * face + int(np.flatnonzero(table.of_half_edge[3 * face : 3 * face + 3] == edge)[0])
