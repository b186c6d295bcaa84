"""Rigid edits in which field and points go together: each step minimises the energy over what the field can express.

The vertices of the mesh that carries the energy lie on the field's surface. A step moves them by

    D = n (b . d_theta) + (1 - n n^T) T c

and takes the least of the energy of spokes and rims against the rest shape, with finite rotations, over the changes of
the parameters and the coefficients of a tangential basis together [paper, section 4.3]:

    E(y + D) + handles + volume + what ties the field off the surface + damping

In one space it is not quadratic, so it is minimised by steps that learn (implicit.step.preconditioned), preconditioned
by the normal matrix with L in place of the Hessian of E, factored once a step. Then the field is linearised anew. The
path is taken in stages; of what came before nothing is kept but where the vertices are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy import sparse
from scipy.linalg import lapack

from implicit.field.field import Field
from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.deformation import DeformationSpace
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.local_global import Minimum, MinimumStatus
from implicit.step.off_surface import off_surface
from implicit.step.planar_rigidity import EnclosedArea
from implicit.step.preconditioned import Descent
from implicit.step.rest_shape import RestShape
from implicit.step.rigidity_target import RigidityTarget
from implicit.step.surface_area import SurfaceArea
from implicit.step.symmetric import add_gram
from implicit.step.tangential_basis import TangentialModel
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample

# Longest way of a handle and largest turn, in radians, in a stage of the path; the former over the size.
STAGE_LENGTH, STAGE_TURN = 0.025, 0.15

# Most linearisations at a stage, which ends with one that was taken whole, and at the goal.
MOST_AT_STAGE, AT_GOAL = 3, 12

# Iterations of a step, and the part of the energy that one has to gain for the next to be taken.
ITERATIONS, GAIN = 30, 1e-3

# Steps that are learned from, and halvings of one that gains nothing.
WINDOW, HALVINGS = 8, 6

# Damping of the first step, the least and the most, relative to the trace of the normal matrix.
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-7, 1e-8, 1e-5

# Of the energy off the surface, relative to the mean mass of a vertex, points that carry it, drawn anew each time, and
# the share of a distance's deviation from one that a linearisation is to undo: many of them drift.
OFF_SURFACE_STRENGTH, OFF_SURFACE_POINTS, RESTORE = 1.0, 1500, 0.5

# Price of the squared relative change of a volume or area that is held, in units of the size squared.
HELD_PRICE = 100.0

# Part of the vertices that have to find the surface after a step; what does not stays where the step sends it.
ARRIVED = 0.995

# Part of the energy by which a linearisation at the goal has to lower it for another one.
CONVERGED = 2e-3

Report = Callable[[int, float, float], None]
Places = Callable[[float], FloatArray]


@dataclass(frozen=True, eq=False)
class Asked:
    """Request of a coupled edit: where the vertices are to be, and what is held.

    Attributes:
        rest: The shape at rest.
        places: From the fraction of the path to where the vertices are to be (V, 3).
        prices: Of the squared distance of each from there (V,), 0 where nothing is asked.
        stages: Parts of the path.
        volume, area: To hold, as the mesh measures them; None holds none.
        tangential: Basis of the motion along the surface.
        seed: Of the random points off the surface.
        is_distance: Whether the field is a distance, and is to stay one.
    """

    rest: RestShape
    places: Places
    prices: FloatArray
    stages: int
    volume: float | None
    tangential: TangentialModel
    seed: int
    is_distance: bool
    area: float | None = None

    @cached_property
    def held(self) -> tuple[tuple[EnclosedVolume | EnclosedArea | SurfaceArea, float], ...]:
        """Functionals that are held, and the value of each."""
        faces, count = self.rest.energy.faces, len(self.rest.energy.vertices)
        both = ((self.rest.volume, self.volume), (SurfaceArea(faces, count), self.area))
        return tuple((functional, value) for functional, value in both if value is not None)


def coupled_minimum(field: Field, start: FloatArray, asked: Asked, report: Report | None) -> tuple[Field, Minimum]:
    """Return a field and where the vertices on its surface are, of the least energy that the steps find.

    Args:
        field: In float64, with the vertices on its surface.
        start: Where these are (V, 3).
        asked: What is to be reached.
        report: Called after each linearisation with its number, the energy and the largest move over the size.
    """
    energy, size = asked.rest.energy, float(np.ptp(asked.rest.energy.vertices, axis=0).max())
    at, done, move, damping = start, 0, np.inf, FIRST_DAMPING
    rotations, status = energy.rotations(at), MinimumStatus.ITERATIONS_SPENT
    for stage in range(1, asked.stages + 1):
        last = stage == asked.stages
        goal = _Goal(asked, asked.places(stage / asked.stages))
        for _ in range(AT_GOAL if last else MOST_AT_STAGE):
            before = goal.value(at, rotations)
            found = _step(field, at, rotations, replace(asked, seed=asked.seed + done), goal, damping)
            done += 1
            if found is None:
                damping = min(damping * 10, MOST_DAMPING)
                continue
            move = float(np.linalg.norm(found.at - at, axis=1).max()) / size
            field, at, rotations = found.field, found.at, found.rotations
            # What had to be halved was too far for a linear model of the field.
            damping = max(damping / 3, LEAST_DAMPING) if found.part == 1 else min(damping * 3, MOST_DAMPING)
            if report is not None:
                report(done, found.value, move)
            if last and found.part == 1 and found.value > (1 - CONVERGED) * before:
                status = MinimumStatus.CONVERGED
                break
            if not last and found.part == 1:
                break
    rotations = energy.rotations(at, rotations)
    gap = max((abs(functional.value(at) / wanted - 1) for functional, wanted in asked.held), default=0.0)
    return field, Minimum(at, rotations, energy.energy(at, rotations), done, move, gap, status)


@dataclass(frozen=True, eq=False)
class _Goal:
    """Function of the positions of the vertices that a stage minimises."""

    asked: Asked
    places: FloatArray

    def value_and_gradient(self, at: FloatArray, start: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the energy with its prices, its gradient (V, 3) and the rotations of the cells."""
        asked, energy = self.asked, self.asked.rest.energy
        rotations = energy.rotations(at, start)
        spread, missed = energy.laplacian @ at, at - self.places
        turned, x = energy.right_hand_side(rotations), energy.vertices
        half = spread - turned
        value = float(np.vdot(at, half) - np.vdot(at, turned) + np.vdot(x, energy.laplacian @ x))
        value += float(asked.prices @ (missed**2).sum(axis=1))
        gradient = 2 * (half + asked.prices[:, None] * missed)
        for functional, wanted in asked.held:
            gap = functional.value(at) / wanted - 1
            value += self.held_price * gap**2
            gradient = gradient + 2 * self.held_price * gap / wanted * functional.gradient(at)
        return value, gradient, rotations

    def value(self, at: FloatArray, start: FloatArray) -> float:
        """Return the energy with its prices."""
        return self.value_and_gradient(at, start)[0]

    @cached_property
    def held_price(self) -> float:
        return HELD_PRICE * float(np.ptp(self.asked.rest.energy.vertices, axis=0).max()) ** 2

    @cached_property
    def metric(self) -> sparse.csc_array:
        """L and the prices, (V, V)."""
        return sparse.csc_array(self.asked.rest.energy.laplacian + sparse.diags_array(self.asked.prices))


