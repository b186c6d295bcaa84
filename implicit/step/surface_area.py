"""The area of a mesh and its derivative by each vertex.

A(x) = sum over faces |(x_2 - x_1) x (x_3 - x_1)| / 2,      dA/dx_k = n x (side opposite to corner k) / 2
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from implicit.sensitivity.weak_curvature import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SurfaceArea:
    """The area of meshes of one connection.

    Attributes:
        faces: Triangles (m, 3).
        count: Number of vertices V.
    """

    faces: IntArray
    count: int

    def value(self, vertices: FloatArray) -> float:
        """Return A."""
        return float(np.linalg.norm(self._across(vertices), axis=1).sum() / 2)

    def gradient(self, vertices: FloatArray) -> FloatArray:
        """Return dA/dx, (V, 3); of a triangle without area, nothing."""
        across = self._across(vertices)
        normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        corners = vertices[self.faces]
        opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
        slopes = np.cross(normals[:, None], opposite).reshape(-1, 3) / 2
        places = self.faces.ravel()
        return np.stack([np.bincount(places, column, self.count) for column in slopes.T], axis=1)

    def _across(self, vertices: FloatArray) -> FloatArray:
        a, b, c = (vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))
