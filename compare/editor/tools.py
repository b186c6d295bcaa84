"""The tools of a session: each is an edit of `implicit` with options that answer while the user waits.

| tool | edit |
|---|---|
| geometric | implicit.geometric_edit: regions go with the hand or along the normal, and the rest stays |
| rigid | implicit.rigid_edit: regions go with the hand, held ones stay, and the rest follows with little strain |
| smooth | implicit.smooth: mean curvature flow, within the regions if there are some |
| semantic | implicit.semantic_edit: the code of a generated shape changes so that the regions go there |
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, get_args

import torch
from torch import Tensor

import implicit
from compare.cases.handles import HandleSpec
from compare.editor.linear import Surface
from compare.errors import InputError
from implicit.edits.targets import SummedTargets
from implicit.surface.quadrature import placed

Tool = Literal["geometric", "rigid", "smooth", "semantic"]
TOOLS: tuple[Tool, ...] = get_args(Tool)
Progress = Callable[[int, int, dict[str, Any]], None]

HOLDS: Mapping[str, Callable[[], implicit.Functional]] = {"volume": implicit.Volume, "area": implicit.Area}

# Share of the field's size that a step of an edit goes, and how many there are at least and at most.
STEP = 1 / 80
LEAST_STEPS, MOST_STEPS = 3, 16

# Least share of the sample's points that lie in the regions that move, and the most by which they are denser there.
# More of them there leave the rest to itself: on the cow's flank a half misses 0.29 of a bump, a tenth 0.17.
IN_REGIONS = 0.1
MOST_DENSE = 30.0


@dataclass(frozen=True)
class Settings:
    """Settings of an edit, plain data that a history keeps.

    Attributes:
        points: Points of the surface that carry the target.
        steps: Steps of the edit; None takes as many as the length of the motion needs, three at least.
        hold: Of "volume" and "area", what is held at its value before the edit.
        pull: Of semantic edits, how strongly the code is pulled to those of training.
        time: Of smoothing, the time of a step in units of 1e-4 of the area.
        resolution: Cells along the longest side on which pieces are counted before the answer; finer ones follow.
        seed: Of the random choices.
    """

    points: int = 500
    steps: int | None = None
    hold: tuple[str, ...] = ()
    pull: float = 1e-4
    time: float = 1.0
    resolution: int = 12
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "hold", tuple(self.hold))
        for name, least in (("points", 20), ("steps", 1), ("resolution", 8), ("seed", 0)):
            value = getattr(self, name)
            if name == "steps" and value is None:
                continue
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InputError(f"{name} must be a whole number, at least {least}, but is {value!r}.")
        if unknown := set(self.hold) - set(HOLDS):
            raise InputError(f"Of {' and '.join(HOLDS)} something can be held, but not {sorted(unknown)[0]!r}.")
        for name in ("pull", "time"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not 0 <= value < float("inf") or (name == "time" and value == 0):
                raise InputError(f"{name} must be a {'positive ' * (name == 'time')}number, but is {value!r}.")

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {**asdict(self), "hold": list(self.hold)}

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Settings:
        """Return the settings that `to_dict` wrote."""
        if unknown := set(row) - {part.name for part in fields(cls)}:
            raise InputError(f"There is no setting {sorted(unknown)[0]!r} of an edit.")
        return cls(**row)


def settled(
    settings: Settings, tool: Tool, field: implicit.Field, handles: Sequence[HandleSpec], surface: Surface
) -> Settings:
    """Return the settings with the number of steps that an edit takes.

    Args:
        settings: As asked for.
        tool: Which edit.
        field: The field.
        handles: What goes where.
        surface: Of the field, as drawn.

    Raises:
        InputError: The surface is to go where the field cannot have it.
    """
    longest = 0.0
    if tool != "smooth" and handles:
        points, normals = torch.from_numpy(surface.V), torch.from_numpy(surface.N)
        targets = SummedTargets([handle.build() for handle in handles], points, normals)
        _require_within(field, targets.positions(1.0))
        longest = targets.largest()
    if settings.steps is not None:
        return settings
    return replace(settings, steps=min(MOST_STEPS, max(LEAST_STEPS, math.ceil(longest / (STEP * field.size)))))


def _require_within(field: implicit.Field, goal: Tensor) -> None:
    """Refuse places that are out of the field's bounds, which no edit could reach, however long it tried."""
    lower, upper = field.bounds.to(goal)
    beyond = torch.maximum(lower - goal, goal - upper).amax(dim=1)
    farthest = int(beyond.argmax())
    if float(beyond[farthest]) > 0:
        place, low, high = (", ".join(f"{x:.3g}" for x in row.tolist()) for row in (goal[farthest], lower, upper))
        raise InputError(
            f"The surface is to go to ({place}), out of the field's bounds, ({low}) to ({high}). Drag less far; the "
            "field is as it was."
        )


