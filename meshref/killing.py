"""Energies of a displacement field by its distance from a rigid motion, and the field that has the least of them.

    E(d) = integral over the surface of | P (J + J^T) P |_F^2,     J = grad d,  P = I - n n^T           ("membrane")

is zero exactly for infinitesimal rigid motions d = a + w x x (Killing fields), on any mesh, to rounding. With linear
elements, A the area of a face and [w] the matrix of w x, the same number can be had by fitting a rotation:

    |P (J + J^T) P|^2  =  4 min over w of |(J - [w]) P|^2,

for a rotation of the face's own absorbs the skew and the out-of-plane part of J P. The other forms share the
rotation among the faces of a cell, which adds resistance to bending:

    "membrane"          4   sum over faces           A |(J - [w]) P|^2    a rotation for each face
    "spokes-and-rims"   4/3 sum over cells, faces    A |(J - [w]) P|^2    one for each vertex, over all faces there
    "spokes"            2   sum over cells, edges    w_ij |d_i - d_j - w x (x_i - x_j)|^2    one for each vertex
    "ambient"           integral of |J + J^T|_F^2 in space, the normal derivative of d taken as zero: charges rotations
    "notebook"          sum over faces of |J + J^T|_F^2, no areas: charges rotations, and grows with the resolution

The first three tend to the same integral for a smooth d (spokes on regular meshes only). The membrane form measures;
it does not make a usable prior, for a thin shell without bending buckles: minimise "spokes-and-rims".
Sources: Ben-Chen, Butscher, Solomon, Guibas 2010 (Killing energy); Chao, Pinkall, Sanan, Schroeder 2010 (cells).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from time import perf_counter
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from meshref.check import (
    MeshError,
    check_mesh,
    handle_vectors,
    place,
    require_choice,
    require_positive,
    vertex_field,
    vertex_indices,
)
from meshref.curvature import corner_cotangents, laplacian
from meshref.factor import Solver, factorise
from meshref.measures import doubled_area_vectors, face_areas, lumped_areas, opposite_sides
from meshref.metrics import handle_error
from meshref.printing import brief
from meshref.springs import spring_weights
from meshref.topology import FloatArray, IntArray, vertex_components

Form = Literal["membrane", "spokes-and-rims", "spokes", "ambient", "notebook"]

# Largest residual of the linear system, relative to its right-hand side, that counts as solved.
SOLVED_TO = 1e-8

# Handle points whose second largest extent is below this part of the largest are taken to lie on a line.
COLLINEAR = 1e-6


def killing(
    V: ArrayLike,
    F: ArrayLike,
    handles: ArrayLike,
    displacements: ArrayLike,
    *,
    form: Form = "spokes-and-rims",
    method: Literal["hard", "soft"] = "hard",
    penalty: float | None = None,
    handle_weights: ArrayLike | None = None,
    solver: Solver = "auto",
) -> KillingResult:
    """Return the displacement field closest to a rigid motion that moves the handle vertices as told.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        handles: Numbers of the vertices that are told where to go, (h,), each once; those to be held are among them.
        displacements: Their displacements, (h, 3), in the length unit of V.
        form, method, penalty, handle_weights, solver: See KillingSolver.

    Raises:
        MeshError: See KillingSolver.
    """
    prepared = KillingSolver(
        V, F, handles, form=form, method=method, penalty=penalty, handle_weights=handle_weights, solver=solver
    )
    return prepared.run(displacements)


class KillingStatus(Enum):
    """End of a solve; the value is the sentence a user reads."""

    SOLVED = "The displacement minimises the energy."
    INACCURATE = "The linear system is so ill-conditioned that its solution has a large residual; do not trust it."


@dataclass(frozen=True, eq=False)
class KillingResult:
    """A displacement field, its energy, the error at the handles, and the residual."""

    displacement: FloatArray  # (n, 3), add to V
    energy: float  # in the form that was minimised, squared length
    handle_error: float  # largest distance of a handle from where it was sent; 0 for method="hard"
    residual: float  # of the linear system, relative to its right-hand side
    status: KillingStatus
    solver: str  # the library that factorised
    seconds: Mapping[str, float]  # "assembly", "factorisation", "solve"

    __repr__ = brief


def killing_energy(V: ArrayLike, F: ArrayLike, D: ArrayLike, form: Form = "membrane") -> float:
    """Return the Killing energy of a displacement field, a squared length.

    It is 0 for a rigid motion, and 32 pi for d = n on a unit sphere.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        D: Displacement of each vertex, (n, 3), linear on each face.
        form: Which energy, see the top of this file. The headline is "membrane".

    Raises:
        MeshError: check_mesh refuses the mesh, D does not fit it, or the form is unknown.
    """
    V, F = check_mesh(V, F)
    D = vertex_field(D, V)
    _require_form(form)
    if form == "spokes-and-rims":
        return float(_spokes_and_rims_energy(V, F, D))
    if form == "spokes":
        return float(_spokes_energy(V, F, D))
    weights = np.ones(len(F)) if form == "notebook" else face_areas(V, F)
    J = displacement_gradients(V, F, D)
    return float(weights @ (_membrane_density(V, F, J) if form == "membrane" else _ambient_density(J)))


def killing_energy_density(
    V: ArrayLike, F: ArrayLike, D: ArrayLike, form: Literal["membrane", "ambient"] = "membrane"
) -> FloatArray:
    """Return the Killing energy per area of each face, (m,), a pure number.

    Its sum weighted by the faces' areas is the energy.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        D: Displacement of each vertex, (n, 3).
        form: "membrane" or "ambient", the forms that are sums over faces.

    Raises:
        MeshError: check_mesh refuses the mesh, D does not fit it, or the form has no density.
    """
    V, F = check_mesh(V, F)
    J = displacement_gradients(V, F, vertex_field(D, V))
    require_choice("form", form, ("membrane", "ambient"))
    return _membrane_density(V, F, J) if form == "membrane" else _ambient_density(J)


class KillingSolver:
    """The factorised energy matrix of one mesh with one set of handle vertices, for many displacements of them."""

    def __init__(
        self,
        V: ArrayLike,
        F: ArrayLike,
        handle_vertices: ArrayLike,
        *,
        form: Form = "spokes-and-rims",
        method: Literal["hard", "soft"] = "hard",
        penalty: float | None = None,
        handle_weights: ArrayLike | None = None,
        solver: Solver = "auto",
    ) -> None:
        """Assemble and factorise.

        Args:
            V: Vertices, (n, 3).
            F: Faces, (m, 3).
            handle_vertices: Numbers of the vertices that will be told where to go, (h,), each once. Every connected
                part of the mesh needs three that are not on one line, or it could turn freely.
            form: The energy to minimise, see the top of this file.
            method: "hard" moves the handles exactly; "soft" adds penalty times the integral of the squared
                deviation over the handles (a third of the area of the faces round each).
            penalty: For "soft", per squared length; None is 1e6 over the area of the mesh.
            handle_weights: For "soft", the weight of the squared deviation of each handle, (h,), positive; None is
                the area that belongs to it. Ones, with a penalty of 1e4, are what the published notebook uses.
            solver: Library that factorises, see factorise.

        Raises:
            MeshError: check_mesh refuses the mesh; handles are unknown, doubled, or too few; an option is unknown.
            NotPositiveDefiniteError: The handles do not determine the minimum of this form.
        """
        start = perf_counter()
        V, F = check_mesh(V, F)
        _require_form(form)
        require_choice("method", method, ("hard", "soft"))
        if handle_weights is not None and method == "hard":
            raise MeshError(
                "handle_weights belong to method='soft', but method is 'hard', which moves handles exactly."
            )
        if penalty is not None:
            require_positive("penalty", penalty)
            if method == "hard":
                raise MeshError("a penalty must go with method='soft', but method is 'hard', which needs none.")
        handles = vertex_indices(handle_vertices, len(V), "handle_vertices")
        require_rigid_handles(V, F, handles)
        self.handle_vertices = handles
        self.form, self.method = form, method
        self._matrix = energy_matrix(V, F, form)
        fixed = _coordinates_of(handles)
        areas = lumped_areas(V, F)
        if method == "soft" and penalty is None:
            penalty = 1e6 / float(areas.sum())
        self.penalty = penalty
        if self.penalty is None:
            is_free = np.ones(3 * len(V), dtype=np.bool_)
            is_free[fixed] = False
            self._free = np.flatnonzero(is_free)
            rows = self._matrix[self._free]
            self._system = sparse.csc_array(rows[:, self._free])
            self._load = -rows[:, fixed]
        else:
            weights = self.penalty * np.repeat(spring_weights(handles, areas, handle_weights), 3)
            shape = (3 * len(V), len(fixed))
            self._free = np.arange(3 * len(V))
            self._load = sparse.csc_array((weights, (fixed, np.arange(len(fixed)))), shape=shape)
            diagonal = np.bincount(fixed, weights=weights, minlength=3 * len(V))
            self._system = (self._matrix + sparse.diags_array(diagonal)).tocsc()
        assembled = perf_counter()
        self._factor = None
        if self._free.size:
            # Spokes and rims is positive on all but rigid motions, which the handles have just been seen to exclude.
            self._factor = factorise(self._system, solver, surely_definite=form == "spokes-and-rims")
        self.seconds = MappingProxyType({"assembly": assembled - start, "factorisation": perf_counter() - assembled})

    def solve(self, displacements: ArrayLike) -> FloatArray:
        """Return the displacement of every vertex, (n, 3), for displacements of the handle vertices, (h, 3)."""
        return self.run(displacements).displacement

    def run(self, displacements: ArrayLike) -> KillingResult:
        """Solve, with the evidence: energy, handle error, residual and seconds beside the displacement."""
        start = perf_counter()
        wanted = handle_vectors(displacements, self.handle_vertices, "displacements")
        field = np.zeros(self._matrix.shape[0])
        residual, solver = 0.0, "none needed"
        field[_coordinates_of(self.handle_vertices)] = wanted.ravel()
        if self._factor is not None:
            load = self._load @ wanted.ravel()
            field[self._free] = self._factor.solve(load)
            misfit = np.linalg.norm(self._system @ field[self._free] - load)
            residual = float(misfit / max(float(np.linalg.norm(load)), np.finfo(float).tiny))
            solver = self._factor.solver
        displacement = field.reshape(-1, 3)
        return KillingResult(
            displacement=displacement,
            energy=max(float(field @ (self._matrix @ field)), 0.0),
            handle_error=handle_error(displacement, self.handle_vertices, wanted),
            residual=residual,
            status=KillingStatus.SOLVED if residual <= SOLVED_TO else KillingStatus.INACCURATE,
            solver=solver,
            seconds=MappingProxyType({**self.seconds, "solve": perf_counter() - start}),
        )


def require_rigid_handles(V: FloatArray, F: IntArray, handles: IntArray) -> None:
    """Refuse handles that leave a connected part of the mesh free to move rigidly.

    Raises:
        MeshError: A part has fewer than three handles that are not on one line.
    """
    parts, part = vertex_components(F, len(V))
    for k in range(parts):
        points = V[handles[part[handles] == k]]
        extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) > 2 else np.zeros(3)
        if extents[1] <= COLLINEAR * extents[0]:
            vertex = int(np.argmax(part == k))
            of_part = "" if parts == 1 else f" on each of the {parts} connected parts of the mesh"
            raise MeshError(
                f"at least three handle vertices that are not on one line are needed{of_part}, but the part of vertex "
                f"{vertex} at {place(V[vertex])} has {len(points)}{' on one line' if len(points) > 2 else ''}: it "
                "could turn freely. Add handles there, with zero displacement to hold it."
            )


def energy_matrix(V: FloatArray, F: IntArray, form: Form) -> sparse.csc_array:
    """Return the matrix Q, (3n, 3n), with d.ravel() @ Q @ d.ravel() the energy of d (n, 3), for a checked mesh."""
    if form in ("spokes", "spokes-and-rims"):
        return _cell_matrix(V, F, form)
    operator, weights = _strain_operator(V, F, form)
    return sparse.csc_array(operator.T @ sparse.diags_array(weights) @ operator)


def displacement_gradients(V: FloatArray, F: IntArray, D: FloatArray) -> FloatArray:
    """Return the gradient J (m, 3, 3) of the piecewise linear field: J[f, x, y] = d(d_x)/dy, zero along the normal."""
    return np.asarray(np.einsum("fkx,fky->fxy", D[F], hat_gradients(V, F)))


def hat_gradients(V: FloatArray, F: IntArray) -> FloatArray:
    """Return the gradient of the linear function that is 1 at a corner and 0 at the others, (m, 3, 3).

    It is n x (opposite side) / 2A.
    """
    doubled = doubled_area_vectors(V, F)
    scaled_normal = doubled / (doubled**2).sum(axis=1, keepdims=True)  # n / 2A
    opposite = opposite_sides(V, F)
    return np.asarray(np.cross(scaled_normal[:, None, :], opposite))


def _membrane_density(V: FloatArray, F: IntArray, J: FloatArray) -> FloatArray:
    T = _tangents(V, F)
    strain = np.einsum("fax,fxy,fby->fab", T, J, T)
    return np.asarray(((strain + strain.transpose(0, 2, 1)) ** 2).sum(axis=(1, 2)))


def _ambient_density(J: FloatArray) -> FloatArray:
    return np.asarray(((J + J.transpose(0, 2, 1)) ** 2).sum(axis=(1, 2)))


def _tangents(V: FloatArray, F: IntArray) -> FloatArray:
    """Return two orthonormal vectors in the plane of each face, (m, 2, 3)."""
    side = V[F[:, 1]] - V[F[:, 0]]
    first = side / np.linalg.norm(side, axis=1, keepdims=True)
    normal = doubled_area_vectors(V, F)
    second = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), first)
    return np.stack([first, second], axis=1)


def _strain_operator(V: FloatArray, F: IntArray, form: Form) -> tuple[sparse.csr_array, FloatArray]:
    """Return the rows of J + J^T of every face, in its plane or in space, and the weight of each row's square."""
    G = hat_gradients(V, F)
    m, axes = len(F), np.eye(3)
    if form == "membrane":
        T = _tangents(V, F)
        G = np.einsum("fax,fkx->fka", T, G)
        pairs = [(0, 0), (1, 1), (0, 1)]
        frame = [T[:, a] for a in range(2)]
    else:
        pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
        frame = [np.broadcast_to(axes[a], (m, 3)) for a in range(3)]
    # Entry for corner k, coordinate x, of the strain J_ab + J_ba, J_ab = sum over k of (frame_a . d_k) G_kb.
    J = [[frame[a][:, None, :] * G[:, :, b, None] for b in range(len(frame))] for a in range(len(frame))]
    rows = np.stack([J[a][b] + J[b][a] for a, b in pairs], axis=1)
    r = len(pairs)
    columns = np.broadcast_to((3 * F[:, :, None] + np.arange(3)).reshape(m, 1, 9), (m, r, 9))
    pointer = np.arange(0, 9 * m * r + 1, 9)
    operator = sparse.csr_array((rows.reshape(-1), columns.reshape(-1), pointer), shape=(m * r, 3 * len(V)))
    twice = np.array([1.0 if a == b else 2.0 for a, b in pairs])  # an entry off the diagonal stands for two
    area = np.ones(m) if form == "notebook" else face_areas(V, F)
    return operator, np.outer(area, twice).ravel()


