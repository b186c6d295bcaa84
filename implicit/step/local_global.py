"""Minimise the energy of spokes and rims, some vertices held: rotations and positions in turn, and what they teach.

    local    R_v = the best rotation of each cell of u
    global   L u = D^T ((C^T R) e_0) over the free vertices, held ones in their places, pulled ones at a price

L is factored once. One such iteration is a step -L^-1 g along the gradient g of the energy; from the steps taken the
inverse of the Hessian is learned beyond L^-1 (implicit.step.preconditioned), and a step is halved until it lowers the
energy. Against iterations mixed from the last ones [Anderson 1965], which rest where these happen to stand still, a
cactus bent by 90 degrees takes two thirds of the time, ends 0.1 % lower where those found a saddle, and comes back to
the same energy to 1e-6 when its points are shaken by 1 % of its size.

A volume V is held by the multiplier l that makes g - l dV/du least in the metric of L^-1, and by Newton's method back
to V along L^-1 dV/du after each step: to first order that is the minimiser under the constraint. With the area held too
there are two multipliers and two such ways.

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
from implicit.step.surface_area import SurfaceArea

# Steps that are learned from.
WINDOW = 8

# To which the rotations are found in an iteration, in radians; the end has them to rounding.
ANGLE = 1e-6

# A step has to gain this part of what its slope promises, and is halved so often until it does.
GAIN = 1e-4
HALVINGS = 10

# Part of the energy's largest term within which two energies are the same, for rounding.
ROUNDING = 1e-14

# Newton steps back to several held values, and how near they come, relative to each.
RETURNS, RETURNED = 12, 1e-13

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
        volume_gap: How far the volume is from the one to hold, relative to that, or the area where that is held and
            further off; 0 where none is.
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
        self.area = SurfaceArea(energy.faces, len(energy.vertices))
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
        area: float | None = None,
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
            volume, area: To hold; None holds none.
            report: Called after each iteration.
            passed: Called with the positions at the end of each stage but the last.
        """
        u, done = start, 0
        asked = ((self.volume, volume), (self.area, area))
        held = tuple(_Held(functional, value) for functional, value in asked if value is not None)
        for stage in range(1, stages):
            run = _Run(self, start, places(stage / stages), held, tolerance)
            u = run.take(u, stage_iterations, done, report).u
            done += run.taken
            if passed is not None:
                passed(u)
        run = _Run(self, start, places(1.0), held, tolerance)
        end = run.take(u, iterations, done, report)
        gap = max((abs(one.gap(end.u) / one.value) for one in held), default=0.0)
        energy = self._energy.energy(end.u, end.rotations)
        return Minimum(end.u, end.rotations, energy, done + run.taken, end.move, gap, end.status)


@dataclass(frozen=True, eq=False)
class _Held:
    """A functional of the vertices and the value that it is held at."""

    functional: EnclosedVolume | EnclosedArea | SurfaceArea
    value: float

    def gap(self, u: FloatArray) -> float:
        return self.value - self.functional.value(u)


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
        outward: Derivatives of the k held values at the free vertices and L^-1 of them, (k, f, 3) each.
        multipliers: Of these, that the gradient is without (k,).
    """

    u: FloatArray
    rotations: FloatArray
    energy: float
    rounding: float
    gradient: FloatArray
    solved: FloatArray
    outward: tuple[FloatArray, FloatArray]
    multipliers: FloatArray

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
        self, solver: LocalGlobal, start: FloatArray, places: FloatArray, held: tuple[_Held, ...], tolerance: float
    ) -> None:
        self._solver, self._places, self._held, self._tolerance = solver, places, held, tolerance
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
        # To first order it keeps what is held.
        way = way - np.tensordot(_shares(at.outward, way), at.outward[1], axes=1)
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
        """Take in what a step changed in the gradient of the energy, less the same multiples of what is held."""
        other = at.multipliers - after.multipliers
        gradient, solved = (
            part + np.tensordot(other, out, axes=1)
            for part, out in zip((at.gradient, at.solved), at.outward, strict=True)
        )
        memory.learn((after.u - at.u)[self._solver._free], after.gradient - gradient, after.solved - solved)

    def _moved(self, at: _State, way: FloatArray) -> _State:
        u = at.u.copy()
        u[self._solver._free] += way
        if self._held:
            u = self._returned(u, at.outward[1])
        return self._state(u, at.rotations)

    def _returned(self, u: FloatArray, solved: FloatArray) -> FloatArray:
        """Return positions moved to where all is held, along L^-1 of its derivatives at the place before.

        Where the iteration comes to rest both are the same, and the multipliers those of the minimum.
        """
        ways = np.zeros((len(solved), *u.shape))
        ways[:, self._solver._free] = solved
        first = self._held[0]
        if len(self._held) == 1 and not isinstance(first.functional, SurfaceArea):
            return first.functional.reached(u, ways[0], first.value)
        best, least = u, np.inf
        for number in range(RETURNS):
            gaps = np.array([one.gap(u) for one in self._held])
            off = float(np.abs(gaps / [one.value for one in self._held]).max())
            if not off < least:
                break
            best, least = u, off
            if off <= RETURNED:
                break
            if number < 2:  # later ones are so small that the same slopes will do
                across = [one.functional.gradient(u) for one in self._held]
                slopes = np.array([[np.vdot(part, way) for way in ways] for part in across])
            u = u + np.tensordot(np.linalg.lstsq(slopes, gaps)[0], ways, axes=1)
        return best

    def _state(self, u: FloatArray, start: FloatArray | None) -> _State:
        """Return what there is to know at positions (V, 3), with rotations sought from a start."""
        solver, energy = self._solver, self._solver._energy
        assert solver._factor is not None
        covariances = energy.covariances(u)
        if not np.isfinite(covariances).all():
            none = np.zeros((0, *u.shape))
            return _State(u, covariances, np.inf, 0.0, u, u, (none, none), np.zeros(0))
        rotations = best_rotations(covariances, start, accuracy=ANGLE)
        spread, pulled = energy.laplacian @ u, u - self._places
        stretched, fitted = float(np.vdot(u, spread)), float(np.einsum("nij,nji->", rotations, covariances))
        value = stretched - 2 * fitted + solver.constant
        value += float(solver._pulls @ (pulled**2).sum(axis=1))
        gradient = (spread - energy.right_hand_side(rotations) + solver._pulls[:, None] * pulled)[solver._free]
        solved = solver._factor.solve(gradient)
        across = np.zeros((len(self._held), *gradient.shape))
        for k, one in enumerate(self._held):
            across[k] = one.functional.gradient(u)[solver._free]
        outward = across, np.array([solver._factor.solve(part) for part in across]).reshape(across.shape)
        multipliers = _shares(outward, solved)
        gradient, solved = (
            part - np.tensordot(multipliers, out, axes=1) for part, out in zip((gradient, solved), outward, strict=True)
        )
        rounding = ROUNDING * (stretched + 2 * abs(fitted) + solver.constant)
        return _State(u, rotations, value, rounding, gradient, solved, outward, multipliers)


def _shares(outward: tuple[FloatArray, FloatArray], way: FloatArray) -> FloatArray:
    """Return the shares of each L^-1 dV/du in a way, without which it changes nothing that is held (k,)."""
    across, solved = outward
    if not len(across):
        return np.zeros(0)
    changes = np.array([np.vdot(part, way) for part in across])
    sizes = np.array([[np.vdot(part, out) for out in solved] for part in across])
    # Where a derivative vanishes, or two are the same, the least shares will do.
    return np.asarray(np.linalg.lstsq(sizes, changes)[0])
