"""implicit-vs-mesh run: edit shapes as fields and as meshes, compare, and write a run folder with a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from numpy import ndarray

from compare.cases.case import BUNDLED, Case
from compare.cases.default_cases import QUICK_FIT, QUICK_SIZE, case_of_subject, default_cases
from compare.cases.handles_file import HandlesFile, read_handles
from compare.cases.registry import OPERATIONS
from compare.commands.checks import absolute_name, require_budget, require_folder_for, require_hole_limit, require_seed
from compare.commands.exits import FAILED
from compare.commands.run_settings import PAGE, finished_records, keep_settings
from compare.commands.shown import (
    add_task,
    advance,
    print_json,
    print_table,
    progress_bars,
    say_mending,
    speaker,
    teller,
)
from compare.errors import InputError, Progress
from compare.fitting.mending import Mending
from compare.reports.table import FILE as TABLE, write_table
from compare.runs.executors import WorkerDiedError, executor_of
from compare.runs.lock import lock
from compare.runs.records import FILE, Record, read
from compare.runs.subject import check_shape, keep_mended, modules_of, prepare_subject, require_file

if TYPE_CHECKING:
    OperationName = str
else:  # a word of those that are registered, for tyro to refuse others and to complete
    OperationName = tyro.extras.literal_type_from_choices(tuple(OPERATIONS))


@dataclass
class Run:
    """Edit shapes as neural fields and as meshes, compare, and write a run folder with a report."""

    shapes: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="SHAPE ...")]] = BUNDLED
    """Bundled shapes, meshes (.obj, .off, .ply, .stl, .glb, .gltf, .3mf, .dae) or fields (.safetensors)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    """Run folder; by default results/run- and the time."""
    operations: tuple[OperationName, ...] = tuple(OPERATIONS)
    """What to do with each shape."""
    handles: Annotated[Path | None, tyro.conf.arg(metavar="FILE.toml")] = None
    """Handles of your own for the edits that take some (docs/handles.md), in the coordinates of the shape's file; by
    default some are found on each shape."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    bodies: Literal["refuse", "largest"] = "refuse"
    """What is done with meshes of several bodies that are not connected: refused, or only the largest compared."""
    hole_limit: Annotated[float, tyro.conf.arg(metavar="DIAGONALS")] = 1.0
    """Longest way round a hole of a mesh that is closed, in diagonals of its box."""
    budget: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Seconds in which the fit of a mesh that is below the stated quality begins anew, twice as wide each time."""
    up: Literal["auto", "x", "y", "z"] = "auto"
    """Axis that points up in the report; auto is z for .stl and .3mf and y for all else."""
    seed: int = 0
    """Of every random choice."""
    module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:FUNCTION")] = None
    """What builds the network of a field of your own, my_nets.py:make or package.module:function; its code is run."""
    workers: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Processes to run in, one thread each; 0 runs in this one."""
    dask: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """A dask scheduler to run on, such as tcp://host:8786, whose workers see the same files."""
    resume: bool = False
    """Go on with a run folder: only what is missing is done."""
    json: bool = False
    """Print the records as JSON, a line each, in place of the table."""
    quiet: bool = False
    """Print nothing but errors, and the records with --json."""


def run(command: Run) -> int:
    """Check everything, then prepare each shape, run its cases, and write the report."""
    require_seed(command.seed)
    folder = command.output or Path("results") / f"run-{datetime.now():%Y%m%d-%H%M%S}"
    _require_run_folder(folder, command.resume)
    if command.dask is not None:  # its workers have folders of their own to start from
        command.shapes = tuple(name if name in BUNDLED else str(Path(name).absolute()) for name in command.shapes)
        command.module = absolute_name(command.module)
    say = speaker(command.quiet, to_stderr=command.json)
    _require_distinct(command.shapes)
    if command.resume and (ready := _finished(command, folder)) is not None:
        return _show(command, ready, folder, say, [])
    modules = modules_of(command.shapes, command.module)
    require_hole_limit(command.hole_limit)
    require_budget(command.budget)
    own = None if command.handles is None else _own_handles(command)
    mending = Mending(command.bodies, command.hole_limit)

    kept = folder if command.resume else None

    def check(name: str, tell: Progress | None) -> list[str]:
        return check_shape(name, modules[name], mending, folder=kept, progress=tell)

    mended = say_mending(say, command.shapes, check, command.quiet)

    folder.mkdir(parents=True, exist_ok=True)
    with (
        lock(folder),
        progress_bars(command.quiet) as bars,
        executor_of(command.workers, command.dask) as executor,
    ):
        total = add_task(bars, "all", len(command.shapes) * len(command.operations))
        tell = teller(bars, add_task(bars, "", None) if executor is None else None)
        tell(0, 1, "loading the libraries")
        from compare.reports.report import report as write_report
        from compare.runs.run import run_cases

        try:
            cases = _cases(command, modules, folder, executor, tell, own)
            keep_settings(command, cases, folder)
            advance(bars, total, _done(cases, folder))
            records = run_cases(
                cases,
                executor,
                folder=folder,
                progress=tell,
                on_record=lambda _: advance(bars, total),
                on_failure="record",  # which the table shows
            )
        except KeyboardInterrupt:
            on = f"What is done is kept; the same command with --resume -o {folder} goes on with the rest."
            raise KeyboardInterrupt(on) from None
    write_table(records, folder / TABLE)
    write_report(records, folder / PAGE, up=command.up)
    return _show(command, records, folder, say, mended)


