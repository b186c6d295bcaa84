"""As-rigid-as-possible deformation: handles go where they are told, the rest turns and bends as little as it can.

    E(U) = sum over cells of  min over rotations R of  sum over their half-edges  c |(u_j - u_k) - R (x_j - x_k)|^2

"Spokes and rims": the cell of a vertex is all edges of the faces round it, c half the cotangent opposite. For a small
displacement d, E(V + d) tends to 3/4 of the Killing energy of d in the form of that name.
Source: Sorkine and Alexa 2007; Chao, Pinkall, Sanan, Schroeder 2010 (rims). The iteration is libigl's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from time import perf_counter
from types import MappingProxyType
from typing import NamedTuple

import igl
import numpy as np
from numpy.typing import ArrayLike

from meshref.check import (
    check_mesh,
    handle_vectors,
    require_handle_on_each_part,
    require_positive,
    require_whole,
    vertex_field,
    vertex_indices,
)
from meshref.curvature import corner_cotangents
from meshref.measures import opposite_sides
from meshref.printing import brief
from meshref.topology import FloatArray, IntArray


def arap(
    V: ArrayLike,
    F: ArrayLike,
    handles: ArrayLike,
    targets: ArrayLike,
    *,
    start: ArrayLike | None = None,
    iterations: int = 200,
    tolerance: float = 1e-5,
    energy_every: int = 10,
    progress: Callable[[int, int], None] | None = None,
) -> ArapResult:
    """Deform a mesh as rigidly as possible.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        handles: Numbers of the vertices with a prescribed place, (h,), each once.
        targets: Their places, (h, 3), positions, not displacements.
        start, iterations, tolerance, energy_every, progress: See ArapSolver.run.

    Raises:
        MeshError: See ArapSolver.
    """
    solver = ArapSolver(V, F, handles)
    return solver.run(
        targets, start=start, iterations=iterations, tolerance=tolerance, energy_every=energy_every, progress=progress
    )


class ArapStatus(Enum):
    """End of an iteration; the value is the sentence a user reads."""

    CONVERGED = "The last iteration moved no vertex by more than the tolerance."
    ITERATIONS_SPENT = "The vertices were still moving after the last iteration; allow more of them."
    NOT_FINITE = "An iteration gave coordinates that are not finite; the last good ones are returned."


class ArapStep(NamedTuple):
    """One row of the history."""

    iteration: int
    energy: float  # squared length
    step: float  # largest move of a vertex in this iteration, over the size of the mesh
    seconds: float  # since the start of the solve


@dataclass(frozen=True, eq=False)
class ArapResult:
    """A deformed mesh, its energy, and the history of the iteration."""

    V: FloatArray  # (n, 3), deformed vertices
    energy: float  # spokes and rims, squared length
    history: tuple[ArapStep, ...]  # the start, every energy_every-th iteration, and the end
    iterations: int
    status: ArapStatus
    seconds: Mapping[str, float]  # "factorisation", "start", "iterations"; the energies of the history not counted

    __repr__ = brief


class ArapSolver:
    """The factorised Laplacian of one mesh with one set of handle vertices, for many targets."""

    def __init__(self, V: ArrayLike, F: ArrayLike, handle_vertices: ArrayLike) -> None:
        """Factorise.

        Args:
            V: Vertices, (n, 3).
            F: Faces, (m, 3).
            handle_vertices: Numbers of the vertices that will have a prescribed place, (h,), each once, at least one
                on every connected part. Fewer than three leave the part free to turn; it then turns as little as
                the start says.

        Raises:
            MeshError: check_mesh refuses the mesh; handles are unknown or doubled, or a part has none.
        """
        begin = perf_counter()
        self._V, self._F = check_mesh(V, F)
        self.handle_vertices = vertex_indices(handle_vertices, len(self._V), "handle_vertices")
        require_handle_on_each_part(self._V, self._F, self.handle_vertices)
        # libigl fits its rotations in single precision: coordinates of order 1 about the origin lose least.
        self._middle = self._V.mean(axis=0)
        self._size = float(np.linalg.norm(self._V.max(axis=0) - self._V.min(axis=0)))
        self._rest = (self._V - self._middle) / self._size
        self._all_fixed = len(self.handle_vertices) == len(self._V)
        self._data = igl.ARAPData()
        self._data.energy = igl.ARAP_ENERGY_TYPE_SPOKES_AND_RIMS
        self._data.max_iter = 1
        if not self._all_fixed:
            igl.arap_precomputation(self._rest, self._F, 3, self.handle_vertices, self._data)
        self.seconds = MappingProxyType({"factorisation": perf_counter() - begin})

    def solve(
        self, targets: ArrayLike, *, start: ArrayLike | None = None, iterations: int = 200, tolerance: float = 1e-5
    ) -> FloatArray:
        """Return deformed vertices (n, 3) for places of the handle vertices, (h, 3); see run."""
        return self.run(targets, start=start, iterations=iterations, tolerance=tolerance).V

    def run(
        self,
        targets: ArrayLike,
        *,
        start: ArrayLike | None = None,
        iterations: int = 200,
        tolerance: float = 1e-5,
        energy_every: int = 10,
        progress: Callable[[int, int], None] | None = None,
    ) -> ArapResult:
        """Iterate until no vertex moves any more, with the evidence.

        Args:
            targets: Places of the handle vertices, (h, 3).
            start: First guess, (n, 3); None takes rigid_start.
            iterations: Most iterations to do.
            tolerance: Stop when no vertex moves by more than this part of the mesh's size (the diagonal of its box).
                Single-precision rotations leave a floor of about 1e-6.
            energy_every: Iterations between rows of the history; an energy costs as much as five iterations.
            progress: Called with (iterations done, most iterations) after each.

        Raises:
            MeshError: The targets do not fit the handles, or an option is not positive.
        """
        wanted = handle_vectors(targets, self.handle_vertices, "targets")
        require_whole("iterations", iterations)
        require_whole("energy_every", energy_every)
        require_positive("tolerance", tolerance)
        begin = perf_counter()
        first = self.rigid_start(wanted) if start is None else vertex_field(start, self._V, "start").copy()
        first[self.handle_vertices] = wanted
        started = perf_counter()
        U, goal = (first - self._middle) / self._size, (wanted - self._middle) / self._size
        history = [ArapStep(0, self.energy(first), 0.0, started - begin)]
        status, done, spent = ArapStatus.ITERATIONS_SPENT, 0, 0.0
        if self._all_fixed:
            status = ArapStatus.CONVERGED
            iterations = 0
        for done in range(1, iterations + 1):
            tick = perf_counter()
            moved = np.asarray(igl.arap_solve(goal, self._data, U))
            spent += perf_counter() - tick
            if not np.isfinite(moved).all():
                status, done = ArapStatus.NOT_FINITE, done - 1
                break
            step = float(np.sqrt(((moved - U) ** 2).sum(axis=1).max()))
            U = moved
            if step <= tolerance:
                status = ArapStatus.CONVERGED
            if done % energy_every == 0 or done == iterations or status is ArapStatus.CONVERGED:
                history.append(ArapStep(done, self.energy(self._placed(U, wanted)), step, started - begin + spent))
            if progress is not None:
                progress(done, iterations)
            if status is ArapStatus.CONVERGED:
                break
        result = self._placed(U, wanted)
        return ArapResult(
            V=result,
            energy=self.energy(result),
            history=tuple(history),
            iterations=done,
            status=status,
            seconds=MappingProxyType({**self.seconds, "start": started - begin, "iterations": spent}),
        )

    def energy(self, U: ArrayLike) -> float:
        """Return the energy of deformed vertices U (n, 3), a squared length."""
        return _energy(self._V, self._F, vertex_field(U, self._V, "U"))

    def rigid_start(self, targets: ArrayLike) -> FloatArray:
        """Return the rigid motion that fits the handles best, plus a biharmonic blend of what it leaves, (n, 3).

        From a biharmonic start alone, 30 iterations leave an error of 2e-2 after a turn by 175 degrees.
        """
        wanted = handle_vectors(targets, self.handle_vertices, "targets")
        rotation, translation = rigid_fit(self._V[self.handle_vertices], wanted)
        moved = self._V @ rotation.T + translation
        left = wanted - moved[self.handle_vertices]
        if self._all_fixed or np.abs(left).max() <= 1e-12 * self._size:
            moved[self.handle_vertices] = wanted
            return moved
        blend = np.asarray(igl.harmonic(self._rest, self._F, self.handle_vertices, left, 2))
        return moved + blend if np.isfinite(blend).all() else moved

    def _placed(self, U: FloatArray, wanted: FloatArray) -> FloatArray:
        placed = np.asarray(U * self._size + self._middle)
        placed[self.handle_vertices] = wanted
        return placed


def arap_energy(V: ArrayLike, F: ArrayLike, U: ArrayLike) -> float:
    """Return the as-rigid-as-possible energy of moving the vertices from V to U, a squared length; 0 for rigid motions.

    Args:
        V: Vertices at rest, (n, 3).
        F: Faces, (m, 3).
        U: Deformed vertices, (n, 3).

    Raises:
        MeshError: check_mesh refuses the mesh at rest, or U does not fit it.
    """
    V, F = check_mesh(V, F)
    return _energy(V, F, vertex_field(U, V, "U"))


def rigid_fit(P: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation (3, 3) and translation (3,) that bring P @ rotation.T + translation closest to Q.

    Where the points leave a turn open (a single point, or points on a line), the smallest turn is taken.
    Source: Kabsch 1976.
    """
    from_middle, to_middle = P.mean(axis=0), Q.mean(axis=0)
    covariance = (Q - to_middle).T @ (P - from_middle)
    values = np.linalg.svd(covariance, compute_uv=False)
    if values[1] <= 1e-9 * values[0] or values[0] == 0:
        if values[0] == 0:
            return np.eye(3), to_middle - from_middle
        # Rank one: turn the one direction that is known onto its image by the shortest way.
        left, _, right = np.linalg.svd(covariance)
        rotation = _shortest_turn(right[0], left[:, 0])
        return rotation, to_middle - rotation @ from_middle
    rotation = _nearest_rotations(covariance[None])[0]
    return rotation, to_middle - rotation @ from_middle


