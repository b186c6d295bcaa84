"""Sentences and bars that commands show while they work, on stderr, so that stdout is left to results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compare.errors import Progress as ShapeProgress
from compare.runs.records import Record

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars


LARGE_FILE = 5_000_000  # bytes of a mesh that takes seconds to be read and mended
SPEED_PERIOD = 24 * 3600.0  # seconds over which the time left is estimated; rich's 30 may not hold one case


def speaker(quiet: bool, *, to_stderr: bool = False) -> Callable[[str], None]:
    """Return what says a sentence to the user, or keeps quiet."""

    def say(sentence: str) -> None:
        if not quiet:
            print(sentence, file=sys.stderr if to_stderr else sys.stdout, flush=True)

    return say


def say_mending(
    say: Callable[[str], None],
    shapes: Sequence[str],
    check: Callable[[str, ShapeProgress | None], list[str]],
    quiet: bool,
) -> list[str]:
    """Check shapes, say what is mended of each, and return what was said; large meshes are named before, with a bar.

    Args:
        say: What says a sentence.
        shapes: Their names.
        check: Called as check(name, progress) for each.
        quiet: Whether no bars are to be shown.
    """
    said = []
    for name in shapes:
        path = Path(name)
        if path.is_file() and path.stat().st_size > LARGE_FILE:
            say(f"{name}: reading and mending {path.stat().st_size / 1e6:.0f} MB.")
            with progress_bars(quiet) as bars:
                sentences = check(name, teller(bars, add_task(bars, path.name, None)))
        else:
            sentences = check(name, None)
        for sentence in sentences:
            say(sentence)
            said.append(sentence)
    return said


def progress_bars(quiet: bool) -> AbstractContextManager[Bars | None]:
    """Return bars for what takes long; None in their place where nothing is to be shown."""
    if quiet:
        return nullcontext()
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column

    console = Console(stderr=True)  # so that --json leaves stdout to the records
    # Words give way where there is little room, the numbers and clocks do not.
    words = TextColumn("{task.description}", markup=False, table_column=Column(ratio=1, no_wrap=True))
    return Progress(
        words,
        BarColumn(bar_width=max(8, min(40, console.width - 64))),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        expand=True,
        speed_estimate_period=SPEED_PERIOD,
    )


def add_task(bars: Bars | None, name: str, total: int | None, done: int = 0) -> Any:
    """Add a bar; it is not full until its total is known."""
    return None if bars is None else bars.add_task(name, total=total, completed=done)


def teller(bars: Bars | None, task: Any) -> Callable[[int, int, str], None]:
    """Return the progress callback of the library, for a bar whose clock begins anew with each thing that is done."""
    doing: str | None = None

    def tell(step: int, steps: int, what: str) -> None:
        nonlocal doing
        if bars is None or task is None:
            return
        bar = bars.tasks[task]
        if step < bar.completed or (step == 0 and what != doing):
            bars.reset(task, completed=0)
        begun, doing = what != doing, what
        # Until a step is done, how many there are is no measure of anything: the bar only shows that it is at work.
        bar.total = steps if step else None  # an update cannot take a total away
        bars.update(task, completed=step, description=what)
        if begun:  # what begins may let no other thread draw until it ends
            bars.refresh()

    return tell


def advance(bars: Bars | None, task: Any, by: int = 1) -> None:
    """Count one more as done, or several."""
    if bars is not None:
        bars.advance(task, by)


def print_markdown(text: str) -> None:
    """Print a page of markdown as one reads it on a terminal; to a file or a pipe as it is."""
    if not sys.stdout.isatty():
        print(text)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(text))


def print_json(records: Sequence[Record]) -> None:
    """Print the records, a line each."""
    for record in records:
        print(dumps(record.to_dict(), allow_nan=False))


def print_table(records: Sequence[Record], *, settings: Sequence[str] = (), said: Sequence[str] = ()) -> None:
    """Print the main numbers of the records, their notes, and why any of them failed.

    A narrow terminal gets fewer columns, without the last ones, and no shorter words.

    Args:
        records: A line for each side of each.
        settings: Names of settings, for a column each.
        said: Notes that were printed before.
    """
    from rich.console import Console

    from compare.runs.columns import columns, lines, text

    shown = [(k, column) for k, column in enumerate(columns()) if column.brief]
    names = ["shape", "edit", "by", *settings, *(column.title for _, column in shown)]
    groups = []
    for record in records:
        chosen = [_setting(record, name) for name in settings]
        groups.append(
            [
                [shape, operation, side, *chosen, *(text(values[k], column) for k, column in shown)]
                for shape, operation, side, _, values in lines(record)
            ]
        )
    console = Console()
    _print_fitting(console, names, groups, least=4 + len(settings))  # fewer do not say what a row is
    for sentence in dict.fromkeys(note for record in records for note in record.notes if note not in said):
        console.print(sentence, markup=False)
    for record in records:
        if record.failed:
            console.print(f"{record.case.name}, {record.case.operation}: {record.status}", markup=False)


def _print_fitting(console: Console, names: Sequence[str], groups: Sequence[list[list[str]]], least: int) -> None:
    """Print groups of rows with as many columns as the console has room for, at least the least, and name the rest."""
    from rich import box
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table

    def table_of(count: int) -> Table:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        for k, name in enumerate(names[:count]):
            table.add_column(name, justify="left" if k < 3 else "right", no_wrap=True)
        for rows in groups:
            for row in rows:
                table.add_row(*row[:count])
            table.add_section()
        return table

    def width_of(table: Table) -> int:
        return Measurement.get(console, console.options.update(width=1000), table).maximum

    counts = range(len(names), least, -1)
    count = next((n for n in counts if width_of(table_of(n)) <= console.width), min(least, len(names)))
    table = table_of(count)
    Console(width=max(console.width, width_of(table))).print(table)
    if count < len(names):
        console.print(f"Left out for want of room: {', '.join(names[count:])}; they are in the report.", markup=False)


def _setting(record: Record, name: str) -> str:
    from compare.cases.settings import setting_of

    value = setting_of(record.case, name)
    return "" if value is None else str(value)
