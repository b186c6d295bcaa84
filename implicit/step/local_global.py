"""Minimise the energy of spokes and rims, some vertices held: rotations and positions in turn, accelerated.

    local    R_v = the best rotation of each cell of u
    global   L u = D^T ((C^T R) e_0) over the free vertices, held ones in their places, pulled ones at a price

L is factored once. The fixed-point iteration u -> G(u) of both is accelerated from the last WINDOW iterates [Anderson
1965; Peng, Deng, Zhang, Geng, Qin, Liu 2018]: where an accelerated iterate has more energy than the last, the plain one
takes its place, so that the energy never rises. A volume is held by moving each global solution along L^-1 dV/du until
it is met, by Newton's method: to first order that is the minimiser under the constraint.

Large motions are taken in stages along their path, a few iterations each. They make but a first guess: the energy is
always that of the rest shape, and nothing of the stages is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import splu

from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.planar_rigidity import EnclosedArea
from implicit.step.rotations import best_rotations
from implicit.step.spokes_and_rims import SpokesAndRims

WINDOW = 6

# To which the rotations are found in an iteration, in radians; the end has them to rounding.
ANGLE = 1e-6

# Iterations at each stage of the path but the last.
STAGE_ITERATIONS = 10

Report = Callable[[int, float, float], None]  # iteration, energy, largest move over the size


class MinimumStatus(Enum):
    """End of the iteration; the value is the sentence a user reads."""

    CONVERGED = "The last iteration moved no point by more than the tolerance."
    ITERATIONS_SPENT = "The points were still moving after the last iteration."
    NOT_FINITE = "An iteration gave positions that are not finite; the last good ones are kept."


@dataclass(frozen=True, eq=False)
class Minimum:
    """A deformation of least energy.

    Attributes:
        positions: Of the vertices (V, 3).
        rotations: Of the cells (V, 3, 3).
        energy: A squared length.
        iterations: How many were taken, those of the stages among them.
        largest_move: Of a vertex in the last iteration, over the size of the rest shape.
        volume_gap: How far the volume is from the one to hold, relative to that; 0 where none is.
        status: How it ended.
    """

    positions: FloatArray
    rotations: FloatArray
    energy: float
    iterations: int
    largest_move: float
    volume_gap: float
    status: MinimumStatus


@dataclass(frozen=True, eq=False)
class Hold:
    """Vertices that are held or pulled.

    Attributes:
        held: True for each vertex that is to be just where it is told (V,).
        pulls: Price of the squared distance of each vertex from its place, 0 where there is none (V,).
    """

    held: np.ndarray
    pulls: FloatArray


class LocalGlobal:
    """The iteration for one rest shape and one set of held vertices, for many places of these.

    Pieces of the mesh of which nothing is asked stay where they start.

    Args:
        energy: Of the deformation.
        hold: What is asked of which vertices.
        volume: What is held where a volume is; None takes that inside the mesh.
    """

    def __init__(self, energy: SpokesAndRims, hold: Hold, volume: EnclosedVolume | EnclosedArea | None = None) -> None:
        self._energy = energy
        self.volume = EnclosedVolume(energy.faces, len(energy.vertices)) if volume is None else volume
        self._size = float(np.ptp(energy.vertices, axis=0).max())
        asked = hold.held | (hold.pulls > 0)
        _, piece = csgraph.connected_components(abs(energy.laplacian), directed=False)
        self.untouched = ~np.isin(piece, np.unique(piece[asked]))
        self._held = hold.held | self.untouched
        self._free = np.flatnonzero(~self._held)
        self._pulls = hold.pulls
        system = energy.laplacian + sparse.diags_array(self._pulls)
        rows = sparse.csr_array(system)[self._free]
        self._to_held = sparse.csr_array(rows[:, np.flatnonzero(self._held)])
        self._factor = None
        if len(self._free):
            inner = sparse.csc_array(rows[:, self._free])
            self._factor = splu(
                inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )

    def minimum(
        self,
        places: Callable[[float], FloatArray],
        start: FloatArray,
        *,
        stages: int = 1,
        iterations: int = 400,
        tolerance: float = 1e-5,
        volume: float | None = None,
        report: Report | None = None,
    ) -> Minimum:
        """Return the deformation of least energy from a start.

        Args:
            places: From the fraction of the path to where the vertices are to be (V, 3); those of which nothing is
                asked may be anything.
            start: Positions of the vertices before the first stage (V, 3).
            stages: Parts of the path, the last of which ends at the goal.
            iterations: Most iterations at the goal.
            tolerance: Largest move of a vertex in an iteration, over the size, at which it has converged.
            volume: To hold; None holds none.
            report: Called after each iteration.
        """
        u, done = start, 0
        for stage in range(1, stages):
            run = _Run(self, start, places(stage / stages), volume, tolerance)
            u = run.take(u, STAGE_ITERATIONS, done, report).u
            done += run.taken
        run = _Run(self, start, places(1.0), volume, tolerance)
        end = run.take(u, iterations, done, report)
        gap = 0.0 if volume is None else abs(self.volume.value(end.u) / volume - 1)
        energy = self._energy.energy(end.u, end.rotations)
        return Minimum(end.u, end.rotations, energy, done + run.taken, end.move, gap, end.status)


@dataclass(frozen=True, eq=False)
class _End:
    u: FloatArray
    rotations: FloatArray
    move: float
    status: MinimumStatus


class _Run:
    """The iteration towards one set of places."""

    def __init__(
        self, solver: LocalGlobal, start: FloatArray, places: FloatArray, volume: float | None, tolerance: float
    ) -> None:
        self._solver, self._places, self._volume, self._tolerance = solver, places, volume, tolerance
        self._fixed = np.where(solver.untouched[:, None], start, places)[solver._held]
        self.taken = 0
        self._way: FloatArray | None = None  # along which the volume was last met

    def take(self, start: FloatArray, iterations: int, before: int, report: Report | None) -> _End:
        """Return where the iteration ends."""
        solver, energy = self._solver, self._solver._energy
        u = start.copy()
        u[solver._held] = self._fixed
        rotations = energy.rotations(u)
        if solver._factor is None:
            return _End(u, rotations, 0.0, MinimumStatus.CONVERGED)
        status, move = MinimumStatus.ITERATIONS_SPENT, np.inf
        mixer, plain, last = _Mixer(), u, np.inf
        for _ in range(iterations):
            covariances = energy.covariances(u)
            rotations = best_rotations(covariances, rotations, accuracy=ANGLE)
            now = self._cheap_energy(u, covariances, rotations)
            if now > last and u is not plain:  # the accelerated iterate is no better: the plain one
                u, last = plain, np.inf
                mixer = _Mixer()
                continue
            moved = self._global(u, rotations)
            if not np.isfinite(moved).all():
                status = MinimumStatus.NOT_FINITE
                break
            self.taken += 1
            move = float(np.sqrt(((moved - u) ** 2).sum(axis=1).max())) / solver._size
            if report is not None:
                report(before + self.taken, now, move)
            last = now
            if move <= self._tolerance:
                u, status = moved, MinimumStatus.CONVERGED
                break
            plain = moved
            free = solver._free
            mixed = mixer.mixed(u[free].ravel(), moved[free].ravel())
            u = moved.copy()
            u[free] = mixed.reshape(-1, 3)
            if self._way is not None and self._volume is not None:
                u = solver.volume.reached(u, self._way, self._volume)
        else:
            u = plain
        return _End(u, energy.rotations(u, rotations), move, status)

    def _cheap_energy(self, u: FloatArray, covariances: FloatArray, rotations: FloatArray) -> float:
        """Return the energy, up to a constant, with the price of the pulls; what cancels costs digits near zero."""
        solver = self._solver
        fitted = np.einsum("nij,nji->", rotations, covariances)
        stretched = np.einsum("ni,ni->", u, solver._energy.laplacian @ u)
        pulled = solver._pulls @ ((u - self._places) ** 2).sum(axis=1)
        return float(stretched - 2 * fitted + pulled)

    def _global(self, u: FloatArray, rotations: FloatArray) -> FloatArray:
        """Return the positions of least energy for given rotations, at the volume to hold."""
        solver = self._solver
        assert solver._factor is not None
        wanted = solver._energy.right_hand_side(rotations) + solver._pulls[:, None] * self._places
        moved = u.copy()
        moved[solver._free] = solver._factor.solve(wanted[solver._free] - solver._to_held @ self._fixed)
        return moved if self._volume is None else self._at_volume(moved, u)

    def _at_volume(self, u: FloatArray, before: FloatArray) -> FloatArray:
        """Return the positions moved to the volume to hold, along L^-1 dV/du of the iterate before.

        Where the iteration comes to rest both are the same, and the multiplier of dV/du that of the minimum.
        """
        solver = self._solver
        assert solver._factor is not None
        assert self._volume is not None
        self._way = np.zeros_like(u)
        self._way[solver._free] = solver._factor.solve(solver.volume.gradient(before)[solver._free])
        return solver.volume.reached(u, self._way, self._volume)


class _Mixer:
    """Anderson's acceleration of a fixed-point iteration."""

    def __init__(self) -> None:
        self._residuals: list[FloatArray] = []
        self._images: list[FloatArray] = []

    def mixed(self, x: FloatArray, image: FloatArray) -> FloatArray:
        """Return the combination of the last images whose residuals, so combined, are least.

        Args:
            x: The iterate.
            image: G of it.
        """
        self._residuals = [*self._residuals[-WINDOW:], image - x]
        self._images = [*self._images[-WINDOW:], image]
        if len(self._images) == 1:
            return image
        changes = np.stack([b - a for a, b in zip(self._residuals, self._residuals[1:], strict=False)])
        gram = changes @ changes.T
        gram += 1e-12 * np.trace(gram) * np.eye(len(gram))
        shares = np.linalg.solve(gram, changes @ self._residuals[-1])
        steps = np.stack([b - a for a, b in zip(self._images, self._images[1:], strict=False)])
        return np.asarray(image - shares @ steps)
