"""The volume inside a closed mesh, by the divergence theorem, its derivative by each vertex, and steps to a given one.

    V(x) = x . g(x) / 3,      g_i(x) = dV/dx_i = sum over faces at i  (x_2 - x_1) x (x_3 - x_1) / 6

V is a cubic form, so that along a line it is a cubic polynomial,

    V(u + s w) = V(u) + s w . g(u) + s^2 u . g(w) + s^3 V(w)
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from implicit.sensitivity.weak_curvature import FloatArray, IntArray

# Newton steps to a volume, and how near they come, relative to it.
STEPS = 12
TOLERANCE = 1e-14


@dataclass(frozen=True, eq=False)
class EnclosedVolume:
    """The volume inside meshes of one connection.

    Attributes:
        faces: Triangles of a closed mesh (m, 3), outward.
        count: Number of vertices V.
    """

    faces: IntArray
    count: int

    @cached_property
    def _sums(self) -> sparse.csr_array:
        """Matrix that sums over the faces at each vertex (V, m)."""
        m = len(self.faces)
        places = (self.faces.ravel(), np.repeat(np.arange(m), 3))
        return sparse.coo_array((np.ones(3 * m), places), shape=(self.count, m)).tocsr()

    def gradient(self, vertices: FloatArray) -> FloatArray:
        """Return g, (V, 3)."""
        x, y, z = vertices.T
        a, b, c = self.faces.T
        sides = [(axis[b] - axis[a], axis[c] - axis[a]) for axis in (x, y, z)]
        (x1, x2), (y1, y2), (z1, z2) = sides
        across = np.stack([y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2], axis=1)
        return np.asarray(self._sums @ across) / 6

    def value(self, vertices: FloatArray) -> float:
        """Return V."""
        return float(np.vdot(vertices - vertices.mean(axis=0), self.gradient(vertices))) / 3

    def reached(self, start: FloatArray, way: FloatArray, volume: float) -> FloatArray:
        """Return the positions on the line from a start along a way at which the volume is a given one.

        By Newton's method on the polynomial from the start; where it does not get there, the nearest it came.
        """
        middle = start.mean(axis=0)
        u, at_start, at_way = start - middle, self.gradient(start), self.gradient(way)
        whole = [np.vdot(u, at_start) / 3, np.vdot(way, at_start), np.vdot(u, at_way), np.vdot(way, at_way) / 3]
        polynomial = np.polynomial.Polynomial(whole) - volume
        slope, s = polynomial.deriv(), 0.0
        best = (abs(polynomial(s)), s)
        for _ in range(STEPS):
            steep = slope(s)
            if best[0] <= TOLERANCE * abs(volume) or steep == 0:
                break
            s -= polynomial(s) / steep
            best = min(best, (abs(polynomial(s)), s))
        return np.asarray(start + best[1] * way)
