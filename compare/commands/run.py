"""implicit-vs-mesh run: edit shapes as fields and as meshes, compare, and write a run folder with a report."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from compare.case import OPERATIONS, QUICK_FIT, QUICK_SIZE, Case, default_cases
from compare.commands.checks import require_folder_for
from compare.commands.exits import FAILED
from compare.commands.shown import add_task, advance, finish, print_json, print_table, progress_bars, speaker, teller
from compare.records import FILE, Record, read
from compare.subject import BUNDLED, InputError, check_shape, prepare_subject


@dataclass
class Run:
    """Edit shapes as neural fields and as meshes, compare, and write a run folder with a report."""

    shapes: tyro.conf.Positional[tuple[str, ...]] = BUNDLED
    """Bundled shapes, meshes (.obj, .off, .ply, .stl) or fields (.safetensors)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Run folder; by default results/run- and the time."""
    operations: tuple[Literal["geometric", "smooth", "rigid"], ...] = OPERATIONS
    """What to do with each shape."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    seed: int = 0
    """Of every random choice."""
    resume: bool = False
    """Go on with a run folder: only what is missing is done."""
    json: bool = False
    """Print the records as JSON, a line each, in place of the table."""
    quiet: bool = False
    """Print nothing but errors, and the records with --json."""


def run(command: Run) -> int:
    """Check everything, then prepare each shape, run its cases, and write the report."""
    folder = command.output or Path("results") / f"run-{datetime.now():%Y%m%d-%H%M%S}"
    _require_run_folder(folder, command.resume)
    say = speaker(command.quiet, to_stderr=command.json)
    _require_distinct(command.shapes)
    mended = [sentence for name in command.shapes for sentence in check_shape(name)]
    for sentence in mended:
        say(sentence)

    from compare.report import report as write_report
    from compare.run import run_cases

    folder.mkdir(parents=True, exist_ok=True)
    records: list[Record] = []
    fit_options = QUICK_FIT if command.quick else {}
    settings: dict[str, Any] = {"seed": command.seed, **(QUICK_SIZE if command.quick else {})}
    with progress_bars(command.quiet) as bars:
        total = add_task(bars, "all", len(command.shapes) * len(command.operations))
        for name in command.shapes:
            current = add_task(bars, Path(name).stem, None)
            tell = teller(bars, current)
            try:
                # Any case of the shape: what decides the subject is the same for all, and this one needs no handles.
                any_case = Case(name, "smooth", parameters={"fit": fit_options} if fit_options else {}, **settings)
                subject = prepare_subject(any_case, folder=folder, progress=tell)
            except (ValueError, OSError) as error:
                raise InputError(f"{name}: {error}") from error
            cases = default_cases(
                name,
                subject.V,
                subject.N,
                operations=command.operations,
                quick=command.quick,
                fit=fit_options,
                **settings,
            )
            records += run_cases(cases, folder=folder, progress=tell, on_record=lambda _: advance(bars, total))
            finish(bars, current)
    page = write_report(records, folder / "report.html")
    if command.json:
        print_json(records)
    elif not command.quiet:
        print_table(records, said=mended)
        say(f"{folder}: {FILE}, edited fields, meshes, and {page.name} to open in a browser.")
    return FAILED if any(record.failed for record in records) else 0


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