def _shortest_turn(a: FloatArray, b: FloatArray) -> FloatArray:
    # Two mirror images, in the plane normal to a, then in the plane that halves the way from -a to b.
    cosine = float(a @ b)
    if cosine < -1 + 1e-12:
        other = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        other /= np.linalg.norm(other)
        return np.asarray(2 * np.outer(other, other) - np.eye(3))
    half = a + b
    return np.asarray(np.eye(3) - np.outer(half, half) / (1 + cosine) + 2 * np.outer(b, a))


def _nearest_rotations(S: FloatArray) -> FloatArray:
    """Return the rotations R (k, 3, 3) that maximise trace(R^T S) for matrices S (k, 3, 3)."""
    left, _, right = np.linalg.svd(S)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


def _energy(V: FloatArray, F: IntArray, U: FloatArray) -> float:
    half = corner_cotangents(V, F) / 2
    at_rest, deformed = opposite_sides(V, F), opposite_sides(U, F)
    covariance = np.einsum("fk,fkx,fky->fxy", half, deformed, at_rest).reshape(-1, 9)
    summed = [np.bincount(F.ravel(), weights=np.repeat(x, 3), minlength=len(V)) for x in covariance.T]
    R = _nearest_rotations(np.stack(summed, axis=1, dtype=np.float64).reshape(-1, 3, 3))
    total = 0.0
    for corner in range(3):  # the cells that the face belongs to
        misfit = deformed - np.einsum("fxy,fky->fkx", R[F[:, corner]], at_rest)
        total += float(np.einsum("fk,fkx,fkx->", half, misfit, misfit))
    return total
