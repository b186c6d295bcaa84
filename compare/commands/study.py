"""implicit-vs-mesh study: a grid of edits over shapes, operations and settings, to be broken off at any moment."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

import tyro

from compare.cases.case import Case
from compare.cases.labels import labels
from compare.commands import exits
from compare.commands.checks import require_folder_for
from compare.commands.shown import add_task, advance, print_json, print_table, progress_bars, speaker, teller
from compare.errors import InputError
from compare.files import plain
from compare.runs.executors import executor_of
from compare.runs.records import Record
from compare.studies import study as studies
from compare.studies.diagram import DiagramRow
from compare.studies.diagram_run import DIAGRAM_FILE, read_head, run_diagram
from compare.studies.diagrams import DIAGRAMS
from compare.studies.study_folder import STUDY_FILE, Begun, finished, run_study


@dataclass
class Study:
    """Run a study, or what is missing of it: a grid over shapes, operations and settings, with a table and a chart."""

    name: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="NAME|FILE|FOLDER")]] = ""
    """A built-in study (see --list), a file of your own (docs/studies.md), or a study folder to go on with."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    """Study folder; by default results/ and the name. If it holds this study, only what is missing is done."""
    shapes: Annotated[tuple[str, ...], tyro.conf.arg(metavar="SHAPE ...")] = ()
    """In place of the study's own: bundled shapes, meshes or fields."""
    module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:FUNCTION")] = None
    """What builds the network of a field of your own, my_nets.py:make or package.module:function; its code is run. A
    study's file cannot name it: name it each time."""
    workers: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Processes to run in, one thread each; 0 runs in this one."""
    dask: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """A dask scheduler to run on, such as tcp://host:8786, whose workers see the same files."""
    no_meshes: bool = False
    """Do not keep the edited shapes, which report.html shows: for large grids."""
    quick: bool = False
    """A smaller grid, coarser: to see that it works, not for figures."""
    list: bool = False
    """Print the names of the built-in studies and what they show."""
    json: bool = False
    """Print the records as JSON, a line each, in place of the table."""
    quiet: bool = False
    """Print nothing but errors, and the records with --json."""


def study(command: Study) -> int:
    """Check everything, do what is missing, and say what came of it."""
    if command.list:
        return _list(command.json)
    if command.name in DIAGRAMS or (Path(command.name) / DIAGRAM_FILE).is_file():
        return _diagram(command)
    chosen, folder = _chosen(command)
    say = speaker(command.quiet, to_stderr=True)
    with progress_bars(command.quiet) as bars, executor_of(command.workers, command.dask) as executor:
        total: Any = None
        label: dict[str, str] = {}
        current = add_task(bars, "", None) if executor is None else None

        def on_plan(cases: list[Case], there: int) -> None:
            nonlocal total, label
            label = dict(zip((case.key for case in cases), labels(cases), strict=True))
            total = add_task(bars, chosen.name, len(cases), there)

        def on_record(record: Record) -> None:
            advance(bars, total)
            if bars is not None and not bars.console.is_terminal:  # a log, in which bars do not move
                task = bars.tasks[total]
                say(_line(record, label[record.key], task.completed, task.total, task.time_remaining))

        try:
            tell = teller(bars, current)
            told: dict[str, Any] = {"on_plan": on_plan, "on_record": on_record, "progress": tell}
            records = run_study(chosen, folder, executor, **told, module=command.module)
        except KeyboardInterrupt:
            kept = f"{finished(folder)} cases are kept; the same command goes on with the rest."
            raise KeyboardInterrupt(kept) from None
    if command.json:
        print_json(records)
    elif not command.quiet:
        print_table(records, settings=chosen.varied)
        print(f"{folder}: table.csv, the curves in chart.png and chart.pdf, and what they are from.")
    return exits.FAILED if any(record.failed for record in records) else exits.DONE