@dataclass(frozen=True, eq=False)
class _Found:
    field: Field
    at: FloatArray
    rotations: FloatArray
    value: float
    part: float


def _step(
    field: Field, at: FloatArray, rotations: FloatArray, asked: Asked, goal: _Goal, damping: float
) -> _Found | None:
    """Return where one linearisation leads; None where no part of its step lowers the energy."""
    motion = _Motion.of(field, at, asked)
    before = goal.value(at, rotations)
    z = _minimised(motion, at, rotations, goal, damping)
    if z is None:
        return None
    change, way = torch.from_numpy(z[: motion.parameters]).to(field.theta), motion.displacement(z)
    for halvings in range(HALVINGS):
        part = 0.5**halvings
        moved = field.with_theta(field.theta + part * change)
        aim = torch.from_numpy(at + part * way).to(field.theta)
        placed, arrived = newton_to_surface(moved, aim, reach=field.size / 20)
        if float(arrived.double().mean()) < ARRIVED:
            continue
        there = torch.where(arrived[:, None], placed, aim).cpu().numpy()
        value, _, turned = goal.value_and_gradient(there, rotations)
        if value < before:
            return _Found(moved, there, turned, value, part)
    return None


@dataclass(frozen=True, eq=False)
class _Motion:
    """Motions of the vertices that a field and a tangential basis span, linear in z = (d_theta, c).

    Attributes:
        normals: (V, 3).
        rows: n . D by each parameter (V, P), in single precision.
        waves: Values of the tangential functions (V, K), in single precision.
        away: Rows of what ties the field off the surface, with the roots of their weights (k, P), and their targets.
    """

    normals: FloatArray
    rows: FloatArray
    waves: FloatArray
    away: tuple[FloatArray, FloatArray]

    @classmethod
    def of(cls, field: Field, at: FloatArray, asked: Asked) -> _Motion:
        single, points = field.to(torch.float32), torch.from_numpy(at).to(torch.float32)
        space = DeformationSpace(single)
        rows = torch.cat([part for _, part in space.normal_rows(points)]).numpy()
        normals = field.normal(torch.from_numpy(at).to(field.theta))
        masses = torch.from_numpy(asked.rest.surface.masses).to(points)
        strength = OFF_SURFACE_STRENGTH / float(masses.mean())
        sample = SurfaceSample(points, normals.to(points), masses)
        restore = RESTORE if asked.is_distance else 0.0
        target = off_surface(
            single, sample, strength=strength, restore=restore, points=OFF_SURFACE_POINTS, seed=asked.seed
        )
        parts = [(part.rooted().numpy(), (part.weights.sqrt() * part.target).numpy()) for part in target.rows(space)]
        away = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        return cls(normals.cpu().numpy(), rows, asked.tangential.values(points).numpy(), away)

    @property
    def parameters(self) -> int:
        return self.rows.shape[1]

    def displacement(self, z: FloatArray) -> FloatArray:
        """Return D (V, 3)."""
        P = self.parameters
        along = (self.waves @ z[P:].reshape(3, -1).T.astype(np.float32)).astype(np.float64)
        out = (self.rows @ z[:P].astype(np.float32)).astype(np.float64)
        return along + (out - (along * self.normals).sum(axis=1))[:, None] * self.normals

    def transposed(self, forces: FloatArray) -> FloatArray:
        """Return D^T of vectors at the vertices (V, 3)."""
        out = (forces * self.normals).sum(axis=1)
        along = (forces - out[:, None] * self.normals).astype(np.float32)
        return np.concatenate([self.rows.T @ out.astype(np.float32), (along.T @ self.waves).ravel()]).astype(np.float64)

    def normal_matrix(self, metric: sparse.csc_array) -> FloatArray:
        """Return D^T M D for a metric M of each coordinate (V, V), with what ties the field: the lower triangle."""
        P, K = self.parameters, self.waves.shape[1]
        total = np.zeros((P + 3 * K, P + 3 * K), dtype=np.float32)
        own = torch.zeros(P, P)
        some = torch.zeros(len(self.normals), 1)
        factor = RigidityTarget(some, torch.from_numpy(self.normals), some[:, 0], metric).factor
        add_gram(own, torch.from_numpy(factor.astype(np.float32) @ self.rows))
        add_gram(own, torch.from_numpy(self.away[0]))
        total[:P, :P] = own.numpy()
        n = [sparse.diags_array(axis) for axis in self.normals.T]
        one = sparse.eye_array(len(self.normals))
        tangent = [[one - n[a] @ n[a] if a == b else -(n[a] @ n[b]) for b in range(3)] for a in range(3)]
        for b in range(3):
            block = slice(P + b * K, P + (b + 1) * K)
            across = sum(n[a] @ metric @ tangent[a][b] for a in range(3)).astype(np.float32)
            total[block, :P] = (across @ self.waves).T @ self.rows
            for c in range(b + 1):
                along = sum(tangent[a][b] @ metric @ tangent[a][c] for a in range(3)).astype(np.float32)
                total[block, P + c * K : P + (c + 1) * K] = self.waves.T @ (along @ self.waves)
        return total


