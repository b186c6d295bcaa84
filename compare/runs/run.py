"""Run cases: both editors on the common mesh of the subject, measured alike, kept as records and files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.placing import placed
from compare.cases.subject import Subject
from compare.errors import Progress, begin, naming
from compare.operations.operation import Outcome, Target, operation_of
from compare.runs import records
from compare.runs.columns import SIDES
from compare.runs.measure import Edited, between, measure, measure_field
from compare.runs.operations import edit_by_each, target_motion
from compare.runs.provenance import provenance
from compare.runs.records import Artefact, Record
from compare.runs.rows import BetweenRow, SideRow
from compare.runs.subject import describe, keep_mended, prepare_subject, saving_options


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
        progress: Called as progress(step, steps, what) after each step: its number, how many there are, and in words
            what is being done.

    Returns:
        The record. It is not appended to any file; run_cases does that.

    Raises:
        InputError: The shape cannot be used.
        ValueError: A handle holds no part of the surface.
        TypeError: An option is not one that the editors take.
        Exception: The neural editor and the first of the mesh both fail. If one of them does, its row says why, the
            record is marked as failed, and the other has its numbers.
    """
    folder = None if folder is None else Path(folder)
    subject = prepare_subject(case, folder=folder, progress=progress)
    progress = naming(progress, case.name)
    given, case = case, placed(case, subject)
    operation = operation_of(case.operation)
    target = target_motion(case, subject)
    sides, failures = edit_by_each(case, subject, target, progress)
    errors = {name: _error(case, subject, target, name, sides) for name in sides}

    begin(progress, f"{case.operation}, measures")
    start = perf_counter()
    result, edited = _edited_surface(case, subject, sides, failures)
    rows = {
        name: measure(case, subject, target, side, errors[name], edited=edited if name == "implicit" else None)
        for name, side in sides.items()
    }
    rows |= {name: _failed_side(error) for name, error in failures.items()}
    distances = BetweenRow()
    if result is not None and "mesh" in sides:
        distances = between(subject, result, (subject.V + sides["mesh"].displacement, subject.F), case.seed)
    seconds = {**subject.seconds, "measures": perf_counter() - start}

    artefacts: Mapping[str, Artefact] = {}
    if folder is not None and keep_meshes:
        start = perf_counter()
        artefacts = _write(given, subject, target, sides, errors, result, folder)
        seconds["files"] = perf_counter() - start
    record = Record(
        case=given,
        key=given.key,
        status=" ".join(f"{name}: {rows[name].status}" for name in ("implicit", "mesh")),
        failed=bool(failures),
        subject=describe(subject, operation.error_means),
        sides={name: rows[name] for name in ("implicit", *rows) if name in rows},
        between=distances,
        seconds=seconds,
        notes=(*subject.notes, *_remarks(case, subject, sides, rows)),
        artefacts=artefacts,
        provenance=provenance(given),
    )
    return Record.from_dict(record.to_dict())  # plain numbers and lists, the same as will be read from its row


Surface = tuple[Float[ndarray, "k 3"], ndarray]


def _error(
    case: Case, subject: Subject, target: Target, name: str, sides: Mapping[str, Outcome]
) -> Float[ndarray, " n"] | None:
    """Return the error of one side at each vertex; None where it needs another side that failed."""
    operation, other = operation_of(case.operation), sides.get("mesh" if name == "implicit" else "implicit")
    if other is None and operation.error_needs_other:
        return None
    return operation.error_field(subject, target, sides[name], sides[name] if other is None else other)


def _edited_surface(
    case: Case, subject: Subject, sides: dict[str, Outcome], failures: dict[str, Exception]
) -> tuple[Surface | None, Edited | None]:
    """Return the surface of the edited field and its measures; None where the neural side failed.

    It has failed, too, where the edited field has no closed surface in its bounds. Then its outcome is taken away.
    """
    if "implicit" not in sides:
        return None, None
    field = sides["implicit"].field
    assert field is not None
    try:
        surface = implicit.extract_mesh(field, subject.cells(case.resolution))
        return surface, Edited(measure_field(subject, field), meshref.component_count(*surface))
    except implicit.SurfaceError as error:
        if "mesh" not in sides:
            raise
        failures["implicit"] = error
        del sides["implicit"]
        return None, None


def _failed_side(error: Exception) -> SideRow:
    return SideRow(method="", status=f"Failed. {type(error).__name__}: {error}", complete=False)