def _chosen(command: Study) -> tuple[studies.Study, Path]:
    """Return the study that is meant, and its folder."""
    if not command.name:
        raise InputError(f"Name a study: {', '.join([*studies.built_in(), *DIAGRAMS])}, or a file ending in .toml.")
    if command.name not in studies.built_in() and (Path(command.name) / STUDY_FILE).is_file():
        if command.shapes or command.quick or command.no_meshes or command.output:
            raise InputError(f"{command.name} holds a study with its own settings. Leave the options for it out.")
        return Begun.read(Path(command.name)).study, Path(command.name)
    chosen = studies.find_study(command.name, quick=command.quick, shapes=command.shapes)
    if command.no_meshes:
        chosen = replace(chosen, keep_meshes=False)
    folder = command.output or Path("results") / (chosen.name + ("-quick" if command.quick else ""))
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file, but a study is written to a folder. Name another.")
    require_folder_for(folder)
    return chosen, folder


def _diagram(command: Study) -> int:
    """Measure a diagram, or what is missing of it, and say who is cheaper where."""
    if command.workers or command.dask or command.module:
        raise InputError(
            "A diagram is of seconds: its points are measured one after another here. Leave the option out."
        )
    from compare.studies.diagram_page import sentences  # matplotlib, which other commands do without

    name, shapes, quick, folder = _chosen_diagram(command)
    diagram, say = DIAGRAMS[name], speaker(command.quiet, to_stderr=True)
    with progress_bars(command.quiet) as bars:
        total, current = add_task(bars, name, None), add_task(bars, "", None)

        def on_row(row: DiagramRow, number: int, count: int) -> None:
            if bars is not None:
                bars.update(total, total=count, completed=number)
                if not bars.console.is_terminal:  # a log, in which bars do not move
                    say(f"{number} of {count}: {row.key}{'. ' + row.status if row.failed else ''}")

        tell = teller(bars, current)
        rows = run_diagram(diagram, folder, shapes=shapes, quick=quick, progress=tell, on_row=on_row)
    if command.json:
        import json

        print("\n".join(json.dumps(plain(asdict(row))) for row in rows))
    elif not command.quiet:
        print("\n".join(sentences(diagram, rows)))
        print(f"{folder}: report.html, chart.svg, chart.png and chart.pdf, and table.csv.")
    return exits.FAILED if any(row.failed for row in rows) else exits.DONE


def _chosen_diagram(command: Study) -> tuple[str, tuple[str, ...], bool, Path]:
    """Return the name of the diagram that is meant, its shapes, whether it is the quick one, and its folder."""
    name, shapes, quick = command.name, command.shapes, command.quick
    folder = command.output or Path("results") / (name + ("-quick" if quick else ""))
    if name not in DIAGRAMS:
        if shapes or quick or command.output:
            raise InputError(f"{name} holds a diagram with its own settings. Leave the options for it out.")
        folder = Path(name)
        head = read_head(folder)
        name, shapes, quick = str(head["diagram"]), tuple(head["shapes"]), bool(head["quick"])
        if name not in DIAGRAMS:
            raise InputError(f"{folder} holds a diagram {name}, but there are {', '.join(DIAGRAMS)}.")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"The output {folder} is a file, but a diagram is written to a folder. Name another.")
    require_folder_for(folder)
    return name, shapes, quick, folder


def _list(as_json: bool) -> int:
    rows = {name: study.title for name, study in studies.built_in().items()}
    rows |= {name: diagram.title for name, diagram in DIAGRAMS.items()}
    if as_json:
        import json

        print(json.dumps(rows))
    else:
        width = max(map(len, rows))
        for name, title in rows.items():
            print(f"{name:{width}}  {title}")
    return exits.DONE


def _line(record: Record, label: str, done: float, total: float | None, seconds_left: float | None) -> str:
    """Return the line of a log for a case that has ended."""
    words = ", ".join(filter(None, (record.case.name, record.case.operation, label)))
    what = f"{done:.0f} of {total:.0f}: {words}"
    left = "" if seconds_left is None else f"; about {timedelta(seconds=round(seconds_left))} left"
    return f"{what}{'. ' + record.status if record.failed else left}"
