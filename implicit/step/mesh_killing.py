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

    @cached_property
    def _by_tangents(self) -> FloatArray:
        """Slopes along e and f of the function that is 1 at a corner (m, 3 corners, 2)."""
        return self.surface.hat_slopes.transpose(0, 2, 1)

    def _face_matrix(self, rows: FloatArray) -> sparse.csr_array:
        """Return rows (m, r, 3 corners, 3 coordinates) as a matrix over all displacements."""
        m, r = rows.shape[:2]
        columns = np.repeat((3 * self.surface.faces[:, :, None] + np.arange(3)).reshape(m, 1, 9), r, axis=1)
        pointer = np.arange(0, 9 * m * r + 1, 9)
        return sparse.csr_array((rows.ravel(), columns.ravel(), pointer), shape=(m * r, 3 * len(self.surface.vertices)))

    @cached_property
    def strains(self) -> sparse.csr_array:
        """Rows whose squares add up to the membrane energy (3 m, 3 V)."""
        return self._face_matrix(np.stack(self._strain_entries(), axis=1))

    def _strain_entries(self) -> list[FloatArray]:
        """Rows of the corners' displacements (m, 3 corners, 3) whose squares add up to the membrane energy."""
        root = np.sqrt(self.surface.contents)[:, None, None]
        along_e, along_f = (self._by_tangents[:, :, None, j] for j in range(2))
        e, f, _ = (self._frames[:, None, a] for a in range(3))
        shear = along_f * e + along_e * f
        return [2 * root * along_e * e, 2 * root * along_f * f, 2**0.5 * root * shear]

    def _rotation_entries(self) -> list[FloatArray]:
        """Rows of the corners' displacements (m, 3 corners, 3) that give the best rotation of each face along x, y, z.

        See the top of the file.
        """
        along_e, along_f = (self._by_tangents[:, :, None, j] for j in range(2))
        e, f, n = (self._frames[:, None, a] for a in range(3))
        about_e, about_f, about_n = along_f * n, -along_e * n, (along_e * f - along_f * e) / 2
        frames = self._frames
        return [
            frames[:, 0, None, None, x] * about_e
            + frames[:, 1, None, None, x] * about_f
            + frames[:, 2, None, None, x] * about_n
            for x in range(3)
        ]

    @cached_property
    def rotations(self) -> sparse.csr_array:
        """Rows that give the best rotation w_f of each face (3 m, 3 V)."""
        return self._face_matrix(np.stack(self._rotation_entries(), axis=1))

    @cached_property
    def _metrics(self) -> FloatArray:
        """A H of each face (m, 3, 3)."""
        n, area = self.surface.cell_normals, self.surface.contents[:, None, None]
        return np.asarray(area * (np.eye(3) + n[:, :, None] * n[:, None, :]))

    @cached_property
    def _moments(self) -> FloatArray:
        """Sum of A H over the faces at each vertex (V, 3, 3)."""
        F, V = self.surface.faces, len(self.surface.vertices)
        entries = self._metrics.reshape(len(F), 9).T
        sums = np.stack([np.bincount(F.ravel(), np.repeat(entry, 3), V) for entry in entries], axis=1)
        return sums.astype(np.float64).reshape(V, 3, 3)

    def matrix(self, axes: FloatArray) -> sparse.csc_array:
        """Return Q with d . Q d = E(d), over what the displacement of each vertex is along three axes (3 V, 3 V).

        With S = sum A H w_f at a vertex and M = sum A H, its corners bend by sum A w_f . H w_f - S . M^-1 S, so that
        faces are joined at their own corners and vertices with their neighbours alone.

        Args:
            axes: Rows: orthonormal vectors at each vertex (V, 3, 3).
        """
        F, V = self.surface.faces, len(self.surface.vertices)
        m, k = len(F), np.arange(3)
        strains = self._along(self._strain_entries(), axes)
        turned = self._along(self._rotation_entries(), axes)
        weighed = self._metrics @ turned
        weight = 4 * self.bending
        local = strains.transpose(0, 2, 1) @ strains + weight * (turned.transpose(0, 2, 1) @ weighed)
        places = (3 * F[:, :, None] + k).reshape(m, 9)
        of_faces = sparse.coo_array(
            (local.ravel(), (np.repeat(places, 9, axis=1).ravel(), np.tile(places, (1, 9)).ravel())),
            shape=(3 * V, 3 * V),
        )
        if self.bending == 0:
            return of_faces.tocsc()
        halves = np.linalg.inv(np.linalg.cholesky(self._moments))[F]  # of M^-1, at each corner
        sums = (halves @ weighed[:, None]).ravel()  # corner, entry, unknown
        rows = np.broadcast_to((3 * F[:, :, None] + k)[..., None], (m, 3, 3, 9)).ravel()
        columns = np.broadcast_to(places[:, None, None], (m, 3, 3, 9)).ravel()
        joined = sparse.coo_array((sums, (rows, columns)), shape=(3 * V, 3 * V)).tocsr()
        # Symmetric, so that the transposed is the same matrix by columns.
        return (of_faces.tocsr() - weight / 3 * (joined.T @ joined)).T

    def _along(self, entries: list[FloatArray], axes: FloatArray) -> FloatArray:
        """Return rows of the corners' displacements (m, 3 corners, 3) as ones of these along axes (m, r, 9)."""
        rows = np.stack(entries, axis=1)
        turned = np.matmul(rows[:, :, :, None], axes[self.surface.faces].transpose(0, 1, 3, 2)[:, None])
        return np.asarray(turned.reshape(*rows.shape[:2], 9))

    @cached_property
    def turns(self) -> sparse.csr_array:
        """Rows whose squares add up to the bending energy: at each corner, the face's rotation less the vertex's."""
        F, V = self.surface.faces, len(self.surface.vertices)
        m, n, area = len(F), self.surface.cell_normals, self.surface.contents[:, None, None]
        along = n[:, :, None] * n[:, None, :]
        inverse = np.linalg.inv(self._moments)
        corner_face = np.repeat(np.arange(m), 3)
        weights = np.einsum("cab,cbd->cad", inverse[F.ravel()], self._metrics[corner_face])
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
