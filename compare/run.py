"""Run cases: both editors on the common mesh of the subject, measured alike, kept as records and files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

import implicit
import meshref
from compare import records
from compare.case import Case
from compare.measure import ERROR_MEANS, between, curve, error_field, measure, measure_field
from compare.operations import Outcome, Wanted, edit_by_all, wanted_motion
from compare.records import Artefact, Record
from compare.subject import Progress, Subject, describe, prepare_subject
from compare.table import SIDES


def run_case(case: Case, *, folder: str | PathLike[str] | None = None, progress: Progress | None = None) -> Record:
    """Edit the shape of a case as a field and as a mesh, and compare.

    Args:
        case: What to do.
        folder: Where the edited field and the meshes are written, with the subject, which cases of the same shape
            share; None writes nothing.
        progress: Told of each step: (step, steps, what is being done).

    Returns:
        The record. It is not appended to any file; run_cases does that.

    Raises:
        InputError: The shape cannot be used.
        ValueError: A handle holds no part of the surface, or an option is not one that the editors take.
    """
    folder = None if folder is None else Path(folder)
    subject = prepare_subject(case, folder=folder, progress=progress)
    wanted = wanted_motion(case, subject)
    sides = edit_by_all(case, subject, wanted, progress)
    errors = {
        name: error_field(case, subject, wanted, side, sides["mesh" if name == "implicit" else "implicit"])
        for name, side in sides.items()
    }

    start = perf_counter()
    rows = {name: measure(case, subject, wanted, side, errors[name]) for name, side in sides.items()}
    edited = sides["implicit"].field
    assert edited is not None
    result = implicit.extract_mesh(edited, case.resolution)
    rows["implicit"] |= measure_field(subject, edited)
    rows["implicit"]["bodies"] = meshref.component_count(*result)
    for name, side in sides.items():
        rows[name]["curve"] = curve(subject, side, rows[name])
    distances = between(subject, result, (subject.V + sides["mesh"].displacement, subject.F), case.seed)
    seconds = {**subject.seconds, "measures": perf_counter() - start}

    artefacts: Mapping[str, Artefact] = {}
    if folder is not None:
        start = perf_counter()
        artefacts = _write(case, subject, wanted, sides, errors, result, folder)
        seconds["files"] = perf_counter() - start
    record = Record(
        case=case,
        key=case.key,
        status=" ".join(f"{name}: {sides[name].status}" for name in ("implicit", "mesh")),
        subject={**describe(subject), "error_means": ERROR_MEANS[case.operation]},
        sides=rows,
        between=distances,
        seconds=seconds,
        notes=(*subject.notes, *_remarks(case, subject, rows)),
        artefacts=artefacts,
        provenance=records.provenance(case.seed),
    )
    return Record.from_dict(record.to_dict())  # plain numbers and lists, the same as will be read from its row


def run_cases(
    cases: Sequence[Case],
    executor: Executor | None = None,
    *,
    folder: str | PathLike[str] | None = None,
    progress: Progress | None = None,
    on_record: Callable[[Record], None] | None = None,
) -> list[Record]:
    """Run every case, here or on any concurrent.futures.Executor.

    A case that fails becomes a record with its reason; it never ends the others.

    Args:
        cases: What to do; each carries its own seed.
        executor: Where; None runs them here, one after another.
        folder: A run folder: each record is appended to its results.jsonl as it comes, and cases whose key is there
            already without a failure are not run again.
        progress: As for run_case; told only of what runs here.
        on_record: Called with each record as it comes.

    Returns:
        The records in the order of the cases, those found in the folder included.
    """
    path = None if folder is None else Path(folder) / records.FILE
    done: dict[str, Record] = {}
    if path is not None and path.is_file():
        done = {r.key: r for r in records.read(path) if not r.failed}
    missing = [case for case in cases if case.key not in done]
    for record in _results(missing, executor, folder, progress):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            records.append(path, record)
        done[record.key] = record
        if on_record is not None:
            on_record(record)
    return [done[case.key] for case in cases]


def _results(
    cases: Sequence[Case], executor: Executor | None, folder: str | PathLike[str] | None, progress: Progress | None
) -> Iterator[Record]:
    if executor is None:
        for case in cases:
            yield _record_of(case, folder, progress)
        return
    futures = {executor.submit(_record_of, case, folder): case for case in cases}
    for future in as_completed(futures):
        try:
            yield future.result()
        except Exception as error:  # the worker itself died; what the case raised is in its record already
            yield _failure(futures[future], error)


def _record_of(case: Case, folder: str | PathLike[str] | None, progress: Progress | None = None) -> Record:
    try:
        return run_case(case, folder=folder, progress=progress)
    except Exception as error:  # whatever it is, it belongs to this case alone, and stands in its row
        return _failure(case, error)


def _failure(case: Case, error: Exception) -> Record:
    reason = f"{type(error).__name__}: {error}"
    return Record(case, case.key, f"Failed. {reason}", failed=True, provenance=records.provenance(case.seed))


def _remarks(case: Case, subject: Subject, rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """What a reader of the numbers must know: which editor stopped short, and a surface that fell to pieces."""
    what = f"{case.name}, {case.operation}"
    remarks = [f"{what}, {SIDES[name]}: {row['status']}" for name, row in rows.items() if not row["complete"]]
    before, after = meshref.component_count(subject.V, subject.F), rows["implicit"]["bodies"]
    if before != after:
        remarks.append(
            f"{what}: the surface of the field is in {after} pieces after the edit, and was in {before} before."
        )
    return remarks


def _write(
    case: Case,
    subject: Subject,
    wanted: Wanted,
    sides: Mapping[str, Outcome],
    errors: Mapping[str, Float[ndarray, " n"]],
    result: tuple[Float[ndarray, "k 3"], ndarray],
    folder: Path,
) -> dict[str, Artefact]:
    """The edited field, and three meshes in the user's units: before, with the number of the handle as
    vertex quality, and the two results, with the error."""
    stem = f"{case.name}-{case.operation}-{case.key}"
    paths = {
        "field": folder / "fields" / f"{stem}.safetensors",
        "before": folder / "meshes" / f"{stem}-before.ply",
        "implicit": folder / "meshes" / f"{stem}-implicit.ply",
        "mesh": folder / "meshes" / f"{stem}-mesh.ply",
    }
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    edited = sides["implicit"].field
    assert edited is not None
    implicit.save_field(edited, paths["field"])
    length = 1.0 if case.operation == "rigid" else subject.scale

    meshref.write_mesh(paths["before"], subject.to_user(subject.V), subject.F, quality=wanted.handle.astype(float))
    V, F = result
    error = _carried_over(subject.V + sides["implicit"].displacement, errors["implicit"], V)
    meshref.write_mesh(paths["implicit"], subject.to_user(V), F, quality=error * length)
    moved = subject.V + sides["mesh"].displacement
    meshref.write_mesh(paths["mesh"], subject.to_user(moved), subject.F, quality=errors["mesh"] * length)
    return {name: Artefact.of(path, folder) for name, path in paths.items()}


def _carried_over(
    points: Float[ndarray, "n 3"], values: Float[ndarray, " n"], V: Float[ndarray, "k 3"]
) -> Float[ndarray, " k"]:
    """Values known at points, at other points of the same surface: the mean of the three nearest, by closeness."""
    distance, nearest = cKDTree(points).query(V, k=3)
    weight = 1 / np.maximum(distance, 1e-12)
    return (values[nearest] * weight).sum(axis=1) / weight.sum(axis=1)
