"""The two editors on one subject: each operation by the neural field and by its mesh counterpart.

| operation | neural field | mesh |
|---|---|---|
| geometric | implicit.geometric_edit, the rest fixed | each vertex moved as wanted; meshref.biharmonic beside it |
| smooth | implicit.smooth with Volume() held | conformalised mean-curvature flow, rescaled to its volume |
| rigid | implicit.rigid_edit | meshref.killing, linear least squares; meshref.arap beside it |

Both start from the common mesh of the subject and give a displacement of its vertices, in the field's units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field as default, replace
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray

import implicit
import meshref
from compare.cases.case import Case
from compare.errors import Progress
from compare.runs.memory import with_peak_memory
from compare.runs.subject import Subject
from implicit.edits.targets import SummedTargets
from implicit.renamed import current_names

if TYPE_CHECKING:
    from implicit import Edit, Field

# Forward-mode derivatives in torch keep their state for the whole process: two threads that take them at once fail with
# "an invalid index", so threads take turns. Processes need not.
_FORWARD_MODE = Lock()


@dataclass(frozen=True, eq=False)
class Wanted:
    """What the handles of a case ask of the vertices of the common mesh."""

    handle: Int[ndarray, " n"]  # the handle that holds each vertex, counted from 1; 0 for none
    at: Bool[ndarray, " n"]  # which vertices are told where to go
    displacement: Float[ndarray, "n 3"]  # and where; zero elsewhere

    @property
    def largest(self) -> float:
        """The largest displacement asked for, the scale of relative errors; 0 if none is."""
        return float(np.linalg.norm(self.displacement, axis=1).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Halfway:
    """How far an editor had come after one of its steps."""

    displacement: Float[ndarray, "n 3"]  # of the vertices of the common mesh since the start
    seconds: float  # since the start
    volume: float | None = None  # of the field itself, where the editor measures it in every step
    area: float | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one editor made of a case."""

    displacement: Float[ndarray, "n 3"]  # of the vertices of the common mesh, in the field's units
    method: str  # which it was, and its settings, for a reader
    status: str  # how it ended, a sentence
    complete: bool  # whether it did all that was asked
    seconds: float
    field: Field | None = None  # the edited field, of the neural editor
    seconds_by_phase: Mapping[str, float] = default(default_factory=dict)  # as docs/metrics.md has them
    path: Sequence[Halfway] = ()  # after each step, of an editor that takes steps
    peak_memory: float | None = None  # megabytes, see compare.runs.memory
    details: Mapping[str, Any] = default(default_factory=dict)


def wanted_motion(case: Case, subject: Subject) -> Wanted:
    """The handles' wishes on the common mesh, by the rules of the editors of `implicit`.

    A geometric edit adds up the handles' displacements times their weights, and keeps the rest fixed, so every vertex
    has a target. A rigid edit prescribes the vertices with a weight above one half.

    Raises:
        ValueError: A handle holds no vertex.
    """
    points, normals = torch.from_numpy(subject.V), torch.from_numpy(subject.N)
    number_of = np.zeros(len(subject.V), dtype=np.int64)
    displacement = np.zeros_like(subject.V)
    handles = [spec.build() for spec in case.handles]
    targets = SummedTargets(handles, points, normals)
    for number, spec in enumerate(case.handles, start=1):
        weights = targets.handle_weights[number - 1].numpy()
        inside = weights > (0 if case.operation == "geometric" else 0.5)
        if not inside.any():
            raise ValueError(
                f"Handle {number} of the case ({spec.region}) holds no vertex of {case.name}. Handles are given in the "
                f"field's coordinates, where the shape spans {np.round(subject.V.min(0), 3)} to "
                f"{np.round(subject.V.max(0), 3)}."
            )
        if case.operation != "geometric":
            motion = handles[number - 1].position(1.0, points, normals) - points
            displacement[inside] = motion.numpy()[inside]
        number_of[inside] = number
    if case.operation == "geometric":
        displacement = targets.displacement().numpy()
    at = np.ones(len(subject.V), dtype=bool) if case.operation == "geometric" else number_of > 0
    return Wanted(number_of, at, displacement)


