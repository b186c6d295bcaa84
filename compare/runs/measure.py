"""The numbers by which the two representations are compared, by the same calls on the same mesh.

For a displacement D of the vertices of the common mesh (V, F):

    killing_energy            integral of |P (J + J^T) P|^2, area-weighted and tangential, the headline
    killing_ambient           integral of |J + J^T|^2 with the full 3 x 3 Jacobian, charges rotations
    killing_notebook          the same summed without areas, a pure number that grows with the resolution
    killing_spokes_and_rims   with a rotation for each vertex, which also feels bending
    volume_drift, area_drift  (after - before) / before; of the field itself for the neural side
    arap_energy               what as-rigid-as-possible deformation minimises, spokes and rims; charges no rotation
    handle_error              distance of a handle vertex from its target, rms and largest
    error, strain             the operation's error_field: mean, rms, 95th percentile and largest

docs/metrics.md has every number of a record with its formula, unit and source.

Lengths, areas, volumes and energies (a squared length) are in the user's units; names ending in _relative and
_drift are pure numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.subject import Subject, volume_and_area
from compare.operations.operation import Halfway, Outcome, Target, operation_of
from compare.runs.rows import BetweenRow, CurveRow, SideRow

FORMS: dict[str, Literal["membrane", "ambient", "notebook", "spokes-and-rims"]] = {
    "killing_energy": "membrane",
    "killing_ambient": "ambient",
    "killing_notebook": "notebook",
    "killing_spokes_and_rims": "spokes-and-rims",
}


def measure(
    case: Case,
    subject: Subject,
    target: Target,
    outcome: Outcome,
    error: Float[ndarray, " n"] | None,
    *,
    edited: Edited | None = None,
) -> SideRow:
    """Return all numbers of one side.

    Args:
        case: What was done.
        subject: To what.
        target: What the handles say.
        outcome: Of one editor.
        error: Of the outcome at each vertex, as the operation has it, in the field's units; None where it takes the
            outcome of the other representation, and there is none.
        edited: Of the field itself, for the neural side; its volume and area take the place of the carried mesh's.
    """
    operation, scale = operation_of(case.operation), subject.scale
    V, F, D = subject.V, subject.F, outcome.displacement
    weights = meshref.vertex_areas(V, F)
    unit = scale if operation.error_is_length else 1.0
    statistics = {} if error is None else _statistics(error, weights)
    row = {
        "method": outcome.method,
        "status": outcome.status,
        "complete": outcome.complete,
        **_energies(subject, D),
        **(_of_mesh(subject, V + D) if edited is None else edited.sizes),
        "displacement_max": float(np.linalg.norm(D, axis=1).max()) * scale,
        **{f"{operation.error_name}_{what}": value * unit for what, value in statistics.items()},
        **_missed(subject, target, D, weights),
        **outcome.estimates,
        "seconds": outcome.seconds,
        "seconds_by_phase": dict(outcome.seconds_by_phase),
        "peak_memory": outcome.peak_memory,
        "details": dict(outcome.details),
        **({} if edited is None else {"bodies": edited.bodies}),
    }
    if operation.error_over_target and error is not None:
        row["error_relative"] = _rms(error, weights) / target.largest
    return SideRow.from_row({**row, "curve": curve(subject, outcome, row)})


def _energies(subject: Subject, D: Float[ndarray, "n 3"]) -> dict[str, float]:
    V, F, square = subject.V, subject.F, subject.scale**2
    row = {
        name: meshref.killing_energy(V, F, D, form=form) * (1.0 if form == "notebook" else square)
        for name, form in FORMS.items()
    }
    return {**row, "arap_energy": meshref.arap_energy(V, F, V + D) * square}


def _of_mesh(subject: Subject, moved: Float[ndarray, "n 3"]) -> dict[str, float]:
    """Return volume and area of the common mesh before, and of its moved vertices."""
    before, after = meshref.volume(subject.V, subject.F), _volume(moved, subject.F)
    area_before, area_after = meshref.area(subject.V, subject.F), _area(moved, subject.F)
    return _sizes(subject.scale, (before, after), (area_before, area_after))


def _sizes(scale: float, volume: tuple[float, float], area: tuple[float, float]) -> dict[str, float]:
    """Return volume and area before and after, given in the field's units, in the user's."""
    return {
        "volume_before": volume[0] * scale**3,
        "volume_after": volume[1] * scale**3,
        "volume_drift": volume[1] / volume[0] - 1,
        "area_before": area[0] * scale**2,
        "area_after": area[1] * scale**2,
        "area_drift": area[1] / area[0] - 1,
    }


def _missed(
    subject: Subject, target: Target, D: Float[ndarray, "n 3"], weights: Float[ndarray, " n"]
) -> dict[str, float]:
    """Return how far the handles ended from their targets; nothing where there are none."""
    if target.largest == 0:
        return {}
    miss = np.linalg.norm(D - target.displacement, axis=1)[target.at]
    rms = _rms(miss, weights[target.at])
    return {
        "handle_error_rms": rms * subject.scale,
        "handle_error_max": float(miss.max()) * subject.scale,
        "handle_error_relative": rms / target.largest,
    }


def curve(subject: Subject, outcome: Outcome, row: Mapping[str, Any]) -> list[CurveRow]:
    """Return how an edit went on its way: a row for the start, and one after each step or for the only solve.

    Of the common mesh carried along; where the editor measured the field itself in every step, of the field.

    Args:
        subject: What was edited.
        outcome: Of one editor.
        row: The measures of its end.
    """
    V, F, scale = subject.V, subject.F, subject.scale
    volume, area = meshref.volume(V, F), meshref.area(V, F)
    rows = [CurveRow(step=0.0, seconds=0.0, volume_drift=0.0, area_drift=0.0, killing_energy=0.0)]
    for step, at in enumerate(outcome.path or [Halfway(outcome.displacement, outcome.seconds)], start=1):
        moved = V + at.displacement
        volume_drift, area_drift = _volume(moved, F) / volume - 1, _area(moved, F) / area - 1
        if at.volume is not None and at.area is not None:
            volume_drift = at.volume * scale**3 / row["volume_before"] - 1
            area_drift = at.area * scale**2 / row["area_before"] - 1
        rows.append(
            CurveRow(
                step=float(step),
                seconds=at.seconds,
                volume_drift=volume_drift,
                area_drift=area_drift,
                killing_energy=meshref.killing_energy(V, F, at.displacement) * scale**2,
            )
        )
    return rows


@dataclass(frozen=True)
class Edited:
    """Measures of the edited field itself, apart from the common mesh."""

    sizes: Mapping[str, float]  # volume and area, before and after, and their drifts
    bodies: int  # of the extracted mesh


def measure_field(subject: Subject, edited: implicit.Field) -> dict[str, float]:
    """Return volume and area of the field itself before and after, by fourth-order quadrature, with their errors.

    They take the place of those of the common mesh carried along, which has the error of its flat triangles.
    """
    (volume, area), (volume_after, area_after) = subject.integrals, volume_and_area(edited)
    return {
        **_sizes(subject.scale, (volume.value, volume_after.value), (area.value, area_after.value)),
        "volume_error": (volume.error + volume_after.error) / abs(volume.value),
        "area_error": (area.error + area_after.error) / abs(area.value),
    }


def between(
    subject: Subject,
    first: tuple[Float[ndarray, "n 3"], ndarray],
    second: tuple[Float[ndarray, "m 3"], ndarray],
    seed: int,
) -> BetweenRow:
    """Return two-sided distances between the two results, meshes in the field's coordinates."""
    distance = meshref.surface_distance(*first, *second, seed=seed)
    return BetweenRow(
        chamfer=distance.chamfer * subject.scale,
        hausdorff=distance.hausdorff * subject.scale,
        distance_rms=distance.rms * subject.scale,
        normal_consistency=distance.normal_consistency,
        iou=meshref.iou(*first, *second, seed=seed),
    )


def _statistics(values: Float[ndarray, " n"], weights: Float[ndarray, " n"]) -> dict[str, float]:
    """Return mean and rms over the area of a number a vertex, the magnitude that 95 % stay below, and the largest."""
    size = np.abs(values)
    order = np.argsort(size)
    share = np.cumsum(weights[order]) / weights.sum()
    return {
        "mean": float(np.average(values, weights=weights)),
        "rms": _rms(values, weights),
        "p95": float(size[order][np.searchsorted(share, 0.95)]),
        "max": float(size.max()),
    }


def _rms(values: Float[ndarray, " n"], weights: Float[ndarray, " n"]) -> float:
    return float(np.sqrt(np.average(values**2, weights=weights)))


def _volume(V: Float[ndarray, "n 3"], F: ndarray) -> float:
    # Of the moved vertices, which may have folded faces that meshref would rightly refuse elsewhere.
    A, B, C = (V - V.mean(axis=0))[F].transpose(1, 0, 2)
    return float((A * np.cross(B, C)).sum() / 6)


def _area(V: Float[ndarray, "n 3"], F: ndarray) -> float:
    return float(np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1).sum() / 2)
