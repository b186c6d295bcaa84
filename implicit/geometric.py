"""Geometric editing: prescribe how far parts of the surface move, and keep or free the rest.

Each step minimises E_C + damping |d_theta|^2 [paper, eq. 4, 5]. A large displacement is split into parts, and
each part aims at where the points should be by then rather than repeating its share, so what one part missed
the next makes up for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.deformation import DeformationSpace
from implicit.energies import NormalTarget
from implicit.evolve import Edit, Progress, Row, State, StepProblem, evolve
from implicit.field import Field
from implicit.functionals import Functional
from implicit.regions import Handle
from implicit.sampling import sample_surface
from implicit.surface import SurfaceSample


def geometric_edit(
    field: Field,
    handles: Sequence[Handle] | Handle,
    rest: Literal["fixed", "free"] | float = "fixed",
    *,
    parts: int | None = None,
    points: int | SurfaceSample = 4000,
    damping: float | None = None,
    constraints: Sequence[Functional] = (),
    resolution: int = 48,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Edit:
    """Move parts of the surface by prescribed displacements.

    Args:
        field: The field to edit; the caller's own stays as it is until `edit.field.write_back()`.
        handles: Regions and their displacements. A region's weight between 0 and 1 scales the displacement; where
            several overlap, displacements add.
        rest: What becomes of points in no region: "fixed" at zero, "free", or fixed with this weight.
        parts: Sub-steps; None takes as many as keep each part below 1/160 of the field's size, between 4 and 32
            (a bump of 5 % of the size then takes 8; twice as many parts bring a third of the error).
        points: How many points carry the target, or the sample itself.
        damping: Penalty on |d_theta|^2; None adapts it to the linearity error.
        constraints: Functionals to hold during the edit, such as Volume().
        resolution: Of the quadrature that measures the constraints.
        track: Further surface points (M, D) to carry along.
        progress: Called after each part.
        seed: Of the random points.

    Raises:
        ValueError: No point of the surface lies in any region, or a displacement is not finite.
    """
    handles = [handles] if isinstance(handles, Handle) else list(handles)
    sample = points if isinstance(points, SurfaceSample) else sample_surface(field, points, seed=seed)
    goal = _Goal(handles, sample.points, sample.normals, rest)
    extra = None if track is None else field.require_points(track)
    count = parts if parts is not None else goal.default_parts(field)
    if count < 1:
        raise ValueError(f"parts must be at least 1, but is {count}.")
    operation = _Geometric(goal, sample, count, damping, handles, rest, extra)
    return evolve(
        field,
        operation,
        sample,
        steps=count,
        constraints=constraints,
        resolution=resolution,
        track=track,
        wanted=goal.wanted(),
        progress=progress,
    )


class _Goal:
    """Where points of the unedited surface are to be after a fraction of the edit."""

    def __init__(
        self, handles: Sequence[Handle], points: Tensor, normals: Tensor, rest: Literal["fixed", "free"] | float
    ) -> None:
        if not handles:
            raise ValueError("handles is empty. Give at least one Handle(region, displacement).")
        self._handles, self._start, self._normals = handles, points, normals
        self._weights = [handle.weights(points) for handle in handles]
        for k, weights in enumerate(self._weights):
            if not bool((weights > 0).any()):
                raise ValueError(
                    f"No point of the surface lies in the region of handles[{k}]. The surface spans "
                    f"{points.amin(dim=0).tolist()} to {points.amax(dim=0).tolist()}; move or widen the region."
                )
        self.prescribed = torch.stack(self._weights).amax(dim=0) > 0
        weight = {"fixed": 1.0, "free": 0.0}.get(rest, rest) if isinstance(rest, str) else rest
        if isinstance(weight, str) or not weight >= 0:
            raise ValueError(f'rest must be "fixed", "free" or a weight of at least 0, but is {rest!r}.')
        self.importance = torch.where(self.prescribed, 1.0, float(weight)).to(points)

    def at(self, fraction: float) -> Tensor:
        """Positions after the fraction."""
        way = torch.zeros_like(self._start)
        for handle, weights in zip(self._handles, self._weights, strict=True):
            way = way + weights[:, None] * (handle.position(fraction, self._start, self._normals) - self._start)
        return self._start + way

    def wanted(self) -> Tensor:
        """The whole displacement; NaN where nothing is asked."""
        whole = self.at(1.0) - self._start
        return torch.where((self.importance > 0)[:, None], whole, torch.full_like(whole, float("nan")))

    def default_parts(self, field: Field) -> int:
        largest = float((self.at(1.0) - self._start).norm(dim=1).max())
        return min(32, max(4, int(-(-largest // (field.size / 160)))))


class _Geometric:
    def __init__(
        self,
        goal: _Goal,
        sample: SurfaceSample,
        parts: int,
        damping: float | None,
        handles: Sequence[Handle],
        rest: Literal["fixed", "free"] | float,
        track: Tensor | None,
    ) -> None:
        self._goal, self._sample, self._parts, self._damping = goal, sample, parts, damping
        self._handles, self._rest, self._track = handles, rest, track
        self._all: _Goal | None = None

    def step(self, state: State) -> StepProblem:
        field, goal = state.field, self._goal
        now, then = state.step / self._parts, (state.step + 1) / self._parts
        used = goal.importance > 0
        points = state.points[used]
        target = ((goal.at(then)[used] - points) * field.normal(points)).sum(dim=1)
        energy = NormalTarget(points, target, (self._sample.weights * goal.importance)[used])
        whole = self._whole(field)
        ahead = whole.at(then) - whole.at(now)

        def slide(carried: Tensor, normals: Tensor) -> Tensor:
            # A prescribed point follows its whole vector; the field sees only the part along the normal.
            return ahead - normals * (normals * ahead).sum(dim=1, keepdim=True)

        return StepProblem(DeformationSpace(field), [energy], self._damping, slide=slide)

    def _whole(self, field: Field) -> _Goal:
        """The goal of the carried points: the sample's, then the tracked ones (made at the first step)."""
        if self._all is None:
            points, normals = self._sample.points, self._sample.normals
            if self._track is not None:
                points, normals = torch.cat([points, self._track]), torch.cat([normals, field.normal(self._track)])
            self._all = _Goal(self._handles, points, normals, self._rest)
        return self._all

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        return False
