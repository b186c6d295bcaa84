"""The numbers by which the two representations are compared, by the same calls on the same mesh.

For a displacement D of the vertices of the common mesh (V, F):

    killing_energy            integral of |P (J + J^T) P|^2, area-weighted and tangential, the headline
    killing_ambient           integral of |J + J^T|^2 with the full 3 x 3 Jacobian, charges rotations
    killing_notebook          the same summed without areas, a pure number that grows with the resolution
    killing_spokes_and_rims   with a rotation for each vertex, which also feels bending
    volume_drift, area_drift  (after - before) / before; of the field itself for the neural side
    arap_energy               what as-rigid-as-possible deformation minimises, spokes and rims; charges no rotation
    handle_error              distance of a handle vertex from where it was sent, rms and largest
    error, strain             see ERROR_MEANS, by operation: mean, rms, 95th percentile and largest

docs/metrics.md has every number of a record with its formula, unit and source.

Lengths, areas, volumes and energies (a squared length) are in the user's units; names ending in _relative and
_drift are pure numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

import implicit
import meshref
from compare.cases.case import Case
from compare.runs.operations import Halfway, Outcome, Wanted
from compare.runs.subject import Subject

FORMS: dict[str, Literal["membrane", "ambient", "notebook", "spokes-and-rims"]] = {
    "killing_energy": "membrane",
    "killing_ambient": "ambient",
    "killing_notebook": "notebook",
    "killing_spokes_and_rims": "spokes-and-rims",
}

ERROR_MEANS = {
    "geometric": "motion along the normal minus the wanted one",
    "smooth": "motion along the normal minus that of the other representation",
    "rigid": "local strain: half the root of the Killing energy density",
}


def error_field(case: Case, subject: Subject, wanted: Wanted, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
    """The error at each vertex of the common mesh, in the field's units; what it means stands in ERROR_MEANS."""
    if case.operation == "geometric":
        return ((own.displacement - wanted.displacement) * subject.N).sum(axis=1)
    if case.operation == "smooth":
        return ((own.displacement - other.displacement) * subject.N).sum(axis=1)
    return strain(subject, own.displacement)


def strain(subject: Subject, D: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Frobenius norm of the linear tangential strain at each vertex, the mean over its faces; a pure number."""
    V, F = subject.V, subject.F
    # P (J + J^T) P is twice the strain.
    of_face = np.sqrt(meshref.killing_energy_density(V, F, D)) / 2
    area = np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1) / 2
    weight = np.bincount(F.ravel(), np.repeat(area, 3), len(V))
    return np.bincount(F.ravel(), np.repeat(area * of_face, 3), len(V)) / weight


def measure(
    case: Case, subject: Subject, wanted: Wanted, outcome: Outcome, error: Float[ndarray, " n"]
) -> dict[str, Any]:
    """All numbers of one side."""
    V, F, D, scale = subject.V, subject.F, outcome.displacement, subject.scale
    moved = V + D
    row: dict[str, Any] = {"method": outcome.method, "status": outcome.status, "complete": outcome.complete}
    for name, form in FORMS.items():
        unit = 1.0 if form == "notebook" else scale**2
        row[name] = meshref.killing_energy(V, F, D, form=form) * unit
    row["arap_energy"] = meshref.arap_energy(V, F, moved) * scale**2
    before, after = meshref.volume(V, F), _volume(moved, F)
    area_before, area_after = meshref.area(V, F), _area(moved, F)
    row |= {
        "volume_before": before * scale**3,
        "volume_after": after * scale**3,
        "volume_drift": after / before - 1,
        "area_before": area_before * scale**2,
        "area_after": area_after * scale**2,
        "area_drift": area_after / area_before - 1,
        "displacement_max": float(np.linalg.norm(D, axis=1).max()) * scale,
    }
    weights = meshref.vertex_areas(V, F)
    name, unit = ("strain", 1.0) if case.operation == "rigid" else ("error", scale)
    row |= {f"{name}_{what}": value * unit for what, value in _statistics(error, weights).items()}
    if wanted.largest > 0:
        miss = np.linalg.norm(D - wanted.displacement, axis=1)[wanted.at]
        rms = _rms(miss, weights[wanted.at])
        row |= {
            "handle_error_rms": rms * scale,
            "handle_error_max": float(miss.max()) * scale,
            "handle_error_relative": rms / wanted.largest,
        }
    if case.operation == "geometric":
        row["error_relative"] = _rms(error, weights) / wanted.largest
    return row | {
        "seconds": outcome.seconds,
        "seconds_by_phase": dict(outcome.seconds_by_phase),
        "peak_memory": outcome.peak_memory,
        "details": dict(outcome.details),
    }


def curve(subject: Subject, outcome: Outcome, row: Mapping[str, Any]) -> list[dict[str, float]]:
    """How an edit went on its way, for drawing: a row for the start, and one after each step or for the only solve.

    Of the common mesh carried along; where the editor measured the field itself in every step, of the field.

    Args:
        subject: What was edited.
        outcome: Of one editor.
        row: The measures of its end.
    """
    V, F, scale = subject.V, subject.F, subject.scale
    volume, area = meshref.volume(V, F), meshref.area(V, F)
    rows = [dict.fromkeys(("step", "seconds", "volume_drift", "area_drift", "killing_energy"), 0.0)]
    for step, at in enumerate(outcome.path or [Halfway(outcome.displacement, outcome.seconds)], start=1):
        moved = V + at.displacement
        now = {
            "volume_drift": _volume(moved, F) / volume - 1,
            "area_drift": _area(moved, F) / area - 1,
            "killing_energy": meshref.killing_energy(V, F, at.displacement) * scale**2,
        }
        if at.volume is not None and at.area is not None:
            now["volume_drift"] = at.volume * scale**3 / row["volume_before"] - 1
            now["area_drift"] = at.area * scale**2 / row["area_before"] - 1
        rows.append({"step": float(step), "seconds": at.seconds, **now})
    return rows


def measure_field(subject: Subject, edited: implicit.Field, resolution: int = 64) -> dict[str, float]:
    """Volume and area of the field itself before and after, by fourth-order quadrature.

    They take the place of those of the common mesh carried along, which has the error of its flat triangles.
    """
    samples = [(field, implicit.surface_quadrature(field, resolution)) for field in (subject.field, edited)]
    row: dict[str, float] = {}
    for name, functional, power in (("volume", implicit.Volume(), 3), ("area", implicit.Area(), 2)):
        before, after = (functional.value(field, sample) for field, sample in samples)
        row |= {
            f"{name}_before": before * subject.scale**power,
            f"{name}_after": after * subject.scale**power,
            f"{name}_drift": after / before - 1,
        }
    return row


def between(
    subject: Subject,
    first: tuple[Float[ndarray, "n 3"], ndarray],
    second: tuple[Float[ndarray, "m 3"], ndarray],
    seed: int,
) -> dict[str, float]:
    """Two-sided distances between the two results, meshes in the field's coordinates."""
    distance = meshref.surface_distance(*first, *second, seed=seed)
    return {
        "chamfer": distance.chamfer * subject.scale,
        "hausdorff": distance.hausdorff * subject.scale,
        "distance_rms": distance.rms * subject.scale,
        "normal_consistency": distance.normal_consistency,
        "iou": meshref.iou(*first, *second, seed=seed),
    }


def _statistics(values: Float[ndarray, " n"], weights: Float[ndarray, " n"]) -> dict[str, float]:
    """Of a number a vertex: mean and rms over the area, the magnitude that 95 % of the area stay below, the largest."""
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