def run_tool(
    tool: Tool,
    field: implicit.Field,
    handles: Sequence[HandleSpec],
    settings: Settings,
    *,
    quadrature: implicit.SurfaceSample,
    codes: Tensor | None = None,
    progress: Progress | None = None,
) -> implicit.Edit:
    """Edit a field; it is not touched itself.

    Args:
        tool: Which edit.
        field: The field as it is.
        handles: What goes where; of smoothing, the regions that are smoothed.
        settings: Its settings.
        quadrature: Of the field's surface, from which the points are chosen.
        codes: Those of training, of a generated shape.
        progress: As for the edits of `implicit`.

    Raises:
        InputError: The tool cannot work on this field, or with these handles.
        ValueError: As for the edits of `implicit`.
    """
    if tool not in TOOLS:
        raise InputError(f"A tool is one of {', '.join(TOOLS)}, but got {tool!r}.")
    if tool != "smooth" and not any(not handle.holds for handle in handles):
        raise InputError("Nothing is to move. Pick a region on the shape and drag it.")
    if tool == "smooth":
        return _smooth(field, handles, settings, quadrature, progress)
    if tool == "semantic":
        return _semantic(field, handles, settings, codes, progress)
    sample = carrying_sample(field, quadrature, handles, settings.points, settings.seed)
    common: dict[str, Any] = {
        "points": sample,
        "steps": settings.steps or LEAST_STEPS,
        "constraints": _constraints(settings),
        "resolution": settings.resolution,
        "progress": progress,
        "seed": settings.seed,
    }
    built = [handle.build() for handle in handles]
    if tool == "geometric":
        return implicit.geometric_edit(field, built, "fixed", **common)
    if not any(handle.holds for handle in handles):
        raise InputError("A rigid edit needs a held region, or all would go along. Pick one that is held.")
    return implicit.rigid_edit(field, built, method="linear", **common)


def carrying_sample(
    field: implicit.Field,
    quadrature: implicit.SurfaceSample,
    handles: Sequence[HandleSpec],
    points: int,
    seed: int = 0,
) -> implicit.SurfaceSample:
    """Return points of a quadrature for an edit, denser in the regions that move, with weights that make up for it.

    Args:
        field: The field.
        quadrature: Of its surface; its points may lie on the cells.
        handles: What moves and what is held.
        points: How many.
        seed: Of the draw.
    """
    moving = torch.zeros_like(quadrature.weights)
    for handle in handles:
        if not handle.holds:
            moving = torch.maximum(moving, (handle.build().weights(quadrature.points) > 0).to(moving))
    inside = float(quadrature.weights @ moving)
    if inside <= 0:
        raise ValueError(
            "No point of the surface lies in a region that moves. Pick one on the shape, or make it larger."
        )
    outside = float(quadrature.weights.sum()) - inside
    times_denser = min(max(IN_REGIONS / (1 - IN_REGIONS) * outside / inside, 1.0), MOST_DENSE)
    dense = 1 + moving * (times_denser - 1)
    amounts = (quadrature.weights * dense).double()
    count = min(points, len(amounts))
    generator = torch.Generator().manual_seed(seed)
    strips = (torch.arange(count) + torch.rand(count, generator=generator, dtype=torch.float64)) / count
    chosen = torch.searchsorted(amounts.cumsum(0), strips * amounts.sum()).clamp(max=len(amounts) - 1)
    chosen, times = torch.unique(chosen, return_counts=True)  # where one point fills several strips, it counts as many
    weights = (times * float(amounts.sum()) / count / dense[chosen]).to(quadrature.weights)
    sample = implicit.SurfaceSample(quadrature.points[chosen], quadrature.normals[chosen], weights)
    return placed(field, sample, field.size / 16)


def _constraints(settings: Settings) -> tuple[implicit.Functional, ...]:
    return tuple(HOLDS[name]() for name in settings.hold)


def _smooth(
    field: implicit.Field,
    handles: Sequence[HandleSpec],
    settings: Settings,
    quadrature: implicit.SurfaceSample,
    progress: Progress | None,
) -> implicit.Edit:
    where = None
    for handle in handles:
        region = handle.build().region
        where = region if where is None else where | region  # type: ignore[operator]
    return implicit.smooth(
        field,
        steps=settings.steps or LEAST_STEPS,
        step_size=settings.time * 1e-4 * float(quadrature.weights.sum()),
        where=where,  # type: ignore[arg-type]
        constraints=_constraints(settings),
        resolution=max(32, settings.resolution),
        progress=progress,
        seed=settings.seed,
    )


def _semantic(
    field: implicit.Field,
    handles: Sequence[HandleSpec],
    settings: Settings,
    codes: Tensor | None,
    progress: Progress | None,
) -> implicit.Edit:
    if not field.takes_code:
        raise InputError("A semantic edit changes the code of a generated shape, but this field has none.")
    if settings.hold:
        raise InputError("A semantic edit holds neither volume nor area. Let them go, or take another tool.")
    points, displacements = implicit.prescribe(
        field, [handle.build() for handle in handles], 100, resolution=48, seed=settings.seed
    )
    prior = None if codes is None or len(codes) < 2 or settings.pull == 0 else prior_of(codes, settings.pull)
    return implicit.semantic_edit(
        field, points, displacements, steps=max(15, settings.steps or 0), prior=prior, progress=progress
    )


def prior_of(codes: Tensor, pull: float = 1e-4) -> implicit.CodePrior:
    """Return the Gaussian of the codes of training."""
    return implicit.CodePrior.of(codes, pull)
