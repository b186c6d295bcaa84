"""Smoothing whose steps have been halved until they hardly matter, with an estimate of what they still do.

The error of n steps falls about as 1/n, so that what 2n steps change is about the error that they leave. It is measured
as the distance along the normals from points that the n steps have carried to the surface of the 2n. The field of the
finest steps is the result: a field cannot be extrapolated as the vertices of a mesh can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.smoothing import smooth
from implicit.evolve.edit import Edit, EditStatus, Progress, require_options
from implicit.field.field import Field, require_field
from implicit.surface.sampling import sample_surface

# Points on which two flows are compared where the caller tracks none.
COMPARED = 1000


@dataclass(frozen=True, eq=False)
class ConvergedSmoothing:
    """A flow of a field, and an estimate of what its steps still do.

    Attributes:
        edit: The flow of the finest steps.
        steps: The number of these.
        time_error_rms: Estimate of the error of the steps: root mean square of the distance along the normal from the
            surface of half as many, a length; infinite where there is none to compare with.
        time_error_max: The largest of it.
        area_error: Estimate of the error that they leave in the area, likewise.
        converged: Whether the rms is below the tolerance, and every step was taken.
        areas: Area at the end of the flow of each number of steps.
    """

    edit: Edit
    steps: int
    time_error_rms: float
    time_error_max: float
    area_error: float
    converged: bool
    areas: dict[int, float]

    def __repr__(self) -> str:
        """Return the estimate in one line, above the edit."""
        return (
            f"ConvergedSmoothing({self.steps} steps, error of the steps {self.time_error_rms:.2g} rms, "
            f"{self.time_error_max:.2g} at most, {'converged' if self.converged else 'not converged'}\n  {self.edit!r})"
        )


def converged_smooth(
    field: Field,
    *,
    time: float,
    steps: int = 8,
    tolerance: float = 2e-4,
    most_steps: int = 32,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> ConvergedSmoothing:
    """Smooth for a time in half the steps, in the steps, and in twice as many again and again until they do not matter.

    Args:
        field: The field to edit.
        time: Length of the flow, as `steps` times `step_size` of smooth.
        steps: Fewest steps of the result.
        tolerance: Of the rms of the error of the steps, as a part of the diagonal of the box round the tracked points.
        most_steps: No flow of more steps is begun, but one of `steps` always is.
        track: Surface points (M, D) to carry along and to compare flows on; None compares them on 1000 random ones.
        progress: Called as progress(step, steps, row) in each flow.
        **options: The others of smooth.

    Raises:
        ValueError: An option is out of range.
        TypeError: It is none of smooth.
    """
    require_field(field)
    track = field.in_precision(track)
    require_options(field, track=track, progress=progress)
    require_positive("time", time)
    require_whole("steps", steps)
    require_whole("most_steps", most_steps)
    require_positive("tolerance", tolerance)
    points = sample_surface(field, COMPARED).points if track is None else track
    size = float((points.max(dim=0).values - points.min(dim=0).values).norm())
    areas: dict[int, float] = {}
    error, area_error = (math.inf, math.inf), math.inf
    count, last = max(1, steps // 2), None
    while True:
        edit = smooth(field, steps=count, step_size=time / count, track=points, progress=progress, **options)
        whole = edit.status in (EditStatus.DONE, EditStatus.REACHED)
        if whole:
            areas[count] = float(edit.history[-1]["area"])
        if last is not None and whole:
            error = _distance(edit.field, last)
            area_error = abs(areas[count] - areas[max(k for k in areas if k < count)])
        finer = steps if count < steps else 2 * count
        good = whole and error[0] <= tolerance * size
        if count >= steps and (good or finer > max(most_steps, steps) or not whole):
            break
        last, count = edit.tracked if whole else None, finer
    return ConvergedSmoothing(edit, count, *error, area_error, good, areas)


def _distance(field: Field, points: Float[Tensor, "m d"] | None) -> tuple[float, float]:
    """Return how far points are from the surface of a field, to first order, rms and most."""
    if points is None or len(points) == 0:
        return math.inf, math.inf
    value, gradient = field.value_and_gradient(field.in_precision(points))
    distance = (value / field.gradient_length(gradient)).abs().double()
    distance = distance[torch.isfinite(distance)]
    return float(distance.square().mean().sqrt()), float(distance.max())