def _minimised(
    motion: _Motion, at: FloatArray, rotations: FloatArray, goal: _Goal, damping: float
) -> FloatArray | None:
    """Return z of the least energy that the field's linear model has from here; None where the matrix is singular."""
    matrix = motion.normal_matrix(goal.metric).astype(np.float64)
    ridge = damping * np.trace(matrix)
    matrix[np.diag_indices_from(matrix)] += ridge
    for functional, value in goal.asked.held:
        grown = motion.transposed(functional.gradient(at)) * (goal.held_price**0.5 / value)
        matrix += np.tril(np.outer(grown, grown))
    # The triangle below the diagonal is the upper one of the Fortran-ordered view.
    factor, failed = lapack.dpotrf(matrix.T, lower=0, overwrite_a=1)
    if failed:
        return None
    tied, wanted = motion.away
    P = motion.parameters

    def state(z: FloatArray, start: FloatArray) -> _State:
        value, forces, turned = goal.value_and_gradient(at + motion.displacement(z), start)
        off = tied @ z[:P].astype(np.float32) - wanted
        gradient = motion.transposed(forces) + 2 * ridge * z
        gradient[:P] += 2 * (off @ tied)
        solved, _ = lapack.dpotrs(factor, gradient / 2, lower=0)
        return _State(z, value + float(off @ off) + ridge * float(z @ z), gradient, solved, turned)

    memory, here = Descent(WINDOW), state(np.zeros(len(matrix)), rotations)
    for _ in range(ITERATIONS):
        way = memory.direction(here.gradient / 2, here.solved)
        slope = float(here.gradient @ way)
        for halvings in range(HALVINGS):
            part = 0.5**halvings
            after = state(here.z + part * way, here.rotations)
            if after.value <= here.value + 1e-4 * part * slope:
                break
        else:
            break
        memory.learn(after.z - here.z, (after.gradient - here.gradient) / 2, after.solved - here.solved)
        gained, here = here.value - after.value, after
        if gained < GAIN * here.value:
            break
    return here.z if np.isfinite(here.z).all() else None


@dataclass(frozen=True, eq=False)
class _State:
    z: FloatArray
    value: float
    gradient: FloatArray
    solved: FloatArray
    rotations: FloatArray


def stages_of(longest: float, angle: float, least: int) -> int:
    """Return the stages that a path needs.

    Args:
        longest: Way of a handle, over the size of the field.
        angle: By which the handles turn against each other, in radians.
        least: Number of them at least.
    """
    return max(least, int(np.ceil(longest / STAGE_LENGTH)), int(np.ceil(angle / STAGE_TURN)), 1)
