"""The volume inside a closed mesh, by the divergence theorem, and its derivative by each vertex.

V = sum over faces  x_1 . (x_2 x x_3) / 6,      dV/dx_1 = sum over faces at the vertex  (x_2 x x_3) / 6
"""

from __future__ import annotations

import numpy as np

from implicit.sensitivity.weak_curvature import FloatArray, IntArray


def enclosed_volume(vertices: FloatArray, faces: IntArray) -> float:
    """Return the volume; each face counts with the sign of its turn about the mean of the vertices."""
    x = (vertices - vertices.mean(axis=0))[faces]
    return float(np.einsum("ni,ni->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6)


def volume_gradient(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return dV/dx (V, 3) of a closed mesh."""
    x = (vertices - vertices.mean(axis=0))[faces]
    parts = np.cross(np.roll(x, -1, axis=1), np.roll(x, -2, axis=1)) / 6
    sums = [np.bincount(faces.ravel(), column, len(vertices)) for column in parts.reshape(-1, 3).T]
    return np.stack(sums, axis=1).astype(np.float64)
