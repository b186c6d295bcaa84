"""As-rigid-as-possible deformation: handles go where they are told, the rest turns and bends as little as it can.

    E(U) = sum over cells of  min over rotations R of  sum over their half-edges  c |(u_j - u_k) - R (x_j - x_k)|^2

"Spokes and rims": the cell of a vertex is all edges of the faces round it, c half the cotangent opposite. For a small
displacement d, E(V + d) tends to 3/4 of the Killing energy of d in the form of that name. Rotations and places are
found in turn, with K and L sparse matrices of the shape at rest:

    local     R_v = the rotation nearest to (K u)_v         (K u)_v = sum over the cell  c (u_j - u_k) (x_j - x_k)^T
    global    L u = K^T R over the vertices that are free   L three times the cotangent Laplacian, factored once

Each such iteration lowers E, but slowly where something thin bends or where the mesh is fine. It is a step along the
gradient preconditioned by L, from which quasi-Newton steps are learned that need a tenth of the iterations; each of
them, too, has to lower E, or is made shorter.
Sources: Sorkine and Alexa 2007; Chao, Pinkall, Sanan, Schroeder 2010 (rims); Liu, Bouaziz, Kavan 2017 (quasi-Newton).
The energy and the plain iteration are libigl's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from time import perf_counter
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import igl
import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from meshref.biharmonic import biharmonic
from meshref.check import (
    MeshError,
    check_mesh,
    handle_vectors,
    require_choice,
    require_handle_on_each_part,
    require_positive,
    require_whole,
    vertex_field,
    vertex_indices,
)
from meshref.curvature import corner_cotangents, laplacian
from meshref.factor import NotPositiveDefiniteError, Solver, factorise
from meshref.measures import lumped_areas, opposite_sides
from meshref.printing import brief
from meshref.quasi_newton import QuasiNewton
from meshref.rotations import nearest_rotations, rigid_fit
from meshref.springs import spring_weights
from meshref.topology import FloatArray, IntArray

Minimiser = Literal["quasi-newton", "libigl"]

# Steps that are learned from, and the angle in radians to which an iteration finds its rotations.
WINDOW = 8
ANGLE = 1e-7

# A step has to gain this part of what its slope promises; one that is halved so often is replaced by a plain one.
GAIN = 1e-4
HALVINGS = 10

# Iterations for each place on the way but the last: they make a first guess and nothing else.
STAGE_ITERATIONS = 10

# Part of the energy's largest term within which two energies are the same, for rounding.
ROUNDING = 1e-14


def arap(
    V: ArrayLike,
    F: ArrayLike,
    handles: ArrayLike,
    targets: ArrayLike,
    *,
    penalty: float | None = None,
    minimiser: Minimiser = "quasi-newton",
    start: ArrayLike | None = None,
    way: Sequence[ArrayLike] = (),
    iterations: int = 2000,
    tolerance: float = 1e-6,
    energy_every: int = 10,
    progress: Callable[[int, int], None] | None = None,
) -> ArapResult:
    """Deform a mesh as rigidly as possible.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        handles: Numbers of the vertices with a prescribed place, (h,), each once.
        targets: Their places, (h, 3), positions, not displacements.
        penalty, minimiser: See ArapSolver.
        start, way, iterations, tolerance, energy_every, progress: See ArapSolver.run.

    Raises:
        MeshError: See ArapSolver.
    """
    prepared = ArapSolver(V, F, handles, penalty=penalty, minimiser=minimiser)
    return prepared.run(
        targets,
        start=start,
        way=way,
        iterations=iterations,
        tolerance=tolerance,
        energy_every=energy_every,
        progress=progress,
    )


class ArapStatus(Enum):
    """End of an iteration; the value is the sentence a user reads."""

    CONVERGED = "The last iteration moved no vertex by more than the tolerance."
    ITERATIONS_SPENT = (
        "The vertices were still moving after the last iteration. Raise iterations of arap, or take way= for large "
        "turns."
    )
    NOT_FINITE = "An iteration gave coordinates that are not finite; the last good ones are returned."


class ArapStep(NamedTuple):
    """One row of the history."""

    iteration: int
    energy: float  # squared length, with the springs, if there are any
    step: float  # largest move of a vertex by a plain iteration from the one before, over the size of the mesh
    seconds: float  # since the start of the solve


@dataclass(frozen=True, eq=False)
class ArapResult:
    """A deformed mesh, its energy, how far it is from the minimum, and the history of the iteration."""

    V: FloatArray  # (n, 3), deformed vertices
    energy: float  # spokes and rims, squared length, without springs
    handle_error: float  # largest distance of a handle from where it was sent; 0 without a penalty
    residual: float  # largest move of a vertex by the last iteration, a plain one, over the size of the mesh
    energy_change: float  # by which the last iteration lowered what is minimised, relative
    history: tuple[ArapStep, ...]  # the start, every energy_every-th iteration, and the end
    iterations: int  # those on the way among them
    status: ArapStatus
    seconds: Mapping[str, float]  # "factorisation", "start", "iterations"

    __repr__ = brief

    @property
    def converged(self) -> bool:
        """True if the last iteration moved no vertex by more than the tolerance."""
        return self.status is ArapStatus.CONVERGED


class ArapSolver:
    """The factorised Laplacian of one mesh with one set of handle vertices, for many targets."""

    def __init__(
        self,
        V: ArrayLike,
        F: ArrayLike,
        handle_vertices: ArrayLike,
        *,
        penalty: float | None = None,
        handle_weights: ArrayLike | None = None,
        minimiser: Minimiser = "quasi-newton",
        solver: Solver = "auto",
    ) -> None:
        """Factorise.

        Args:
            V: Vertices, (n, 3).
            F: Faces, (m, 3).
            handle_vertices: Numbers of the vertices that will have a prescribed place, (h,), each once, at least one
                on every connected part. Fewer than three leave the part free to turn; it then turns as little as
                the start says.
            penalty: None puts the handles exactly where they are sent. A number, per squared length, holds each by a
                spring: it adds that times the integral of the squared distance from there over the handles.
            handle_weights: With a penalty, the weight of the squared distance of each handle, (h,), positive; None is
                the area that belongs to it.
            minimiser: "quasi-newton", or "libigl" for libigl's own iteration, whose steps are all plain and whose
                rotations are found in single precision; it takes no penalty.
            solver: Library that factorises, see factorise.

        Raises:
            MeshError: check_mesh refuses the mesh; handles are unknown or doubled, or a part has none; or an option
                is none of those above.
        """
        begin = perf_counter()
        self._V, self._F = check_mesh(V, F)
        require_choice("minimiser", minimiser, get_args(Minimiser))
        if penalty is not None:
            require_positive("penalty", penalty)
            if minimiser == "libigl":
                raise MeshError("a penalty must go with minimiser='quasi-newton', for 'libigl' moves handles exactly.")
        elif handle_weights is not None:
            raise MeshError("handle_weights must go with a penalty; without one, handles are moved exactly.")
        self.handle_vertices = vertex_indices(handle_vertices, len(self._V), "handle_vertices")
        # Coordinates of order 1 about the origin lose least to rounding.
        self._middle = self._V.mean(axis=0)
        self._size = float(np.linalg.norm(self._V.max(axis=0) - self._V.min(axis=0)))
        self._rest = (self._V - self._middle) / self._size
        require_handle_on_each_part(self._V, self._F, self.handle_vertices)
        self.penalty, self.minimiser = penalty, minimiser
        self._springs, held = np.zeros(len(self._V)), self.handle_vertices
        if penalty is not None:
            areas = lumped_areas(self._V, self._F)
            # The energy is a squared length as what they weigh, so that the unit of length does not matter.
            self._springs[held] = penalty * spring_weights(held, areas, handle_weights)
            held = held[:0]
        self._held = held
        self._free = np.setdiff1d(np.arange(len(self._V)), held)
        self._igl = self._factor = None
        if minimiser == "libigl":
            self._igl = _libigl(self._rest, self._F, held) if self._free.size else None
        else:
            self._K, self._L = _cell_matrices(self._rest, self._F)
            self._K_transposed = sparse.csr_array(self._K.T)
            self._constant = float((self._rest * (self._L @ self._rest)).sum())
            system = sparse.csr_array(self._L + sparse.diags_array(self._springs))[self._free]
            if self._free.size:
                # Dirichlet's energy is positive on all that is zero somewhere on every part.
                self._factor = factorise(sparse.csc_array(system[:, self._free]), solver, surely_definite=True)
        self.seconds = MappingProxyType({"factorisation": perf_counter() - begin})

    def solve(
        self, targets: ArrayLike, *, start: ArrayLike | None = None, iterations: int = 2000, tolerance: float = 1e-6
    ) -> FloatArray:
        """Return deformed vertices (n, 3) for places of the handle vertices, (h, 3); see run."""
        return self.run(targets, start=start, iterations=iterations, tolerance=tolerance).V

    def run(
        self,
        targets: ArrayLike,
        *,
        start: ArrayLike | None = None,
        way: Sequence[ArrayLike] = (),
        iterations: int = 2000,
        tolerance: float = 1e-6,
        energy_every: int = 10,
        progress: Callable[[int, int], None] | None = None,
    ) -> ArapResult:
        """Iterate until no vertex moves any more, with the evidence.

        Args:
            targets: Places of the handle vertices, (h, 3).
            start: First guess, (n, 3); None takes rigid_start, or with a way the mesh at rest.
            way: Places of the handle vertices, (h, 3) each, that they pass before: ten iterations each lead large turns
                to the minimum near their path. Nothing else is kept of them, for the energy is that from the rest.
            iterations: Most iterations to do at the targets.
            tolerance: Stop when no vertex moves by more than this part of the mesh's size (the diagonal of its box).
                libigl's rotations leave a floor of about 1e-6.
            energy_every: Iterations between rows of the history.
            progress: Called with (iterations done at the targets, most iterations) after each.

        Raises:
            MeshError: The targets do not fit the handles, or an option is not positive.
        """
        wanted = handle_vectors(targets, self.handle_vertices, "targets")
        passed = [handle_vectors(at, self.handle_vertices, f"way[{k}]") for k, at in enumerate(way)]
        require_whole("iterations", iterations)
        require_whole("energy_every", energy_every)
        require_positive("tolerance", tolerance)
        begin = perf_counter()
        if start is not None:
            first = vertex_field(start, self._V, "start").copy()
        else:
            first = self._V.copy() if passed else self.rigid_start(wanted)
        u = (first - self._middle) / self._size
        on_the_way = 0
        started = perf_counter()
        for at in passed if self._free.size else ():
            course = _Course(self, at)
            u = course.take(u, STAGE_ITERATIONS, tolerance)
            on_the_way += course.done
        course = _Course(self, wanted, energy_every=energy_every, progress=progress, begin=begin)
        u = course.take(u, iterations, tolerance)
        result = self._placed(u, wanted)
        energy = self.energy(result)
        if self.penalty is None:  # without what cancels in those of the iteration
            course.history[-1] = course.history[-1]._replace(energy=energy)
        missed = result[self.handle_vertices] - wanted
        return ArapResult(
            V=result,
            energy=energy,
            handle_error=float(np.linalg.norm(missed, axis=1).max()),
            residual=course.step,
            energy_change=course.energy_change,
            history=tuple(course.history),
            iterations=on_the_way + course.done,
            status=course.status,
            seconds=MappingProxyType(
                {**self.seconds, "start": started - begin, "iterations": perf_counter() - started}
            ),
        )

    def energy(self, U: ArrayLike) -> float:
        """Return the energy of deformed vertices U (n, 3), a squared length."""
        return _energy(self._V, self._F, vertex_field(U, self._V, "U"))

    def rigid_start(self, targets: ArrayLike) -> FloatArray:
        """Return the rigid motion that fits the handles best, plus a biharmonic blend of what it leaves, (n, 3).

        From a biharmonic start alone, 30 plain iterations leave an error of 2e-2 after a turn by 175 degrees.
        """
        wanted = handle_vectors(targets, self.handle_vertices, "targets")
        rotation, translation = rigid_fit(self._V[self.handle_vertices], wanted)
        moved = self._V @ rotation.T + translation
        left = wanted - moved[self.handle_vertices]
        if len(self.handle_vertices) == len(self._V) or np.abs(left).max() <= 1e-12 * self._size:
            moved[self.handle_vertices] = wanted
            return moved
        try:
            blend = biharmonic(self._rest, self._F, self.handle_vertices, left).displacement
        except NotPositiveDefiniteError:  # lost in rounding, on very uneven triangles
            return moved
        return moved + blend if np.isfinite(blend).all() else moved

    def _placed(self, u: FloatArray, wanted: FloatArray) -> FloatArray:
        placed = np.asarray(u * self._size + self._middle)
        if self.penalty is None:
            placed[self.handle_vertices] = wanted
        return placed


class _State(NamedTuple):
    """A place in the iteration, all over the size of the mesh."""

    u: FloatArray  # (n, 3)
    rotations: FloatArray  # of the cells (n, 3, 3), transposed
    energy: float  # that is minimised
    rounding: float  # of it
    gradient: FloatArray  # half of it, at the free vertices (f, 3)
    plain: FloatArray  # the move of a plain iteration (f, 3)

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.energy) and np.isfinite(self.plain).all())


class _Course:
    """The iteration towards one set of places, in coordinates of size 1 about the origin."""

    def __init__(
        self,
        solver: ArapSolver,
        wanted: FloatArray,
        *,
        energy_every: int = 0,
        progress: Callable[[int, int], None] | None = None,
        begin: float = 0.0,
    ) -> None:
        self._solver = solver
        self._goal = np.zeros_like(solver._V)
        self._goal[solver.handle_vertices] = (wanted - solver._middle) / solver._size
        self._energy_every, self._progress, self._begin = energy_every, progress, begin
        self.done = 0
        self.step = 0.0
        self.energy_change = 0.0
        self.history: list[ArapStep] = []
        self.status = ArapStatus.ITERATIONS_SPENT

    def take(self, u: FloatArray, iterations: int, tolerance: float) -> FloatArray:
        """Return where the iteration ends that starts at u (n, 3)."""
        solver = self._solver
        u = u.copy()
        u[solver._held] = self._goal[solver._held]
        if not solver._free.size:
            self.status = ArapStatus.CONVERGED
            self._note(self._exact_energy(u), last=True)
            return u
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite has a status
            if solver._igl is not None:
                return self._by_libigl(u, iterations, tolerance)
            return self._quasi_newton(u, iterations, tolerance)

    def _quasi_newton(self, u: FloatArray, iterations: int, tolerance: float) -> FloatArray:
        memory, at = QuasiNewton(WINDOW), self._state(u, None)
        self._note(at.energy)
        while at.finite:
            # The last iteration is a plain one, so that what it moves is what libigl's would.
            ended = self._ended(at.plain, iterations, tolerance)
            after = self._moved(at, at.plain) if ended else self._step(at, memory)
            if ended and after.finite:
                self.energy_change = max(at.energy - after.energy, 0.0) / max(after.energy, after.rounding)
                self._note(after.energy, last=True)
                return after.u
            if after.finite:
                self._note(after.energy)
            u, at = at.u, after
        self.status = ArapStatus.NOT_FINITE
        return u

    def _step(self, at: _State, memory: QuasiNewton) -> _State:
        """Return where a quasi-Newton step leads, halved until it gains enough."""
        direction = memory.direction(at.gradient, -at.plain)
        slope = 2 * float(np.vdot(at.gradient, direction))
        for halvings in range(HALVINGS):
            way = direction / 2**halvings
            after = self._moved(at, way)
            if after.energy <= at.energy + GAIN * slope / 2**halvings + at.rounding:
                memory.learn(way, after.gradient - at.gradient, at.plain - after.plain)
                return after
        memory.forget()
        return self._moved(at, at.plain)

    def _moved(self, at: _State, way: FloatArray) -> _State:
        u = at.u.copy()
        u[self._solver._free] += way
        return self._state(u, at.rotations)

    def _by_libigl(self, u: FloatArray, iterations: int, tolerance: float) -> FloatArray:
        solver = self._solver
        self._note(self._exact_energy(u))
        while True:
            moved = np.asarray(igl.arap_solve(self._goal[solver._held], solver._igl, u))
            if not np.isfinite(moved).all():
                self.status = ArapStatus.NOT_FINITE
                return u
            if self._ended(moved - u, iterations, tolerance):
                energy, after = self._exact_energy(u), self._exact_energy(moved)
                self.energy_change = max(energy - after, 0.0) / max(after, np.finfo(float).tiny)
                self._note(after, last=True)
                return moved
            u = moved
            if self._due:
                self._note(self._exact_energy(u))

    def _state(self, u: FloatArray, start: FloatArray | None) -> _State:
        """Return what there is to know at u (n, 3), with rotations sought from a start."""
        solver, springs = self._solver, self._solver._springs
        assert solver._factor is not None
        covariances = (solver._K @ u).reshape(-1, 3, 3)
        if not np.isfinite(covariances).all():
            return _State(u, covariances, np.inf, 0.0, u, u)
        rotations = nearest_rotations(covariances, start, accuracy=ANGLE)
        spread, pulled = solver._L @ u, u - self._goal
        stretched, fitted = float(np.vdot(u, spread)), float(np.vdot(rotations, covariances))
        energy = max(stretched - 2 * fitted + solver._constant, 0.0) + float(springs @ (pulled**2).sum(axis=1))
        gradient = spread - solver._K_transposed @ rotations.reshape(-1, 3) + springs[:, None] * pulled
        gradient = gradient[solver._free]
        plain = -solver._factor.solve(gradient)
        return _State(u, rotations, energy, ROUNDING * (stretched + solver._constant), gradient, plain)

    def _exact_energy(self, u: FloatArray) -> float:
        return _energy(self._solver._rest, self._solver._F, u)

    def _ended(self, move: FloatArray, iterations: int, tolerance: float) -> bool:
        """Count an iteration, and return True if it is the last: a plain one would move vertices so far (k, 3)."""
        self.done += 1
        self.step = float(np.sqrt((move**2).sum(axis=1).max()))
        if self._progress is not None:
            self._progress(self.done, iterations)
        if self.step <= tolerance:
            self.status = ArapStatus.CONVERGED
            return True
        return self.done >= iterations

    @property
    def _due(self) -> bool:
        return self._energy_every > 0 and self.done % self._energy_every == 0

    def _note(self, energy: float, *, last: bool = False) -> None:
        """Write a row of the history with the energy after the iterations done, where one is due."""
        if last or self._due:
            squared = energy * self._solver._size**2
            self.history.append(ArapStep(self.done, squared, self.step, perf_counter() - self._begin))


def _cell_matrices(V: FloatArray, F: IntArray) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Return K (3n, n) and L (n, n): (K u)[3 v + y, x] = sum over the cell of v of c (u_j - u_k)_x (x_j - x_k)_y."""
    n, half = len(V), corner_cotangents(V, F) / 2
    weighted = half[:, :, None] * opposite_sides(V, F)  # of the half-edge opposite to each corner
    # It runs from corner k + 1 to corner k + 2 and lies in the cells of all three corners of the face.
    end, begin = (np.roll(F, -shift, axis=1)[:, :, None] for shift in (2, 1))
    cell = np.broadcast_to(F[:, None, :], (len(F), 3, 3))
    row = 3 * cell[..., None] + np.arange(3)
    entries = np.broadcast_to(weighted[:, :, None, :], row.shape)
    at_end, at_begin = (np.broadcast_to(column[..., None], row.shape) for column in (end, begin))
    rows, columns = np.stack([row, row]).ravel(), np.stack([at_end, at_begin]).ravel()
    K = sparse.csr_array((np.stack([entries, -entries]).ravel(), (rows, columns)), shape=(3 * n, n))
    return K, sparse.csr_array(3 * laplacian(V, F))


def _libigl(V: FloatArray, F: IntArray, held: IntArray) -> igl.ARAPData:
    data = igl.ARAPData()
    data.energy = igl.ARAP_ENERGY_TYPE_SPOKES_AND_RIMS
    data.max_iter = 1
    igl.arap_precomputation(V, F, 3, held, data)
    return data


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


def _energy(V: FloatArray, F: IntArray, U: FloatArray) -> float:
    half = corner_cotangents(V, F) / 2
    at_rest, deformed = opposite_sides(V, F), opposite_sides(U, F)
    covariance = np.einsum("fk,fkx,fky->fxy", half, deformed, at_rest).reshape(-1, 9)
    summed = [np.bincount(F.ravel(), weights=np.repeat(x, 3), minlength=len(V)) for x in covariance.T]
    R = nearest_rotations(np.stack(summed, axis=1, dtype=np.float64).reshape(-1, 3, 3))
    total = 0.0
    for corner in range(3):  # the cells that the face belongs to
        misfit = deformed - np.einsum("fxy,fky->fkx", R[F[:, corner]], at_rest)
        total += float(np.einsum("fk,fkx,fkx->", half, misfit, misfit))
    return total
