"""A study in a folder: begun once, gone on with as often as needed, and summed up when it ends.

study.json     the study's own copy of its settings, the hashes of its shapes, and its cases
results.jsonl  a row for each case that has been run
table.csv      the numbers, a line for each case and method
chart.png/pdf  its curves
report.html    every case with its curves, and in 3D, with fields/ and meshes/, where they are kept
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from compare.cases.case import Case, content_of
from compare.cases.labels import flat
from compare.errors import InputError, Progress
from compare.files import replace_file
from compare.runs.lock import FILE as LOCK_FILE, lock
from compare.runs.records import FILE, Record, read
from compare.runs.subject import check_shape, mending_of_settings, modules_of
from compare.studies.study import Study, find_study

SCHEMA = 1
STUDY_FILE = "study.json"
INPUTS = "inputs"  # a folder for shapes that the study itself writes


@dataclass(frozen=True)
class Begun:
    """A study that a folder holds."""

    study: Study
    cases: list[Case]
    inputs: dict[str, str]  # of each shape that is a file, the hash of its content when the study was begun

    def write(self, folder: Path) -> None:
        """Keep it, in one move."""
        row = {
            "schema": SCHEMA,
            "study": self.study.to_dict(),
            "inputs": self.inputs,
            "cases": [case.to_dict() for case in self.cases],
        }
        replace_file(folder / STUDY_FILE, (json.dumps(row, indent=1, allow_nan=False) + "\n").encode())

    @classmethod
    def read(cls, folder: Path) -> Begun:
        """Return what `write` kept.

        Raises:
            InputError: The file is not what a study writes.
        """
        path = folder / STUDY_FILE
        try:
            row = json.loads(path.read_text(encoding="utf-8"))
            if row["schema"] != SCHEMA:
                raise ValueError(f"it is of schema {row['schema']}, but this version reads {SCHEMA}")
            return cls(Study.from_dict(row["study"]), [Case.from_dict(case) for case in row["cases"]], row["inputs"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path} cannot be read: {error!r}. Begin the study in another folder.") from error


def run_study(
    study: Study | str,
    folder: str | PathLike[str],
    executor: Executor | None = None,
    *,
    on_plan: Callable[[list[Case], int], None] | None = None,
    on_record: Callable[[Record], None] | None = None,
    progress: Progress | None = None,
    module: str | None = None,
) -> list[Record]:
    """Do what is missing of a study in a folder, and sum it up.

    Args:
        study: A study, or what find_study takes: the name of a built-in one, or of a TOML file.
        folder: Of the study; made, or gone on with if it holds this very study.
        executor: As for run_cases.
        on_plan: Told of the cases, and of how many are done already, before the first is run.
        on_record: Called with each record as it comes.
        progress: As for run_case; told only of what runs here.
        module: As for Case, for those of the shapes that need one. Its code is run; what a study's files name is not.

    Returns:
        The records of all cases, in the order of the study.

    Raises:
        InputError: The study makes no sense, a shape cannot be used or has changed, or the folder holds something
            else or is in use.
    """
    study = find_study(study) if isinstance(study, str) else study
    folder = Path(folder)
    require_folder_of(study, folder)
    modules = modules_of(study.shapes, module)
    kept = folder if (folder / STUDY_FILE).is_file() else None
    for shape in study.shapes:
        mending = mending_of_settings(study.settings)
        check_shape(shape, modules[shape], mending, folder=kept, progress=progress)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with lock(folder):
            begun = _begin(study, folder, modules)
            if on_plan is not None:
                on_plan(begun.cases, finished(folder))

            from compare.runs.run import run_cases

            records = run_cases(
                [_named(case, modules.get(case.shape)) for case in begun.cases],
                executor,
                folder=folder,
                keep_meshes=study.keep_meshes,
                progress=progress,
                on_record=on_record,
                on_failure="record",  # which the table shows
            )
            sum_up(study, records, folder)
    except InputError:
        if not any(folder.iterdir()):  # refused after all; nothing is left of it
            folder.rmdir()
        raise
    return records


def require_folder_of(study: Study, folder: Path) -> None:
    """Refuse a folder that holds something else than this study.

    Raises:
        InputError: It does; the message says what differs.
    """
    if (folder / STUDY_FILE).is_file():
        before, now = (flat(one.to_dict()) for one in (Begun.read(folder).study, study))
        if before != now:
            name = next(key for key in {**before, **now} if before.get(key) != now.get(key))
            raise InputError(
                f"The folder {folder} holds another study: {name} was {before.get(name)!r}, and is {now.get(name)!r} "
                "now. Name another folder."
            )
    elif folder.is_dir() and any(not _is_of_a_beginning(path) for path in folder.iterdir()):
        raise InputError(f"The folder {folder} is not empty and holds no study. Name another or an empty one.")


def finished(folder: Path) -> int:
    """Return how many cases of the study in a folder are done, without failure."""
    if not (folder / FILE).is_file():
        return 0
    planned = {case.key for case in Begun.read(folder).cases}
    return len(planned & {record.key for record in read(folder) if not record.failed})


def sum_up(study: Study, records: list[Record], folder: Path) -> None:
    """Write the table, the chart and the report."""
    from compare.reports.report import report
    from compare.reports.table import write_table
    from compare.studies.curves import draw_charts

    write_table(records, folder / "table.csv", study.varied)
    if study.charts:
        draw_charts(study, records, folder / "chart")
    report(records, folder / "report.html")


def _named(case: Case, module: str | None) -> Case:
    """Return a case of the study's files with its module as the user names it, who alone can have it run."""
    if case.module is None:
        return case
    if module != case.module:
        raise InputError(
            f"The study was begun with the network of {case.shape} built by {case.module}, but {module} is named now. "
            "Name the same, or another folder."
        )
    return replace(case, module=module)


def _begin(study: Study, folder: Path, modules: Mapping[str, str | None]) -> Begun:
    if (folder / STUDY_FILE).is_file():
        begun = Begun.read(folder)
        for shape, content in begun.inputs.items():
            if _content(shape) != content:
                raise InputError(
                    f"{shape} has changed since the study in {folder} was begun. Put it back, or name another folder."
                )
        return begun

    from compare.studies.plan import plan

    cases = plan(study, folder / INPUTS, modules)
    shapes = dict.fromkeys(case.shape for case in cases)
    begun = Begun(study, cases, {shape: _content(shape) for shape in shapes if Path(shape).suffix})
    begun.write(folder)
    return begun


def _content(shape: str) -> str:
    try:
        return content_of(shape)
    except OSError:
        return "nothing"


def _is_of_a_beginning(path: Path) -> bool:
    """Return whether it is what a study leaves that was killed before its study.json was there."""
    return path.name in (LOCK_FILE, INPUTS) or path.suffix == ".part"
