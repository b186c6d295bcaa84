"""The error for input that cannot be used, and how progress is told."""

from __future__ import annotations

from collections.abc import Callable

# step, steps, what is being done
Progress = Callable[[int, int, str], None]


class InputError(ValueError):
    """Input that cannot be used; the message says why and what to do."""
