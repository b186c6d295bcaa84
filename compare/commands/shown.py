"""What several commands show while they work: sentences, and bars on stderr, so that stdout is left to results."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.progress import Progress as Bars


def speaker(quiet: bool, *, to_stderr: bool = False) -> Callable[[str], None]:
    """What says a sentence to the user, or keeps quiet."""

    def say(sentence: str) -> None:
        if not quiet:
            print(sentence, file=sys.stderr if to_stderr else sys.stdout, flush=True)

    return say


def progress_bars(quiet: bool) -> AbstractContextManager[Bars | None]:
    """Bars for what takes long; None in their place where nothing is to be shown."""
    if quiet:
        return nullcontext()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    # On stderr, so that --json leaves stdout to the records.
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[what]}", markup=False),
        console=Console(stderr=True),
    )


def add_task(bars: Bars | None, name: str, total: int | None) -> Any:
    """A bar more; it is not full until its total is known."""
    return None if bars is None else bars.add_task(name, total=total, what="")


def teller(bars: Bars | None, task: Any) -> Callable[[int, int, str], None]:
    """The progress callback of the library, for a bar."""

    def tell(step: int, steps: int, what: str) -> None:
        if bars is not None:
            bars.update(task, completed=step, total=steps, what=what)

    return tell


def advance(bars: Bars | None, task: Any) -> None:
    """One more is done."""
    if bars is not None:
        bars.advance(task)


def finish(bars: Bars | None, task: Any) -> None:
    """All is done."""
    if bars is not None:
        bars.update(task, completed=1, total=1, what="done")
