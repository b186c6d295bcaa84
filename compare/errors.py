"""The error for input that cannot be used, and how progress is told."""

from __future__ import annotations

from collections.abc import Callable

# Called as progress(step, steps, what): how many steps are done, of how many, and what is being done. A step of 0 says
# that something begins.
Progress = Callable[[int, int, str], None]


def naming(progress: Progress | None, name: str) -> Progress | None:
    """Return a progress that says the name of a shape before what is being done."""
    if progress is None:
        return None
    return lambda step, steps, what: progress(step, steps, f"{name}, {what}")


def begin(progress: Progress | None, what: str) -> None:
    """Say that something begins whose steps are not known yet."""
    if progress is not None:
        progress(0, 1, what)


class InputError(ValueError):
    """Input that cannot be used; the message says why and what to do."""