def edit_by_all(case: Case, subject: Subject, wanted: Wanted, progress: Progress | None = None) -> dict[str, Outcome]:
    """The case by every editor that has its operation: "implicit", "mesh", and a second mesh method beside them."""
    editors: dict[str, Callable[[], Outcome | None]] = {
        "implicit": lambda: edit_field(case, subject, progress),
        "mesh": lambda: edit_mesh(case, subject, wanted, progress),
    }
    if case.operation == "rigid":
        editors["mesh, ARAP"] = lambda: edit_mesh_by_arap(case, subject, wanted)
    if case.operation == "geometric":
        editors["mesh, biharmonic"] = lambda: edit_mesh_by_biharmonic(case, subject, wanted)
    sides = {}
    for name, editor in editors.items():
        outcome, peak = with_peak_memory(editor)
        if outcome is not None:
            sides[name] = replace(outcome, peak_memory=peak)
    return sides


def edit_field(case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
    """The case by the neural editor."""
    editors: dict[str, Callable[..., Edit]] = {
        "geometric": implicit.geometric_edit,
        "smooth": implicit.smooth,
        "rigid": implicit.rigid_edit,
    }
    options = current_names(editors[case.operation], case.parameters.get("implicit", {}))
    common: dict[str, Any] = {
        "track": torch.from_numpy(subject.V),
        "progress": _teller(progress, f"{case.operation}, neural field"),
        "seed": case.seed,
    }
    handles = [spec.build() for spec in case.handles]

    def run() -> Edit:
        if case.operation == "geometric":
            return implicit.geometric_edit(subject.field, handles, rest="fixed", **common, **options)
        if case.operation == "smooth":
            volume = (implicit.Volume(),)
            settings = {"steps": case.parameters["steps"], "step_size": case.parameters["step_size"]}
            return implicit.smooth(subject.field, constraints=volume, **settings, **common, **options)
        return implicit.rigid_edit(subject.field, handles, **common, **options)

    with _FORWARD_MODE:
        start = perf_counter()
        edit = run()
        seconds = perf_counter() - start
    if edit.tracked is None:
        raise RuntimeError("The edit did not carry the vertices of the common mesh along.")
    displacement = edit.tracked.double().numpy() - subject.V
    lost = ~np.isfinite(displacement).all(axis=1)
    if lost.any():
        raise RuntimeError(f"The edit lost {int(lost.sum())} of {len(lost)} vertices of the common mesh on the way.")
    method = {"geometric": "boundary sensitivity", "smooth": "curvature flow, volume held", "rigid": "AKVF"}
    details = {"steps": len(edit.history), "history": edit.history}
    if case.operation != "smooth":
        error = edit.error_field()
        error = error[torch.isfinite(error)]
        details |= {"error_field_rms": float(error.square().mean().sqrt()), "error_field_max": float(error.abs().max())}
    done = edit.status in (implicit.EditStatus.DONE, implicit.EditStatus.REACHED)
    return Outcome(
        displacement,
        method[case.operation],
        edit.status.value,
        done,
        seconds,
        field=edit.field,
        seconds_by_phase=_phases(edit, seconds),
        path=_path(edit, subject, seconds),
        details=details,
    )


def edit_mesh(case: Case, subject: Subject, wanted: Wanted, progress: Progress | None = None) -> Outcome:
    """The case by the mesh counterpart, the one that is compared with the neural editor."""
    options = dict(case.parameters.get("mesh", {}))
    tell = _teller(progress, f"{case.operation}, mesh")
    start = perf_counter()
    if case.operation == "geometric":
        return Outcome(wanted.displacement, "vertices moved as wanted", "Every vertex is moved as wanted.", True, 0.0)
    if case.operation == "smooth":
        options = {"method": "conformalised", "preserve_volume": "rescale", **options, "snapshot_every": 1}
        flow = meshref.mean_curvature_flow(
            subject.V,
            subject.F,
            steps=case.parameters["steps"],
            step_size=case.parameters["step_size"],
            progress=lambda step, steps: tell(step, steps, {}),
            **options,
        )
        seconds = perf_counter() - start
        return Outcome(
            flow.V - subject.V,
            f"{options['method']} curvature flow{', volume kept' if options['preserve_volume'] else ''}",
            flow.status.value,
            flow.status is meshref.FlowStatus.FINISHED,
            seconds,
            seconds_by_phase={"steps": seconds},
            path=[
                Halfway(V - subject.V, row.seconds) for V, row in zip(flow.snapshots[1:], flow.history[1:], strict=True)
            ],
            details={"steps": flow.steps_taken},
        )
    handles = np.flatnonzero(wanted.at)
    result = meshref.killing(subject.V, subject.F, handles, wanted.displacement[handles], **options)
    seconds, done = perf_counter() - start, result.status is meshref.KillingStatus.SOLVED
    method = "Killing least squares"
    return Outcome(result.displacement, method, result.status.value, done, seconds, seconds_by_phase=result.seconds)


def edit_mesh_by_arap(case: Case, subject: Subject, wanted: Wanted) -> Outcome:
    """A rigid case by as-rigid-as-possible deformation, the second mesh method."""
    handles = np.flatnonzero(wanted.at)
    start = perf_counter()
    result = meshref.arap(subject.V, subject.F, handles, subject.V[handles] + wanted.displacement[handles])
    seconds, done = perf_counter() - start, result.status is meshref.ArapStatus.CONVERGED
    return Outcome(
        result.V - subject.V,
        "ARAP",
        result.status.value,
        done,
        seconds,
        seconds_by_phase=result.seconds,
        details={"iterations": result.iterations},
    )


def edit_mesh_by_biharmonic(case: Case, subject: Subject, wanted: Wanted) -> Outcome | None:
    """A geometric case with its falloff left to a biharmonic deformation, the second mesh method.

    Vertices in the core of a region, at a weight of 1, are moved and those outside all regions held; those between
    follow smoothly. None where every vertex is one or the other.
    """
    points = torch.from_numpy(subject.V)
    weights = np.max([spec.build().weights(points).numpy() for spec in case.handles], axis=0)
    held = np.flatnonzero((weights == 0) | (weights > 1 - 1e-9))
    if len(held) in (0, len(weights)) or not (weights > 1 - 1e-9).any():
        return None
    start = perf_counter()
    result = meshref.biharmonic(subject.V, subject.F, held, wanted.displacement[held])
    seconds, done = perf_counter() - start, result.status is meshref.BiharmonicStatus.SOLVED
    return Outcome(
        result.displacement, "biharmonic", result.status.value, done, seconds, seconds_by_phase={"solve": seconds}
    )


def _phases(edit: Edit, seconds: float) -> dict[str, float]:
    """Where the seconds of a neural edit went: the least squares and their trials, the rest of the steps, the rest."""
    solves = sum(row["seconds_solve"] for row in edit.history)
    steps = sum(row["seconds"] for row in edit.history)
    return {"setup": seconds - steps, "solve": solves, "assembly": steps - solves}


def _path(edit: Edit, subject: Subject, seconds: float) -> list[Halfway]:
    before = seconds - sum(row["seconds"] for row in edit.history)  # sampling and checks come first, for the most part
    clock = before + np.cumsum([row["seconds"] for row in edit.history])
    return [
        Halfway(points.double().numpy() - subject.V, float(now), row.get("volume"), row.get("area"))
        for points, now, row in zip(edit.trail, clock, edit.history, strict=True)
    ]


def _teller(progress: Progress | None, what: str) -> Callable[[int, int, Mapping[str, Any]], None]:
    def tell(step: int, steps: int, row: Mapping[str, Any]) -> None:
        if progress is not None:
            progress(step, steps, what)

    return tell
