"""One part of a geometric edit after the other: how far each goes, at which points, and what it minimises.

Part j takes the sample's points from where they are to goal(x, t_j), along the current normal [paper, eq. 4, 5]. The
fractions t_j are equal, or follow the linearity error that each part measures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.edits.targets import SummedTargets
from implicit.field.field import Field
from implicit.sensitivity.frame import tangential_component
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, NormalTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import Row, State, StepProblem
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import sample_surface

# Where the edit itself chooses the parts: the first part's share of the field's size, the nonlinear share of a step's
# motion that is aimed at, and the most parts. The loop accepts a fiftieth; beyond, it damps the step, and what a damped
# step leaves undone costs more than another part would.
FIRST_PART = 1 / 160
LINEARITY = 0.012
MOST_PARTS = 24

# Points are drawn anew where their spacing has grown so that one stands for this many times the area it began with.
THINNED = 2.0

# Of the energy off the surface beside that on it: with it the bump of a tenth on the rocker arm leaves no stray piece
# in 16 parts, and the error on the surface is as without.
OFF_SURFACE_STRENGTH = 1e-2


class Splitting:
    """How far along each part goes: equal parts, or parts as large as the linearity error allows."""

    def __init__(self, parts: int | None, largest: float) -> None:
        self._parts = parts
        self._share = 1.0 / parts if parts is not None else min(0.25, FIRST_PART / max(largest, 1e-12))
        self.now, self.then = 0.0, self._share

    def advance(self, step: int, last: Row) -> None:
        """Set the fractions of the next part, from the record of the one just taken."""
        self.now = self.then
        if self._parts is not None:
            self.then = (step + 1) / self._parts
            return
        # The nonlinear part of a step grows with its square, so its share of the motion grows with the step.
        error = max(float(last["linearity_error"]), 1e-12)
        damped = last["solves"] > 1 and step > 1  # the first part looks for its damping from below
        self._share *= 0.5 if damped else min(1.5, max(0.5, LINEARITY / error))
        left = 1.0 - self.now
        self._share = max(self._share, left / max(1, MOST_PARTS - step))
        more = math.ceil(left / self._share - 1e-9)
        # The parts that are left are equal, so that the last is no crumb.
        self.then = 1.0 if more <= 1 else self.now + left / more

    def count(self, done: int) -> int:
        """How many parts there will be, as far as is known."""
        if self._parts is not None:
            return self._parts
        return done + math.ceil((1.0 - self.then) / self._share - 1e-9)


class Displacement:
    """The operation that takes points of the surface to their goal, part by part."""

    def __init__(
        self,
        field: Field,
        goal_of: Callable[[Tensor, Tensor], SummedTargets],
        sample: SurfaceSample,
        splitting: Splitting,
        damping: float | None,
        off_surface_strength: float,
        track: Tensor | None,
        seed: int,
    ) -> None:
        self._off_surface = off_surface_strength
        self._origin, self._goal_of, self._splitting = field, goal_of, splitting
        self._damping, self._seed = damping, seed
        self._sample, self._goal = sample, goal_of(sample.points, sample.normals)
        # The loop carries the points of the first sample and the tracked ones; they slide along with their goal.
        self._carried = self._goal
        if track is not None:
            normals = torch.cat([sample.normals, field.normal(track)])
            self._carried = goal_of(torch.cat([sample.points, track]), normals)
        self._coverage = _Coverage(self._goal, sample)
        self._redrawn = False

    def step(self, state: State) -> StepProblem:
        field, now, then = state.field, self._splitting.now, self._splitting.then
        points, used = self._places(state, now)
        thinned = self._coverage.thinned(points, used)
        if thinned > THINNED:
            count = int(thinned * len(self._sample))
            self._sample = sample_surface(self._origin, count, seed=self._seed + state.step)
            self._goal = self._goal_of(self._sample.points, self._sample.normals)
            self._coverage = _Coverage(self._goal, self._sample, self._coverage.density)
            self._redrawn = True
            points, used = self._places(state, now)
        energy = _part_energy(field, self._goal, self._sample, points, used, then)
        ahead = self._carried.positions(then) - self._carried.positions(now)

        def slide(carried: Tensor, normals: Tensor) -> Tensor:
            # A prescribed point follows its whole vector; the field sees only the part along the normal.
            return tangential_component(ahead, normals)

        energies: list[Energy] = [energy]
        if self._off_surface > 0:
            sample = SurfaceSample(energy.points, field.normal(energy.points), energy.weights)
            seed = self._seed + state.step
            energies.append(off_surface(field, sample, energy.target, strength=self._off_surface, seed=seed))
        row = {"fraction": then, "points_used": int(used.sum()), "thinned": thinned}
        return StepProblem(DeformationSpace(field), energies, self._damping, slide=slide, row=row)

    def _places(self, state: State, now: float) -> tuple[Tensor, Tensor]:
        """Where the sample is on the current surface, and which of its points carry the target."""
        used = self._goal.weights > 0
        if not self._redrawn:
            return state.points, used
        # The parts before have taken every point to its goal but for what they missed, so that is where it is.
        reach = 0.1 * state.field.size
        points, arrived = newton_to_surface(state.field, self._goal.positions(now), reach=reach)
        return points, used & arrived

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        if history:
            self._splitting.advance(state.step, history[-1])
        return self._splitting.now >= 1.0


def _part_energy(
    field: Field, goal: SummedTargets, sample: SurfaceSample, points: Tensor, used: Tensor, then: float
) -> NormalTarget:
    """E_C of one part: from where the sample's points are to their goal after the part, along the normal."""
    here = points[used]
    target = ((goal.positions(then)[used] - here) * field.normal(here)).sum(dim=1)
    return NormalTarget(here, target, (sample.weights * goal.weights)[used])


class _Coverage:
    """How many times the area it began with a point of the moving part stands for, judged by its neighbours."""

    neighbours = 8

    def __init__(self, goal: SummedTargets, sample: SurfaceSample, density: float | None = None) -> None:
        self._moving = goal.prescribed & (goal.weights > 0)
        self._power = sample.points.shape[1] - 1
        own = len(sample) / float(sample.weights.sum())
        self.density = own if density is None else density  # points an area that the edit began with
        self._denser = own / self.density
        self._begun = self._spacing(sample.points, self._moving)

    def thinned(self, points: Tensor, used: Tensor) -> float:
        """The 90th percentile over the moving points, in areas of a point of the first sample."""
        if self._begun is None:
            return 1.0
        now = self._spacing(torch.where(used[:, None], points, torch.full_like(points, 1e6)), self._moving)
        if now is None:
            return 1.0
        return float(np.quantile((now / self._begun) ** self._power, 0.9)) / self._denser

    def _spacing(self, points: Tensor, moving: Tensor) -> NDArray[np.float64] | None:
        """Distance of each moving point from its farthest near neighbour; None where they are too few to tell."""
        if int(moving.sum()) < 2 * self.neighbours:
            return None
        tree = cKDTree(points.double().cpu().numpy())
        near, _ = tree.query(points[moving].double().cpu().numpy(), k=self.neighbours + 1)
        return np.asarray(near)[:, -1]
