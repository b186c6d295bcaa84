"""The energy of finite rotations of a planar shape: of the triangles inside its curve, not of the curve alone.

A curve bends at no cost of its own; what holds a planar shape is its inside. Its triangulation lies in the plane z = 0
of space, where the energy of spokes and rims is that of planar as-rigid-as-possible deformation [Igarashi, Moscovich,
Hughes 2005; Sorkine and Alexa 2007], for small motions that of as-Killing-as-possible fields [Solomon and others 2011].
A half turn out of the plane would pass for a reflection in it: a large last entry of the covariances forbids it.

Conventions: positions are (V, 3) with z = 0 here, (V, 2) outside; the first vertices are those of the curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from implicit.sensitivity.weak_curvature import FloatArray, IntArray
from implicit.step.spokes_and_rims import SpokesAndRims

# Of the last entry of a cell's covariance over the energy of all its edges: the rotations stay in the plane however the
# cell is stretched, up to so many times.
UPRIGHT = 100.0


@dataclass(frozen=True, eq=False)
class PlanarSpokesAndRims(SpokesAndRims):
    """The energy of deformations of a triangulated planar shape, whose vertices (V, 3) have z = 0."""

    @cached_property
    def _upright(self) -> FloatArray:
        lengths = (np.asarray(self.differences @ self.vertices) ** 2).sum(axis=1)
        return UPRIGHT * np.asarray(abs(self.cells) @ lengths)

    def covariances(self, moved: FloatArray) -> FloatArray:
        """Return S_v of a deformation with the vertices at `moved` (V, 3), as (V, 3, 3)."""
        found = super().covariances(moved)
        found[:, 2, 2] = self._upright
        return found

    def of_curve(self, count: int) -> sparse.csc_array:
        """Return L over the first vertices alone, the others where they cost least (B, B).

        Args:
            count: B.
        """
        L = sparse.csr_array(self.laplacian)
        own, across, inner = L[:count, :count], L[:count, count:], L[count:, count:]
        if inner.shape[0] == 0:
            return sparse.csc_array(own)
        solved = splu(sparse.csc_array(inner)).solve(np.asarray(across.T.todense()))
        return sparse.csc_array(own.todense() - across @ solved)


@dataclass(frozen=True, eq=False)
class EnclosedArea:
    """The area inside closed curves in the plane z = 0, as implicit.step.enclosed_volume has volumes.

        A(x) = x . g(x) / 2,      A(u + s w) = A(u) + s w . g(u) + s^2 A(w)

    Attributes:
        sides: Ends of the segments (B, 2), the inside on their left.
    """

    sides: IntArray

    def gradient(self, vertices: FloatArray) -> FloatArray:
        """Return g, the derivative by each vertex (V, 3)."""
        result = np.zeros_like(vertices)
        a, b = self.sides.T
        for end, other, sign in ((a, b, 1.0), (b, a, -1.0)):
            np.add.at(result[:, 0], end, sign * vertices[other, 1] / 2)
            np.add.at(result[:, 1], end, -sign * vertices[other, 0] / 2)
        return result

    def value(self, vertices: FloatArray) -> float:
        """Return A."""
        return float(np.vdot(vertices, self.gradient(vertices))) / 2

    def reached(self, start: FloatArray, way: FloatArray, area: float) -> FloatArray:
        """Return the positions on the line from a start along a way at which the area is a given one.

        Of the two there may be the nearer; where there is none, the nearest it comes.
        """
        slope, square = float(np.vdot(way, self.gradient(start))), self.value(way)
        missing = area - self.value(start)
        # The root that stays finite where the square vanishes.
        root = max(slope**2 + 4 * square * missing, 0.0) ** 0.5
        below = slope + (root if slope >= 0 else -root)
        return start if below == 0 else np.asarray(start + 2 * missing / below * way)