def run_cases(
    cases: Sequence[Case],
    executor: Executor | None = None,
    *,
    folder: str | PathLike[str] | None = None,
    keep_meshes: bool = True,
    progress: Progress | None = None,
    on_record: Callable[[Record], None] | None = None,
    on_failure: Literal["warn", "raise", "record"] = "warn",
) -> list[Record]:
    """Run every case, here or on any concurrent.futures.Executor.

    A case that fails becomes a record with its reason in `status`, and ends the others only where that is asked for.
    Of a pool of processes in which one may be killed, take compare.Workers: in the standard ProcessPoolExecutor all
    that is not done yet fails with it.

    Args:
        cases: What to do; each carries its own seed. One that is named twice is done once.
        executor: Where; None runs them here, one after another. Its workers must see the same files.
        folder: A run folder: each record is appended to its results.jsonl as it comes, and cases whose key is there
            already without a failure are not run again.
        keep_meshes: As for run_case.
        progress: As for run_case; told only of what runs here.
        on_record: Called with each record as it comes.
        on_failure: "warn" gives a UserWarning for each record that has failed, whose `sides` lack what failed or are
            empty; "raise" ends at the first one, which is kept in the folder; "record" leaves it to the reader of
            `failed` and `status`.

    Returns:
        The records in the order of the cases, those found in the folder included.

    Raises:
        TypeError: The cases or the executor are none.
        ValueError: on_failure is another word.
        RuntimeError: A case failed, and on_failure is "raise".
    """
    if on_failure not in ("warn", "raise", "record"):
        raise ValueError(f'on_failure must be "warn", "raise" or "record", but is {on_failure!r}.')
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
        if record.failed:
            _tell(record, on_failure)
    return [done[case.key] for case in cases]


def _tell(record: Record, on_failure: str) -> None:
    """Say of a record that it failed, as the caller of run_cases wants it said."""
    said = f"{record.case.name}, {record.case.operation}: {record.status}"
    if on_failure == "raise":
        raise RuntimeError(said)
    if on_failure == "warn":
        warnings.warn(said, stacklevel=3)


def _results(
    cases: Sequence[Case], executor: Executor, folder: Path | None, keep_meshes: bool
) -> Generator[Record, None, None]:
    """Yield records as they come. In a folder, the first case of a subject prepares what the others share."""

    def group_of(case: Case) -> str:
        return case.key if folder is None else case.subject_key

    if folder is not None:
        keep_mended(cases, folder)
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


def _remarks(case: Case, subject: Subject, sides: Mapping[str, Outcome], rows: Mapping[str, SideRow]) -> list[str]:
    """Return what a reader of the numbers must know: which editor stopped short, what the editors say of their results,
    and a surface that fell to pieces."""
    what = f"{case.name}, {case.operation}"
    remarks = [f"{what}, {SIDES.get(name, name)}: {row.status}" for name, row in rows.items() if not row.complete]
    remarks += [f"{what}, {SIDES.get(name, name)}: {note}" for name, side in sides.items() for note in side.notes]
    if "implicit" in sides:
        # Of the field, which may have crumbs that the common mesh is without.
        before = meshref.component_count(*implicit.extract_mesh(subject.field, subject.cells(case.resolution)))
        after = rows["implicit"].bodies
        if before != after:
            remarks.append(
                f"{what}: the surface of the field is in {_pieces(after)} after the edit, and was in {_pieces(before)} "
                "before."
            )
    return remarks


def _pieces(count: int) -> str:
    return "one piece" if count == 1 else f"{count} pieces"


def _write(
    case: Case,
    subject: Subject,
    target: Target,
    sides: Mapping[str, Outcome],
    errors: Mapping[str, Float[ndarray, " n"] | None],
    result: Surface | None,
    folder: Path,
) -> dict[str, Artefact]:
    """Write the edited field, and meshes in the user's units: before, with the number of the handle as vertex quality,
    and the result of every method, with the error."""
    stem = f"{case.name}-{case.operation}-{case.key}"
    meshes = folder / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    paths = {"before": meshes / f"{stem}-before.ply"}
    length = subject.scale if operation_of(case.operation).error_is_length else 1.0

    meshref.write_mesh(paths["before"], subject.to_user(subject.V), subject.F, quality=target.handle.astype(float))
    if result is not None:
        edited, error = sides["implicit"].field, errors["implicit"]
        assert edited is not None
        paths = {"field": folder / "fields" / f"{stem}.safetensors", **paths}
        paths["field"].parent.mkdir(parents=True, exist_ok=True)
        implicit.save_field(edited, paths["field"], **saving_options(case))
        paths["implicit"] = meshes / f"{stem}-implicit.ply"
        V, F = result
        if error is not None:
            error = _carried_over(subject.V + sides["implicit"].displacement, error, V) * length
        meshref.write_mesh(paths["implicit"], subject.to_user(V), F, quality=error)
    for name in (side for side in sides if side != "implicit"):
        error = errors[name]
        paths[name] = meshes / f"{stem}-{name.lower().replace(', ', '-').replace(' ', '-')}.ply"
        moved = subject.to_user(subject.V + sides[name].displacement)
        meshref.write_mesh(paths[name], moved, subject.F, quality=None if error is None else error * length)
    return {name: Artefact.of(path, folder) for name, path in paths.items()}


def _carried_over(
    points: Float[ndarray, "n 3"], values: Float[ndarray, " n"], V: Float[ndarray, "k 3"]
) -> Float[ndarray, " k"]:
    """Return values known at points, at other points of the surface: the mean of the three nearest, by closeness."""
    distance, nearest = cKDTree(points).query(V, k=3)
    weight = 1 / np.maximum(distance, 1e-12)
    return (values[nearest] * weight).sum(axis=1) / weight.sum(axis=1)
