"""The two editors on one subject: where the handles of a case send the common mesh, and what each editor makes of it.

Both start from the common mesh of the subject and give a displacement of its vertices, in the field's units. Which
editors an operation has stands in its file in `compare.operations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from compare.cases.case import Case
from compare.cases.handles import rounded
from compare.cases.subject import Subject
from compare.errors import Progress, begin
from compare.operations.cavities import carried
from compare.operations.operation import Editor, Outcome, Target, operation_of
from compare.runs.columns import SIDES
from compare.runs.memory import with_peak_memory
from implicit.edits.targets import SummedTargets


def target_motion(case: Case, subject: Subject) -> Target:
    """Return where the handles send the common mesh, by the rules of the editors of `implicit`.

    Where the operation sums its handles, their displacements are added up times their weights and every vertex has a
    target; else the vertices with a weight above one half are prescribed.

    Raises:
        ValueError: A handle holds no vertex.
    """
    points, normals = torch.from_numpy(subject.V), torch.from_numpy(subject.N)
    number_of = np.zeros(len(subject.V), dtype=np.int64)
    displacement = np.zeros_like(subject.V)
    handles = [spec.build() for spec in case.handles]
    targets = SummedTargets(handles, points, normals)
    summed = operation_of(case.operation).sums_handles
    for number, spec in enumerate(case.handles, start=1):
        inside = targets.handle_weights[number - 1].numpy() > (0 if summed else 0.5)
        if not inside.any():
            raise ValueError(
                f"Handle {number} of the case ({spec.region}) holds no vertex of {case.name}. Handles are given in the "
                f"field's coordinates. {_spans(subject)} Move or widen the region."
            )
        motion = handles[number - 1].position(1.0, points, normals) - points
        displacement[inside] = motion.numpy()[inside]
        number_of[inside] = number
    if summed:
        return Target(number_of, np.ones(len(subject.V), dtype=bool), targets.displacement().numpy())
    return Target(number_of, number_of > 0, displacement)


def _spans(subject: Subject) -> str:
    """Return where the shape is, in the field's coordinates and in the user's."""
    corners = np.stack([subject.V.min(axis=0), subject.V.max(axis=0)])
    field = " to ".join(str(rounded(corner)) for corner in corners)
    user = " to ".join(str(rounded(corner)) for corner in subject.to_user(corners))
    said = f"In these the shape spans {field}"
    return f"{said}." if field == user else f"{said}; in the user's, those of its file, {user}."


def edit_by_all(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> dict[str, Outcome]:
    """Return the outcomes of all editors of a case's operation, by side.

    Raises:
        Exception: One of them fails.
    """
    sides, failures = edit_by_each(case, subject, target, progress)
    for error in failures.values():
        raise error
    return sides


def edit_by_each(
    case: Case, subject: Subject, target: Target, progress: Progress | None = None
) -> tuple[dict[str, Outcome], dict[str, Exception]]:
    """Return the outcomes of all editors of a case's operation: "implicit", "mesh", and further mesh methods.

    Returns:
        The outcomes by side; and for sides that failed, why. One that fails leaves the others their rows.

    Raises:
        TypeError: The case has an option that an editor does not take.
        Exception: The editor of the field and the first of the mesh both failed; what the first said.
    """
    operation = operation_of(case.operation)
    sides: dict[str, Outcome] = {}
    failures: dict[str, Exception] = {}

    def add(editors: Mapping[str, Editor]) -> None:
        for name, editor in editors.items():
            begin(progress, f"{case.operation}, {SIDES.get(name, name)}")
            try:
                outcome, peak = with_peak_memory(partial(editor, case, subject, target, progress))
            except TypeError:
                raise
            except Exception as error:  # whatever it is, it belongs to this side alone, and stands in its row
                failures[name] = error
                continue
            if outcome is not None:
                sides[name] = replace(outcome, peak_memory=peak)

    add({"implicit": _edit_field, **_carried(operation.mesh_editors())})
    if "implicit" in sides:  # to whose error at the handles those go
        add(_carried(operation.mesh_editors_beside(subject, target, sides["implicit"])))
    if not {"implicit", "mesh"} & set(sides):
        raise failures["implicit"] if "implicit" in failures else next(iter(failures.values()))
    return sides, failures


def _carried(editors: Mapping[str, Editor]) -> dict[str, Editor]:
    """Return the editors of a mesh, each of which takes the cavities of a body along."""
    return {name: partial(carried, editor) for name, editor in editors.items()}


def _edit_field(case: Case, subject: Subject, target: Target, progress: Progress | None) -> Outcome:
    return operation_of(case.operation).edit_field(case, subject, progress)
