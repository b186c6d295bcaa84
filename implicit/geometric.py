"""Geometric editing: prescribe how far parts of the surface move, and keep or free the rest.

Each step minimises E_C + damping |d_theta|^2 [paper, eq. 4, 5]. A large displacement is split into parts, and
each part aims at where the points should be by then rather than repeating its share, so what one part missed
the next makes up for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.deformation import DeformationSpace
from implicit.energies import NormalTarget
from implicit.evolve import Edit, EditStatus, Progress, Row, State, StepProblem, evolve
from implicit.extraction import newton_to_surface
from implicit.field import Field
from implicit.functionals import Functional
from implicit.goal import Goal, Rest, checked_handles
from implicit.regions import Handle
from implicit.sampling import sample_surface
from implicit.soundness import changes, field_soundness
from implicit.surface import SurfaceSample

# Where parts are chosen by the edit itself: the first part's share of the field's size, the nonlinear part of a step's
# motion that is aimed at, and the most parts. On fields of 3 x 32 sines a bump or stretch of a tenth of the shape then
# takes 6 to 20 parts, and has the error of twice as many equal ones within a third.
FIRST_PART = 1 / 160
LINEARITY = 0.04
MOST_PARTS = 64

# Points are drawn anew where their spacing has grown so that one stands for this many times the area it began with.
THINNED = 2.0


def geometric_edit(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Rest = "fixed",
    *,
    parts: int | None = None,
    points: int | SurfaceSample = 4000,
    damping: float | None = None,
    constraints: Sequence[Functional] = (),
    least_alignment: float = 0.0,
    resolution: int = 48,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Edit:
    """Move parts of the surface by prescribed displacements.

    Args:
        field: The field to edit; the caller's own stays as it is until `edit.field.write_back()`.
        handles: Regions and their displacements. A region's weight between 0 and 1 scales the displacement; where
            several overlap, displacements add. Vectors are projected on the current normal in each part.
        rest: What becomes of points in no region: "fixed" at zero, "free", or fixed with this weight.
        parts: Equal sub-steps; None chooses their number as the edit goes, from the linearity error of each.
        points: How many points carry the target, or the sample itself. They travel with the surface, and are drawn
            anew, more of them, where they have thinned out.
        damping: Penalty on |d_theta|^2; None adapts it to the linearity error.
        constraints: Functionals to hold during the edit, such as Volume() or Area().
        least_alignment: Points whose displacement makes a smaller cosine than this with the normal are left free.
        resolution: Of the quadrature that measures the constraints, and of the pieces of the surface that are counted.
        track: Further surface points (M, D) to carry along.
        progress: Called after each part.
        seed: Of the random points.

    Returns:
        The edit. `before` and `after` say how sound the field is, `notes` what has become worse.

    Raises:
        ValueError: No point of the surface lies in any region, or a displacement is not finite.
    """
    listed = checked_handles(handles)
    if parts is not None and parts < 1:
        raise ValueError(f"parts must be at least 1, but is {parts}.")
    sample = points if isinstance(points, SurfaceSample) else sample_surface(field, points, seed=seed)

    def goal_of(points: Tensor, normals: Tensor) -> Goal:
        return Goal(listed, points, normals, rest, least_alignment=least_alignment)

    goal = goal_of(sample.points, sample.normals)
    goal.require_points_in_each_region()
    before = field_soundness(field, resolution)
    extra = None if track is None else field.require_points(track)
    splitting = _Splitting(parts, goal.largest() / field.size)
    operation = _Displacement(field, goal_of, sample, splitting, damping, extra, seed)
    edit = evolve(
        field,
        operation,
        sample,
        steps=MOST_PARTS if parts is None else parts,
        constraints=constraints,
        resolution=resolution,
        track=track,
        wanted=goal.wanted(),
        asked=lambda points, normals: _asked(goal_of(points, normals)),
        progress=None if progress is None else lambda step, _, row: progress(step, splitting.count(step), row),
    )
    after = field_soundness(edit.field, resolution)
    edit = replace(edit, before=before, after=after, notes=changes(before, after))
    if edit.status is EditStatus.REACHED:  # the whole way was gone in fewer parts than there might have been
        edit = replace(edit, status=EditStatus.DONE)
    if edit.status is EditStatus.DONE and after.topology.components > before.topology.components:
        edit = replace(edit, status=EditStatus.STRAY_PIECES)
    return edit


def _asked(goal: Goal) -> tuple[Tensor, Tensor]:
    return goal.wanted(), goal.directions()


class _Splitting:
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
        self._share *= min(1.5, max(0.5, LINEARITY / error))
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


class _Displacement:
    """The operation that takes points of the surface to their goal, part by part."""

    def __init__(
        self,
        field: Field,
        goal_of: Callable[[Tensor, Tensor], Goal],
        sample: SurfaceSample,
        splitting: _Splitting,
        damping: float | None,
        track: Tensor | None,
        seed: int,
    ) -> None:
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
        energy = part_energy(field, self._goal, self._sample, points, used, then)
        ahead = self._carried.at(then) - self._carried.at(now)

        def slide(carried: Tensor, normals: Tensor) -> Tensor:
            # A prescribed point follows its whole vector; the field sees only the part along the normal.
            return ahead - normals * (normals * ahead).sum(dim=1, keepdim=True)

        row = {"fraction": then, "points_used": int(used.sum()), "thinned": thinned}
        return StepProblem(DeformationSpace(field), [energy], self._damping, slide=slide, row=row)

    def _places(self, state: State, now: float) -> tuple[Tensor, Tensor]:
        """Where the sample is on the current surface, and which of its points carry the target."""
        used = self._goal.importance > 0
        if not self._redrawn:
            return state.points, used
        # The parts before have taken every point to its goal but for what they missed, so that is where it is.
        reach = 0.1 * state.field.size
        points, arrived = newton_to_surface(state.field, self._goal.at(now), reach=reach)
        return points, used & arrived

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        if history:
            self._splitting.advance(state.step, history[-1])
        return self._splitting.now >= 1.0


def part_energy(
    field: Field, goal: Goal, sample: SurfaceSample, points: Tensor, used: Tensor, then: float
) -> NormalTarget:
    """E_C of one part: from where the sample's points are to their goal after the part, along the normal."""
    here = points[used]
    target = ((goal.at(then)[used] - here) * field.normal(here)).sum(dim=1)
    return NormalTarget(here, target, (sample.weights * goal.importance)[used])


class _Coverage:
    """How many times the area it began with a point of the moving part stands for, judged by its neighbours."""

    neighbours = 8

    def __init__(self, goal: Goal, sample: SurfaceSample, density: float | None = None) -> None:
        self._moving = goal.prescribed & (goal.importance > 0)
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
