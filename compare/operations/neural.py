"""The part common to the neural editors of all operations: their arguments, and what is taken from their edits."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

import implicit
from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import Halfway, Outcome, teller
from implicit.renamed import current_names

if TYPE_CHECKING:
    from implicit import Edit

# Forward-mode derivatives in torch keep their state for the whole process: two threads that take them at once fail with
# "an invalid index", so threads take turns. Processes need not.
_FORWARD_MODE = Lock()

# Cells that an editor is given at most for a thin shape: where pieces change it looks again with five times as many,
# whose grid takes 0.8 GB of memory.
MOST_CELLS = 96


def run_edit(
    editor: Callable[..., Edit],
    case: Case,
    subject: Subject,
    method: str,
    progress: Progress | None = None,
    /,
    **arguments: Any,
) -> Outcome:
    """Edit the field of a subject, carry the common mesh along, and return what came of it.

    Args:
        editor: Of `implicit`; called with the field, the arguments, what every editor takes (track, progress, seed),
            and the case's own options.
        case: Its options are those under "implicit" in its parameters.
        subject: What is edited.
        method: The method's name, for a reader.
        progress: Called as progress(step, steps, what) after each step.
        arguments: Of the editor, beside the case's options.

    Raises:
        TypeError: A case's option is none that the editor takes, or one that it is given anyway.
        RuntimeError: The edit lost vertices of the common mesh.
    """
    options = current_names(editor, case.parameters.get("implicit", {}))
    finer = subject.resolution > case.resolution and _takes(editor, "resolution")
    if finer:  # the editor would see holes where there are none
        options["resolution"] = max(min(subject.resolution, MOST_CELLS), options.get("resolution", 0))
    common: dict[str, Any] = {
        "track": torch.from_numpy(subject.V),
        "progress": teller(progress, f"{case.operation}, neural field"),
        "seed": case.seed,
    }
    with _FORWARD_MODE:
        start = perf_counter()
        edited = editor(subject.field, **arguments, **common, **options)
        seconds = perf_counter() - start
    if edited.tracked is None:
        raise RuntimeError("The edit did not carry the vertices of the common mesh along.")
    displacement = edited.tracked.double().numpy() - subject.V
    lost = ~np.isfinite(displacement).all(axis=1)
    if lost.any():
        raise RuntimeError(f"The edit lost {int(lost.sum())} of {len(lost)} vertices of the common mesh on the way.")
    details = {"steps": len(edited.history), "history": edited.history}
    if case.handles:
        error = edited.error_field()
        error = error[torch.isfinite(error)]
        details |= {"error_field_rms": float(error.square().mean().sqrt()), "error_field_max": float(error.abs().max())}
    return Outcome(
        displacement,
        method,
        edited.status.value,
        edited.status in (implicit.EditStatus.DONE, implicit.EditStatus.REACHED),
        seconds,
        field=edited.field,
        seconds_by_phase=_phases(edited, seconds),
        path=_path(edited, subject, seconds),
        details=details,
        notes=[*edited.notes, *_events(edited), *([_finer(options["resolution"])] if finer else [])],
        estimates=_estimates(edited),
    )


def _takes(editor: Callable[..., Edit], name: str) -> bool:
    parameters = inspect.signature(editor).parameters
    return name in parameters or any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values())


def _finer(cells: int) -> str:
    return f"The shape has parts thinner than a cell of the case, so the editor looked at {cells} cells."


def _estimates(edit: Edit) -> dict[str, float]:
    """Return how well it is known that what an edit holds was held, where it holds anything."""
    last = edit.history[-1] if edit.history else {}
    return {"constraint_error": float(last["constraint_error"])} if "constraint_error" in last else {}


def _events(edit: Edit) -> list[str]:
    """Return what happened to the pieces of the surface on the way, as the steps have recorded it."""
    return [f"Step {row['step']:.0f}: {str(row['event']).rstrip('.')}." for row in edit.history if row.get("event")]


def _phases(edit: Edit, seconds: float) -> dict[str, float]:
    """Return where the seconds of an edit went: least squares and their trials, the rest of the steps, the rest."""
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
