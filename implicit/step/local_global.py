"""Minimise the energy of spokes and rims, some vertices held: rotations and positions in turn, and what they teach.

    local    R_v = the best rotation of each cell of u
    global   L u = D^T ((C^T R) e_0) over the free vertices, held ones in their places, pulled ones at a price

L is factored once. One such iteration is a step -L^-1 g along the gradient g of the energy; from the steps taken the
inverse of the Hessian is learned beyond L^-1 (implicit.step.preconditioned), and a step is halved until it lowers the
energy. Against iterations mixed from the last ones [Anderson 1965], which rest where these happen to stand still, a
cactus bent by 90 degrees takes two thirds of the time, ends 0.1 % lower where those found a saddle, and comes back to
the same energy to 1e-6 when its points are shaken by 1 % of its size.

A volume V is held by the multiplier l that makes g - l dV/du least in the metric of L^-1, and by Newton's method back
to V along L^-1 dV/du after each step: to first order that is the minimiser under the constraint.

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
from implicit.step.preconditioned import Descent
from implicit.step.rotations import best_rotations
from implicit.step.spokes_and_rims import SpokesAndRims

# Steps that are learned from.
WINDOW = 8

# To which the rotations are found in an iteration, in radians; the end has them to rounding.
ANGLE = 1e-6

# A step has to gain this part of what its slope promises, and is halved so often until it does.
GAIN = 1e-4
HALVINGS = 10

# Part of the energy's largest term within which two energies are the same, for rounding.
ROUNDING = 1e-14

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
        self.constant = float(np.vdot(energy.vertices, energy.laplacian @ energy.vertices))
        system = energy.laplacian + sparse.diags_array(self._pulls)
        rows = sparse.csr_array(system)[self._free]
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
        stage_iterations: int = STAGE_ITERATIONS,
        iterations: int = 400,
        tolerance: float = 1e-5,
        volume: float | None = None,
        report: Report | None = None,
        passed: Callable[[FloatArray], None] | None = None,
    ) -> Minimum:
        """Return the deformation of least energy from a start.

        Args:
            places: From the fraction of the path to where the vertices are to be (V, 3); those of which nothing is
                asked may be anything.
            start: Positions of the vertices before the first stage (V, 3).
            stages: Parts of the path, the last of which ends at the goal.
            stage_iterations: Most iterations at each but the last.
            iterations: Most iterations at the goal.
            tolerance: Largest move of a vertex in an iteration, over the size, at which it has converged.
            volume: To hold; None holds none.
            report: Called after each iteration.
            passed: Called with the positions at the end of each stage but the last.
        """
        u, done = start, 0
        for stage in range(1, stages):
            run = _Run(self, start, places(stage / stages), volume, tolerance)
            u = run.take(u, stage_iterations, done, report).u
            done += run.taken
            if passed is not None:
                passed(u)
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


@dataclass(frozen=True, eq=False)
class _State:
    """A place in the iteration.

    Attributes:
        u: Positions (V, 3).
        rotations: Of the cells (V, 3, 3).
        energy: That is minimised, with the price of the pulls.
        rounding: Of it.
        gradient: Half of its gradient at the free vertices (f, 3), without what a held volume takes.
        solved: L^-1 of that (f, 3); its opposite is the move of one iteration of rotations and positions.
        outward: dV/du at the free vertices and L^-1 of it, (f, 3) each; None where no volume is held.
        multiplier: Of dV/du, that the gradient is without.
    """

    u: FloatArray
    rotations: FloatArray
    energy: float
    rounding: float
    gradient: FloatArray
    solved: FloatArray
    outward: tuple[FloatArray, FloatArray] | None
    multiplier: float

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.energy) and np.isfinite(self.solved).all())

    @property
    def move(self) -> float:
        """The largest move of a vertex in an iteration of rotations and positions."""
        return float(np.sqrt((self.solved**2).sum(axis=1).max()))


class _Run:
    """The iteration towards one set of places."""

    def __init__(
        self, solver: LocalGlobal, start: FloatArray, places: FloatArray, volume: float | None, tolerance: float
    ) -> None:
        self._solver, self._places, self._volume, self._tolerance = solver, places, volume, tolerance
        self._fixed = np.where(solver.untouched[:, None], start, places)[solver._held]
        self.taken = 0

    def take(self, start: FloatArray, iterations: int, before: int, report: Report | None) -> _End:
        """Return where the iteration ends."""
        solver = self._solver
        u = start.copy()
        u[solver._held] = self._fixed
        if solver._factor is None:
            return _End(u, solver._energy.rotations(u), 0.0, MinimumStatus.CONVERGED)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite has a status
            return self._taken(self._state(u, None), iterations, before, report)

    def _taken(self, at: _State, iterations: int, before: int, report: Report | None) -> _End:
        solver, memory = self._solver, Descent(WINDOW)
        kept, status, move = at, MinimumStatus.NOT_FINITE, np.inf
        while at.finite:
            kept, move = at, at.move / solver._size
            arrived = move <= self._tolerance
            if arrived or self.taken == iterations:
                status = MinimumStatus.CONVERGED if arrived else MinimumStatus.ITERATIONS_SPENT
                break
            # The places of the held vertices have jumped: rotations and positions in turn bring the rest along.
            at = self._moved(at, -at.solved) if self.taken == 0 else self._step(at, memory)
            self.taken += 1
            if report is not None and at.finite:
                report(before + self.taken, at.energy, move)
        return _End(kept.u, solver._energy.rotations(kept.u, kept.rotations), move, status)

    def _step(self, at: _State, memory: Descent) -> _State:
        """Return where a step leads that has been learned, halved until it gains enough; else a plain one."""
        way = memory.direction(at.gradient, at.solved)
        if at.outward is not None:  # to first order it keeps the volume
            outward, solved = at.outward
            way = way - float(np.vdot(outward, way)) / float(np.vdot(outward, solved)) * solved
        slope = 2 * float(np.vdot(at.gradient, way))
        for halvings in range(HALVINGS):
            part = 0.5**halvings
            after = self._moved(at, part * way)
            if after.energy <= at.energy + GAIN * part * slope + at.rounding:
                self._learn(memory, at, after)
                return after
        memory.forget()
        return self._moved(at, -at.solved)

    def _learn(self, memory: Descent, at: _State, after: _State) -> None:
        """Take in what a step changed in the gradient of the energy, less the same multiple of the volume's."""
        gradient, solved = at.gradient, at.solved
        if at.outward is not None:
            other = at.multiplier - after.multiplier
            gradient, solved = (part + other * out for part, out in zip((gradient, solved), at.outward, strict=True))
        memory.learn((after.u - at.u)[self._solver._free], after.gradient - gradient, after.solved - solved)

    def _moved(self, at: _State, way: FloatArray) -> _State:
        u = at.u.copy()
        u[self._solver._free] += way
        if at.outward is not None and self._volume is not None:
            u = self._at_volume(u, at.outward[1])
        return self._state(u, at.rotations)

    def _at_volume(self, u: FloatArray, solved: FloatArray) -> FloatArray:
        """Return positions moved to the volume to hold, along L^-1 dV/du of the place before.

        Where the iteration comes to rest both are the same, and the multiplier of dV/du that of the minimum.
        """
        assert self._volume is not None
        way = np.zeros_like(u)
        way[self._solver._free] = solved
        return self._solver.volume.reached(u, way, self._volume)

    def _state(self, u: FloatArray, start: FloatArray | None) -> _State:
        """Return what there is to know at positions (V, 3), with rotations sought from a start."""
        solver, energy = self._solver, self._solver._energy
        assert solver._factor is not None
        covariances = energy.covariances(u)
        if not np.isfinite(covariances).all():
            return _State(u, covariances, np.inf, 0.0, u, u, None, 0.0)
        rotations = best_rotations(covariances, start, accuracy=ANGLE)
        spread, pulled = energy.laplacian @ u, u - self._places
        stretched, fitted = float(np.vdot(u, spread)), float(np.einsum("nij,nji->", rotations, covariances))
        value = stretched - 2 * fitted + solver.constant
        value += float(solver._pulls @ (pulled**2).sum(axis=1))
        gradient = (spread - energy.right_hand_side(rotations) + solver._pulls[:, None] * pulled)[solver._free]
        solved, outward, multiplier = solver._factor.solve(gradient), None, 0.0
        if self._volume is not None:
            across = solver.volume.gradient(u)[solver._free]
            outward = across, solver._factor.solve(across)
            size = float(np.vdot(across, outward[1]))
            multiplier = float(np.vdot(across, solved)) / size if size > 0 else 0.0
            gradient, solved = gradient - multiplier * across, solved - multiplier * outward[1]
        rounding = ROUNDING * (stretched + 2 * abs(fitted) + solver.constant)
        return _State(u, rotations, value, rounding, gradient, solved, outward, multiplier)
