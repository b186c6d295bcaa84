"""E_K of a displacement given at the vertices of a mesh of the surface, for fields without second derivatives.

    E = 4 sum over faces          A |(J - [w_f]) P|^2                 membrane: w_f the face's own best rotation
      + 4/3 sum over cells, faces A |[w_f - w_v] P|^2                 bending: w_v the best of all faces at a vertex

J is the slope of D on a face, [w] the matrix of w x, P = I - n n^T. The first sum is int |P (J + J^T) P|^2, zero for
isometric motions to first order; both together are the energy of spokes and rims [Chao, Pinkall, Sanan, Schroeder
2010], whose cells share a rotation, 4/3 sum A |(J - [w_v]) P|^2: the first sum is what the own rotation of each face
leaves. The rotations are eliminated: with tangents e, f and normal n of a face,

    w_f = e (n . J f) - f (n . J e) + n (f . J e - e . J f) / 2,     w_v = (sum A H)^-1 sum A H w_f,     H = I + n n^T,

for |[a] P|^2 = a . H a. Both are zero just for rigid motions (Killing fields).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import splu
from torch import Tensor

from implicit.sensitivity.weak_curvature import FloatArray, IntArray, WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import Rows
from implicit.step.mesh_energies import mesh_speed_rows

# Added to the diagonal of the energy's matrix, relative to its largest entry: rigid motions cost nothing, and a matrix
# that is singular has no triangular factor.
LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class MeshKilling:
    """E_K on a mesh, membrane and bending.

    Attributes:
        surface: The mesh, in space.
        bending: Weight of the bending part; 1 is the energy of spokes and rims.
    """

    surface: WeakSurface
    bending: float = 1.0

    def energy(self, displacement: FloatArray) -> float:
        """Return the energy of a displacement of the vertices (V, 3), a squared length."""
        moved = displacement.ravel()
        parts = [self.strains @ moved]
        if self.bending > 0:
            parts.append(self.bending**0.5 * (self.turns @ moved))
        return float(sum(part @ part for part in parts))

    @cached_property
    def _frames(self) -> FloatArray:
        """Tangents e, f and normal n of each face as rows (m, 3, 3)."""
        return np.concatenate([self.surface.tangents, self.surface.cell_normals[:, None]], axis=1)

    def _of_slopes(self, factors: FloatArray) -> FloatArray:
        """Return what numbers c_aj of a_a . J t_j, summed, take of each corner's displacement (m, 3 corners, 3).

        Args:
            factors: For each frame vector a and tangent j (3, 2) or of each face (m, 3, 2).
        """
        return np.asarray(np.einsum("maj,maX,mjk->mkX", factors, self._frames, self.surface.hat_slopes))

    def _face_matrix(self, rows: FloatArray) -> sparse.csr_array:
        """Return rows (m, r, 3 corners, 3 coordinates) as a matrix over all displacements."""
        m, r = rows.shape[:2]
        columns = np.repeat((3 * self.surface.faces[:, :, None] + np.arange(3)).reshape(m, 1, 9), r, axis=1)
        pointer = np.arange(0, 9 * m * r + 1, 9)
        return sparse.csr_array((rows.ravel(), columns.ravel(), pointer), shape=(m * r, 3 * len(self.surface.vertices)))

    @cached_property
    def strains(self) -> sparse.csr_array:
        """Rows whose squares add up to the membrane energy (3 m, 3 V)."""
        m = len(self.surface.faces)
        root = np.sqrt(self.surface.contents)[:, None, None]
        entries = []
        for factors in ([[2, 0], [0, 0], [0, 0]], [[0, 0], [0, 2], [0, 0]], [[0, 2**0.5], [2**0.5, 0], [0, 0]]):
            entries.append(root * self._of_slopes(np.broadcast_to(np.array(factors, dtype=float), (m, 3, 2))))
        return self._face_matrix(np.stack(entries, axis=1))

    @cached_property
    def rotations(self) -> sparse.csr_array:
        """Rows that give the best rotation w_f of each face (3 m, 3 V)."""
        m = len(self.surface.faces)
        frame = []
        # Along e, f and n; see the top of the file.
        for factors in ([[0, 0], [0, 0], [0, 1]], [[0, 0], [0, 0], [-1, 0]], [[0, -0.5], [0.5, 0], [0, 0]]):
            frame.append(self._of_slopes(np.broadcast_to(np.array(factors, dtype=float), (m, 3, 2))))
        return self._face_matrix(np.einsum("makX,maw->mwkX", np.stack(frame, axis=1), self._frames))

    @cached_property
    def turns(self) -> sparse.csr_array:
        """Rows whose squares add up to the bending energy: at each corner, the face's rotation less the vertex's."""
        F, V = self.surface.faces, len(self.surface.vertices)
        m, n, area = len(F), self.surface.cell_normals, self.surface.contents[:, None, None]
        along = n[:, :, None] * n[:, None, :]
        metric = area * (np.eye(3) + along)
        moments = np.stack([np.bincount(F.ravel(), np.repeat(entry, 3), V) for entry in metric.reshape(m, 9).T], axis=1)
        inverse = np.linalg.inv(moments.reshape(V, 3, 3))
        corner_face = np.repeat(np.arange(m), 3)
        weights = np.einsum("cab,cbd->cad", inverse[F.ravel()], metric[corner_face])
        means = _blocks(weights, F.ravel(), corner_face, (V, m))  # w_v of all w_f
        root = np.sqrt(4 / 3 * area) * (np.eye(3) + (2**0.5 - 1) * along)
        of_face = _blocks(root[corner_face], np.arange(3 * m), corner_face, (3 * m, m))
        of_vertex = _blocks(root[corner_face], np.arange(3 * m), F.ravel(), (3 * m, V))
        return sparse.csr_array((of_face - of_vertex @ means) @ self.rotations)

    @cached_property
    def _factor(self) -> sparse.csr_array:
        """Rows R (3 V, 3 V) with |R d|^2 = E(d), so many as unknowns: the triangular factor of the energy's matrix."""
        Q = self.strains.T @ self.strains
        if self.bending > 0:
            Q = Q + self.bending * (self.turns.T @ self.turns)
        Q = sparse.csc_array((Q + Q.T) / 2)
        Q = sparse.csc_array(Q + LEAST * Q.diagonal().max() * sparse.eye_array(Q.shape[0]))
        lu = splu(Q, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        # Without pivoting off the diagonal P Q P^T = L D L^T; rounding may leave a pivot of a rigid motion negative.
        pivots = np.maximum(lu.U.diagonal(), 0.0)
        return sparse.csr_array((sparse.diags_array(np.sqrt(pivots)) @ lu.L.T).tocsc()[:, lu.perm_c])

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        """Yield weighted equations over all unknowns, so many as the vertices have coordinates."""
        theta = space.field.theta
        moved = vertex_displacement_rows(space, self.surface)
        matrix = torch.from_numpy(self._factor @ moved.cpu().double().numpy()).to(theta)
        yield Rows(matrix, matrix.new_zeros(len(matrix)), matrix.new_ones(len(matrix)))


def vertex_displacement_rows(space: DeformationSpace, surface: WeakSurface) -> Tensor:
    """Return D at the vertices, coordinate by coordinate, as rows over all unknowns (3 V, S).

    D = N u + (I - N N^T) T with the mesh's normals N.
    """
    theta, d = space.field.theta, surface.dimension
    points, normals = (torch.from_numpy(part).to(theta) for part in (surface.vertices, surface.normals))
    rows = theta.new_zeros(len(points), d, space.size)
    speed = mesh_speed_rows(space, surface)
    for a in range(d):
        rows[:, a, : space.parameters] = normals[:, a, None] * speed[:, : space.parameters]
    if space.tangential is not None:
        functions = space.tangential.values(points)
        count = functions.shape[1]
        for a in range(d):
            for b in range(d):
                first = space.parameters + b * count
                share = float(a == b) - normals[:, a] * normals[:, b]
                rows[:, a, first : first + count] = share[:, None] * functions
    return rows.flatten(0, 1)


def _blocks(blocks: FloatArray, rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> sparse.csr_array:
    """Return the matrix of 3 x 3 blocks at places (row, column) of a matrix of blocks."""
    k = np.arange(3)
    at_rows = np.broadcast_to(3 * rows[:, None, None] + k[:, None], blocks.shape)
    at_columns = np.broadcast_to(3 * columns[:, None, None] + k, blocks.shape)
    entries = (blocks.ravel(), (at_rows.ravel(), at_columns.ravel()))
    return sparse.coo_array(entries, shape=(3 * shape[0], 3 * shape[1])).tocsr()
