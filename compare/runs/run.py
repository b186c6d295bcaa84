"""Run cases: both editors on the common mesh of the subject, measured alike, kept as records and files."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from os import PathLike
from pathlib import Path
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import Outcome, Target, operation_of
from compare.runs import records
from compare.runs.columns import SIDES
from compare.runs.measure import Edited, between, measure, measure_field
from compare.runs.operations import edit_by_all, target_motion
from compare.runs.provenance import provenance
from compare.runs.records import Artefact, Record
from compare.runs.rows import SideRow
from compare.runs.subject import describe, prepare_subject, saving_options


def run_case(
    case: Case,
    *,
    folder: str | PathLike[str] | None = None,
    keep_meshes: bool = True,
    progress: Progress | None = None,
) -> Record:
    """Edit the shape of a case as a field and as a mesh, and compare.

    Args:
        case: What to do.
        folder: Where the edited field and the meshes are written, with the subject, which cases of the same shape
            share; None writes nothing.
        keep_meshes: Whether the edited field and the meshes are written too; the subject always is.
        progress: Told of each step: (step, steps, what is being done).

    Returns:
        The record. It is not appended to any file; run_cases does that.

    Raises:
        InputError: The shape cannot be used.
        ValueError: A handle holds no part of the surface, or an option is not one that the editors take.
    """
    folder = None if folder is None else Path(folder)
    subject = prepare_subject(case, folder=folder, progress=progress)
    operation = operation_of(case.operation)
    target = target_motion(case, subject)
    sides = edit_by_all(case, subject, target, progress)
    errors = {
        name: operation.error_field(subject, target, side, sides["mesh" if name == "implicit" else "implicit"])
        for name, side in sides.items()
    }

    start = perf_counter()
    field = sides["implicit"].field
    assert field is not None
    result = implicit.extract_mesh(field, case.resolution)
    edited = Edited(measure_field(subject, field), meshref.component_count(*result))
    rows = {
        name: measure(case, subject, target, side, errors[name], edited=edited if name == "implicit" else None)
        for name, side in sides.items()
    }
    distances = between(subject, result, (subject.V + sides["mesh"].displacement, subject.F), case.seed)
    seconds = {**subject.seconds, "measures": perf_counter() - start}

    artefacts: Mapping[str, Artefact] = {}
    if folder is not None and keep_meshes:
        start = perf_counter()
        artefacts = _write(case, subject, target, sides, errors, result, folder)
        seconds["files"] = perf_counter() - start
    record = Record(
        case=case,
        key=case.key,
        status=" ".join(f"{name}: {sides[name].status}" for name in ("implicit", "mesh")),
        subject=describe(subject, operation.error_means),
        sides=rows,
        between=distances,
        seconds=seconds,
        notes=(*subject.notes, *_remarks(case, subject, rows)),
        artefacts=artefacts,
        provenance=provenance(case),
    )
    return Record.from_dict(record.to_dict())  # plain numbers and lists, the same as will be read from its row


def run_cases(
    cases: Sequence[Case],
    executor: Executor | None = None,
    *,
    folder: str | PathLike[str] | None = None,
    keep_meshes: bool = True,
    progress: Progress | None = None,
    on_record: Callable[[Record], None] | None = None,
) -> list[Record]:
    """Run every case, here or on any concurrent.futures.Executor.

    A case that fails becomes a record with its reason; it never ends the others. Of a pool of processes in which one
    may be killed, take compare.Workers: in the standard ProcessPoolExecutor all that is not done yet fails with it.

    Args:
        cases: What to do; each carries its own seed. One that is named twice is done once.
        executor: Where; None runs them here, one after another. Its workers must see the same files.
        folder: A run folder: each record is appended to its results.jsonl as it comes, and cases whose key is there
            already without a failure are not run again.
        keep_meshes: As for run_case.
        progress: As for run_case; told only of what runs here.
        on_record: Called with each record as it comes.

    Returns:
        The records in the order of the cases, those found in the folder included.
    """
    if not isinstance(cases, list | tuple) or not all(isinstance(case, Case) for case in cases):
        raise TypeError(f"cases must be a list of Case(shape, operation, ...), but are {cases!r:.200}.")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise TypeError(f"executor must be None or a concurrent.futures.Executor, but is {executor!r}.")
    folder = None if folder is None else Path(folder).absolute()
    done: dict[str, Record] = {}
    if folder is not None and (folder / records.FILE).is_file():
        done = {r.key: r for r in records.read(folder) if not r.failed}
    missing = list({case.key: case for case in cases if case.key not in done}.values())
    results: Iterable[Record]
    if executor is None:
        results = (_record_of(case, folder, keep_meshes, progress) for case in missing)
    else:
        results = _results(missing, executor, folder, keep_meshes)
    for record in results:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            records.append(folder / records.FILE, record)
        done[record.key] = record
        if on_record is not None:
            on_record(record)
    return [done[case.key] for case in cases]


def _results(
    cases: Sequence[Case], executor: Executor, folder: Path | None, keep_meshes: bool
) -> Generator[Record, None, None]:
    """Yield records as they come. In a folder, the first case of a subject prepares what the others share."""

    def group_of(case: Case) -> str:
        return case.key if folder is None else case.subject_key

    waiting: dict[str, list[Case]] = {}
    for case in cases:
        waiting.setdefault(group_of(case), []).append(case)

    def submit(case: Case) -> Future[Record]:
        try:
            return executor.submit(_record_of, case, folder, keep_meshes)
        except Exception as error:  # the pool is broken; what it has not done becomes rows all the same
            refused: Future[Record] = Future()
            refused.set_exception(error)
            return refused

    running = {submit(group[0]): group[0] for group in waiting.values()}
    try:
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                case = running.pop(future)
                running |= {submit(other): other for other in waiting.pop(group_of(case), [])[1:]}
                yield _result(future, case)
    finally:  # Ctrl-C, or a full disk: nothing more is begun
        for future in running:
            future.cancel()


def _result(future: Future[Record], case: Case) -> Record:
    try:
        return future.result()
    except Exception as error:  # the worker itself died; what the case raised is in its record already
        return _failure(case, error)


def _record_of(case: Case, folder: Path | None, keep_meshes: bool, progress: Progress | None = None) -> Record:
    try:
        return run_case(case, folder=folder, keep_meshes=keep_meshes, progress=progress)
    except Exception as error:  # whatever it is, it belongs to this case alone, and stands in its row
        return _failure(case, error)


def _failure(case: Case, error: Exception) -> Record:
    reason = f"{type(error).__name__}: {error}"
    return Record(case, case.key, f"Failed. {reason}", failed=True, provenance=provenance(case))


def _remarks(case: Case, subject: Subject, rows: Mapping[str, SideRow]) -> list[str]:
    """Return what a reader of the numbers must know: which editor stopped short, and a surface that fell to pieces."""
    what = f"{case.name}, {case.operation}"
    remarks = [f"{what}, {SIDES.get(name, name)}: {row.status}" for name, row in rows.items() if not row.complete]
    before, after = meshref.component_count(subject.V, subject.F), rows["implicit"].bodies
    if before != after:
        remarks.append(
            f"{what}: the surface of the field is in {after} pieces after the edit, and was in {before} before."
        )
    return remarks


def _write(
    case: Case,
    subject: Subject,
    target: Target,
    sides: Mapping[str, Outcome],
    errors: Mapping[str, Float[ndarray, " n"]],
    result: tuple[Float[ndarray, "k 3"], ndarray],
    folder: Path,
) -> dict[str, Artefact]:
    """Write the edited field, and three meshes in the user's units: before, with the number of the handle as
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
    implicit.save_field(edited, paths["field"], **saving_options(case))
    length = subject.scale if operation_of(case.operation).error_is_length else 1.0

    meshref.write_mesh(paths["before"], subject.to_user(subject.V), subject.F, quality=target.handle.astype(float))
    V, F = result
    error = _carried_over(subject.V + sides["implicit"].displacement, errors["implicit"], V)
    meshref.write_mesh(paths["implicit"], subject.to_user(V), F, quality=error * length)
    moved = subject.V + sides["mesh"].displacement
    meshref.write_mesh(paths["mesh"], subject.to_user(moved), subject.F, quality=errors["mesh"] * length)
    return {name: Artefact.of(path, folder) for name, path in paths.items()}


def _carried_over(
    points: Float[ndarray, "n 3"], values: Float[ndarray, " n"], V: Float[ndarray, "k 3"]
) -> Float[ndarray, " k"]:
    """Return values known at points, at other points of the surface: the mean of the three nearest, by closeness."""
    distance, nearest = cKDTree(points).query(V, k=3)
    weight = 1 / np.maximum(distance, 1e-12)
    return (values[nearest] * weight).sum(axis=1) / weight.sum(axis=1)