def _finished(command: Run, folder: Path) -> list[Record] | None:
    """Return the records of a folder that has nothing left to be done, or None."""
    for name in command.shapes:
        require_file(name)
    return finished_records(command, folder)


def _done(cases: Sequence[Case], folder: Path) -> int:
    """Return how many of the cases a folder holds already, without failure."""
    there = {record.key for record in read(folder) if not record.failed} if (folder / FILE).is_file() else set()
    return len({case.key for case in cases} & there)


def _show(
    command: Run, records: Sequence[Record], folder: Path, say: Callable[[str], None], said: Sequence[str]
) -> int:
    """Print what came of a run; return the exit code."""
    if command.json:
        print_json(records)
    elif not command.quiet:
        print_table(records, said=said)
        say(f"{folder}: {FILE}, {TABLE}, edited fields, meshes, and {PAGE} to open in a browser.")
    return FAILED if any(record.failed for record in records) else 0


def _cases(
    command: Run,
    modules: Mapping[str, str | None],
    folder: Path,
    executor: Executor | None,
    tell: Progress,
    own_handles: HandlesFile | None,
) -> list[Case]:
    """Prepare the shapes, which may fit a network to each, and find the handles on them or place the user's own."""
    fit = {**(QUICK_FIT if command.quick else {}), **_fit_options(command)}
    settings: dict[str, Any] = {"seed": command.seed, **(QUICK_SIZE if command.quick else {})}
    # What decides the subject is the same for all cases of a shape.
    any_case = {name: case_of_subject(name, fit, **settings, module=modules[name]) for name in command.shapes}
    if executor is not None:
        keep_mended(any_case.values(), folder)
    waiting = {
        name: executor.submit(_surface, case, folder.absolute())
        for name, case in any_case.items()
        if executor is not None
    }
    cases: list[Case] = []
    for name, case in any_case.items():
        try:
            V, N, bounds = waiting[name].result() if waiting else _surface(case, folder, tell)
        except (ValueError, OSError, WorkerDiedError) as error:
            raise InputError(f"{name}: {error}") from error
        own = {**settings, "module": modules[name], "bounds": bounds}
        found = default_cases(name, V, N, operations=command.operations, quick=command.quick, fit=fit, **own)
        if own_handles is not None:
            given: dict[str, Any] = {"handles": own_handles.handles, "coordinates": own_handles.coordinates}
            found = [replace(case, **given) if case.handles else case for case in found]
        cases += found
    return cases


def _fit_options(command: Run) -> dict[str, Any]:
    """Return the options of a fit that the command sets; none by default, so that keys of cases stay what they were."""
    options = {"bodies": command.bodies, "hole_limit": command.hole_limit}
    changed = {name: value for name, value in options.items() if value != getattr(Mending(), name)}
    return changed if command.budget is None else {**changed, "budget": command.budget}


def _own_handles(command: Run) -> HandlesFile:
    """Return the handles of the user's file, refused where no edit takes any."""
    assert command.handles is not None
    if not any(OPERATIONS[name].takes_handles for name in command.operations):
        raise InputError(f"--handles gives handles, but {' and '.join(command.operations)} takes none. Leave it out.")
    return read_handles(command.handles)


def _surface(case: Case, folder: Path, progress: Progress | None = None) -> tuple[ndarray, ndarray, ndarray]:
    """Return the vertices and normals of the common mesh of a case, whose subject is kept in the folder, and the bounds
    of its field."""
    subject = prepare_subject(case, folder=folder, progress=progress)
    return subject.V, subject.N, subject.field.bounds.cpu().numpy()


def _require_run_folder(folder: Path, resume: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file, but a run is written to a folder. Name another.")
    if (folder / FILE).exists():
        if not resume:
            raise InputError(
                f"The folder {folder} already holds a run. Name another, or add --resume to go on with it."
            )
        try:
            read(folder)
        except ValueError as error:
            raise InputError(str(error)) from error
    elif folder.is_dir() and any(folder.iterdir()) and not resume:
        raise InputError(f"The folder {folder} is not empty and holds no run. Name another or an empty one.")
    elif not folder.is_dir():
        require_folder_for(folder)


def _require_distinct(names: tuple[str, ...]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"{twice[0]} is named twice. Name each shape once.")