# Cells. With the edges e and differences delta of a cell and weights c, the least of sum c |delta - w x e|^2 is at
#
#     w = A^-1 b,    A = sum c (|e|^2 I - e e^T),    b = sum c e x delta,    and is    sum c |delta|^2 - b^T A^-1 b.
#
# b is linear in d: b_i = sum over j of U_ij x d_j with vectors U_ij, nonzero only for neighbours. So
#
#     Q = cells_per_edge * L (x) I  -  [U]^T blockdiag(A^-1) [U],     [U] made of 3 x 3 blocks, the matrices of U_ij x.
#
# For spokes and rims the cell of a vertex is all edges of the faces round it, with half the cotangent each. Over one
# face these give sum c e e^T = (area) P: so A is a sum over the faces of area (I + n n^T), and never singular.


def _cell_matrix(V: FloatArray, F: IntArray, form: Form) -> sparse.csc_array:
    L = laplacian(V, F)
    if form == "spokes-and-rims":
        inverse, U, scale, cells_per_edge = np.linalg.inv(_rim_moments(V, F)), _rim_moment_arms(V, F), 4 / 3, 3
    else:
        moments, U = _spoke_moments(V, F, L)
        inverse, scale, cells_per_edge = _symmetric_pseudo_inverse(moments), 2.0, 2
    blocks = cross_matrices(np.stack([u.data for u in U], axis=1))
    row_of_block = np.repeat(np.arange(len(V)), np.diff(U[0].indptr))
    shape = (3 * len(V), 3 * len(V))
    B: Any = sparse.bsr_array((blocks, U[0].indices, U[0].indptr), shape=shape)
    AB: Any = sparse.bsr_array(((scale * inverse)[row_of_block] @ blocks, U[0].indices, U[0].indptr), shape=shape)
    spread_blocks = (scale * cells_per_edge) * L.data[:, None, None] * np.eye(3)
    spread: Any = sparse.bsr_array((spread_blocks, L.indices, L.indptr), shape=shape)  # L^T = L: rows are columns
    rows: Any = (spread - B.T @ AB).tocsr()
    # A symmetric matrix by rows is the same by columns, and converting it would cost a third of the assembly.
    return sparse.csc_array((rows.data, rows.indices, rows.indptr), shape=shape)


