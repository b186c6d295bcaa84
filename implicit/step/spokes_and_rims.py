"""The energy of finite rotations on a mesh of the surface: how far a deformation is from rigid, cell by cell.

    E(u) = sum over cells v of  min over rotations R_v of  sum over edges e  C[v, e] |(u_a - u_b) - R_v (x_a - x_b)|^2

The cell of a vertex is all edges of the faces round it, spokes and rims, and C half the cotangent opposite to the edge
in each such face [Chao, Pinkall, Sanan, Schroeder 2010; Sorkine and Alexa 2007]. It is zero just for rigid motions of
any size. To second order it is the membrane and bending of implicit.step.mesh_killing: for small motions 3/4 of that
energy. C is a sparse matrix of cells by edges, and with the differences D over the edges

    covariances  S_v = sum_e C[v, e] e_0 e^T      R_v maximises tr(R_v S_v)
    L = D^T diag(C^T 1) D                         L u = D^T ((C^T R) e_0) minimises over u for given rotations

Conventions: x is the rest shape, e_0 = D x, e = D u; each half edge is in the cells of three corners, so that L is
three times the cotangent Laplacian.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from implicit.sensitivity.weak_curvature import FloatArray, IntArray
from implicit.step.rotations import best_rotations


@dataclass(frozen=True, eq=False)
class SpokesAndRims:
    """The energy of deformations of a mesh.

    Attributes:
        vertices: The rest shape (V, 3).
        faces: Corners of the triangles (m, 3).
    """

    vertices: FloatArray
    faces: IntArray

    @cached_property
    def _edges(self) -> tuple[IntArray, IntArray]:
        """Ends of the edges (E, 2), and the edge opposite to each corner (m, 3)."""
        F = self.faces
        ends = np.stack([np.roll(F, -1, axis=1), np.roll(F, -2, axis=1)], axis=2).reshape(-1, 2)
        ends.sort(axis=1)
        code, edge = np.unique(ends[:, 0] * len(self.vertices) + ends[:, 1], return_inverse=True)
        both = np.stack([code // len(self.vertices), code % len(self.vertices)], axis=1)
        return both, edge.reshape(F.shape)

    @cached_property
    def cells(self) -> sparse.csr_array:
        """C, the weight of each edge in each cell (V, E)."""
        ends, edge = self._edges
        x = self.vertices[self.faces]
        first, second = np.roll(x, -1, axis=1) - x, np.roll(x, -2, axis=1) - x
        across = np.linalg.norm(np.cross(first[:, 0], second[:, 0]), axis=1)
        half = (first * second).sum(axis=2) / (2 * np.maximum(across, 1e-300)[:, None])
        # The edge opposite to corner k is in the cells of all three corners.
        cell = np.repeat(self.faces[:, None, :], 3, axis=1)
        columns, entries = (np.repeat(part[:, :, None], 3, axis=2) for part in (edge, half))
        shape = (len(self.vertices), len(ends))
        return sparse.coo_array((entries.ravel(), (cell.ravel(), columns.ravel())), shape=shape).tocsr()

    @cached_property
    def differences(self) -> sparse.csr_array:
        """D, the first end of each edge less the second (E, V)."""
        ends, _ = self._edges
        count = len(ends)
        entries = np.tile([1.0, -1.0], count)
        pointer = np.arange(0, 2 * count + 1, 2)
        return sparse.csr_array((entries, ends.ravel(), pointer), shape=(count, len(self.vertices)))

    @cached_property
    def _rest_edges(self) -> FloatArray:
        return np.asarray(self.differences @ self.vertices)

    @cached_property
    def _transposed(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """C^T and D^T, ready for products."""
        return sparse.csr_array(self.cells.T), sparse.csr_array(self.differences.T)

    @cached_property
    def edge_weights(self) -> FloatArray:
        """C^T 1, the weight of each edge in all cells (E,)."""
        return np.asarray(self.cells.sum(axis=0), dtype=np.float64).ravel()

    @cached_property
    def laplacian(self) -> sparse.csc_array:
        """L, (V, V)."""
        D = self.differences
        return sparse.csc_array(D.T @ sparse.diags_array(self.edge_weights) @ D)

    def covariances(self, moved: FloatArray) -> FloatArray:
        """Return S_v of a deformation with the vertices at `moved` (V, 3), as (V, 3, 3)."""
        outer = self._rest_edges[:, :, None] * np.asarray(self.differences @ moved)[:, None, :]
        return np.asarray(self.cells @ outer.reshape(-1, 9)).reshape(-1, 3, 3)

    def rotations(self, moved: FloatArray, start: FloatArray | None = None) -> FloatArray:
        """Return the best rotation of each cell (V, 3, 3), sought from a start where one is given."""
        return best_rotations(self.covariances(moved), start)

    def right_hand_side(self, rotations: FloatArray) -> FloatArray:
        """Return D^T ((C^T R) e_0), (V, 3)."""
        cells, differences = self._transposed
        of_edges = np.asarray(cells @ rotations.reshape(-1, 9)).reshape(-1, 3, 3)
        return np.asarray(differences @ np.einsum("eij,ej->ei", of_edges, self._rest_edges))

    def energy(self, moved: FloatArray, rotations: FloatArray | None = None) -> float:
        """Return E of a deformation, a squared length.

        Args:
            moved: Where the vertices are (V, 3).
            rotations: Of the cells (V, 3, 3); None takes the best.
        """
        rotations = self.rotations(moved) if rotations is None else rotations
        cells = self.cells.tocoo()
        e, e_0 = np.asarray(self.differences @ moved), self._rest_edges
        gaps = e[cells.col] - np.einsum("nij,nj->ni", rotations[cells.row], e_0[cells.col])
        return float(cells.data @ (gaps**2).sum(axis=1))

    def gradient(self, moved: FloatArray) -> FloatArray:
        """Return dE/du at the vertices (V, 3): the best rotations add nothing to first order."""
        return np.asarray(2 * (self.laplacian @ moved - self.right_hand_side(self.rotations(moved))))