def _rim_moments(V: FloatArray, F: IntArray) -> FloatArray:
    doubled = doubled_area_vectors(V, F)
    area = face_areas(V, F)[:, None, None]
    of_face = area * np.eye(3) + doubled[:, :, None] * doubled[:, None, :] / (4 * area)
    incidence = sparse.csr_array((np.ones(F.size), (F.ravel(), np.arange(F.size) // 3)), shape=(len(V), len(F)))
    return np.asarray(incidence @ of_face.reshape(-1, 9)).reshape(-1, 3, 3)


def _rim_moment_arms(V: FloatArray, F: IntArray) -> list[sparse.csr_array]:
    """Return the x, y and z parts of U for spokes and rims: three (n, n) matrices that share one pattern."""
    half = corner_cotangents(V, F) / 2
    opposite = half[:, :, None] * opposite_sides(V, F)  # c e
    # Corner k ends the edge opposite to k+1 and starts the edge opposite to k+2: delta = d_end - d_start.
    arm = np.roll(opposite, -1, axis=1) - np.roll(opposite, -2, axis=1)
    cell = np.repeat(F, 3, axis=1).ravel()  # each face belongs to the cells of its three corners
    vertex = np.tile(F, (1, 3)).ravel()
    arms = np.broadcast_to(arm[:, None], (len(F), 3, 3, 3)).reshape(-1, 3)
    return _alike([(arms[:, x], cell, vertex) for x in range(3)], len(V))


def _spoke_moments(V: FloatArray, F: IntArray, L: sparse.csc_array) -> tuple[FloatArray, list[sparse.csr_array]]:
    i, j, minus_weight = sparse.find(L)
    i, j, weight = i[i != j], j[i != j], -minus_weight[i != j]
    e = V[i] - V[j]
    of_edge = weight[:, None, None] * ((e**2).sum(axis=1)[:, None, None] * np.eye(3) - e[:, :, None] * e[:, None, :])
    incidence = sparse.csr_array((np.ones(len(i)), (i, np.arange(len(i)))), shape=(len(V), len(i)))
    moments = np.asarray(incidence @ of_edge.reshape(-1, 9)).reshape(-1, 3, 3)
    c_e = weight[:, None] * e
    rows, columns = np.concatenate([i, i]), np.concatenate([i, j])
    return moments, _alike([(np.concatenate([c, -c]), rows, columns) for c in c_e.T], len(V))


def _alike(entries: list[tuple[FloatArray, IntArray, IntArray]], n: int) -> list[sparse.csr_array]:
    # Converting from coordinates sums doubled entries and keeps those that cancel, so the patterns agree.
    matrices = [sparse.coo_array((values, (rows, columns)), shape=(n, n)).tocsr() for values, rows, columns in entries]
    for matrix in matrices:
        matrix.sort_indices()
    return matrices


def cross_matrices(u: FloatArray) -> FloatArray:
    """Return the matrices (k, 3, 3) that take d to u x d."""
    zero = np.zeros(len(u))
    x, y, z = u.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _symmetric_pseudo_inverse(A: FloatArray) -> FloatArray:
    # Negative cotangents can make the moment of a spoke cell singular; a direction without moment keeps w = 0.
    values, vectors = np.linalg.eigh(A)
    kept = np.abs(values) > 1e-12 * np.abs(values).max(axis=1, keepdims=True)
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=kept)
    return np.asarray((vectors * inverse[:, None, :]) @ vectors.transpose(0, 2, 1))


# The energies are summed from the residuals delta - w x e, not from the matrix: d^T Q d of a rigid motion cancels
# only to 1e-16 of its terms, the residuals vanish to 1e-16 each, and their squares to 1e-32.


def _spokes_and_rims_energy(V: FloatArray, F: IntArray, D: FloatArray) -> float:
    half = corner_cotangents(V, F) / 2
    e, delta = opposite_sides(V, F), opposite_sides(D, F)
    b_of_face = np.einsum("fk,fkx->fx", half, np.cross(e, delta))
    b = np.stack([np.bincount(F.ravel(), weights=np.repeat(x, 3), minlength=len(V)) for x in b_of_face.T], axis=1)
    w = np.linalg.solve(_rim_moments(V, F), b[:, :, None])[:, :, 0]
    total = 0.0
    for corner in range(3):  # the cells that the face belongs to
        misfit = delta - np.cross(w[F[:, corner], None, :], e)
        total += float(np.einsum("fk,fkx,fkx->", half, misfit, misfit))
    return 4 / 3 * total


def _spokes_energy(V: FloatArray, F: IntArray, D: FloatArray) -> float:
    L = laplacian(V, F)
    moments, _ = _spoke_moments(V, F, L)
    i, j, minus_weight = sparse.find(L)
    i, j, weight = i[i != j], j[i != j], -minus_weight[i != j]
    e, delta = V[i] - V[j], D[i] - D[j]
    torque = weight[:, None] * np.cross(e, delta)
    b = np.stack([np.bincount(i, weights=x, minlength=len(V)) for x in torque.T], axis=1)
    w = np.einsum("ixy,iy->ix", _symmetric_pseudo_inverse(moments), b)
    misfit = delta - np.cross(w[i], e)
    return 2 * float(np.einsum("k,kx,kx->", weight, misfit, misfit))


def _coordinates_of(vertices: IntArray) -> IntArray:
    return np.asarray((3 * vertices[:, None] + np.arange(3)).ravel())


def _require_form(form: str) -> None:
    require_choice("form", form, get_args(Form))
