"""What the corpus of bad inputs is made of: a case, and lists of bad values for each kind of argument.

A case calls one public function with all arguments good but one. It is passed if the call raises an error that this
project wrote: one that names the argument and says what is wanted. A crash, a hang, an answer or an error out of the
depths of another library fails it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

# A few words of every error that this project writes: what is wanted, or what to do.
REMEDIES = (
    "must", "need", "add", "check", "choose", "close", "convert", "copy", "cut", "drop", "fetch", "give", "hold",
    "load", "lower", "make", "mend", "move", "name", "raise", "refit", "remove", "sample", "save", "take", "train",
    "turn", "use", "widen", "wrap", "write",
    "is one of", "ending in", "there are", "run the case",
)  # fmt: skip


@dataclass(frozen=True)
class BadCase:
    """A call that must be refused.

    Attributes:
        name: Function, argument and what is wrong with it.
        call: The call.
        says: Words that the message must hold, in any capitals; the name of the argument is among them.
    """

    name: str
    call: Callable[[], object]
    says: tuple[str, ...]

    def misses(self, message: str) -> str | None:
        """What a message lacks, or None."""
        missing = [word for word in self.says if word.lower() not in message.lower()]
        if missing:
            return f"the message does not say {missing[0]!r}"
        if not message.rstrip().endswith((".", "?")):
            return "the message is no sentence"
        if not any(word in message.lower() for word in REMEDIES):
            return "the message says neither what is wanted nor what to do"
        return None


Bad = tuple[str, Any]  # what is wrong, the value


def refusals(
    function: str, argument: str, values: Iterable[Bad], call: Callable[[Any], object], *says: str
) -> Iterator[BadCase]:
    """One case for each bad value of an argument; without words to say, the message must name the argument."""
    for what, value in values:
        yield BadCase(f"{function}: {argument} {what}", lambda value=value: call(value), says or (argument,))


def counts(least: int = 1) -> list[Bad]:
    """For a whole number of at least so much."""
    small: list[Bad] = [("too small", least - 1)]
    return [
        *small,
        ("negative", -3),
        ("a fraction", least + 1.5),
        ("NaN", float("nan")),
        ("a word", "ten"),
        ("a list", [8]),
    ]


def positives() -> list[Bad]:
    """For a positive number."""
    return [("zero", 0.0), *not_negatives()]


def not_negatives() -> list[Bad]:
    """For a number of at least zero."""
    return [("negative", -1.0), ("NaN", float("nan")), ("infinite", float("inf")), ("a word", "wide")]


def choices() -> list[Bad]:
    """For one of a few words."""
    return [("unknown", "no such word"), ("a number", 3)]


def numpy_points(k: int = 5) -> list[Bad]:
    """For an array (k, 3) of real numbers."""
    good = np.arange(3.0 * k).reshape(k, 3)
    with_nan, with_infinity = good.copy(), good.copy()
    with_nan[1, 2], with_infinity[k - 1, 0] = np.nan, np.inf
    return [
        ("NaN", with_nan),
        ("infinite", with_infinity),
        ("of two columns", good[:, :2]),
        ("of one axis", good.ravel()),
        ("of three axes", good[None]),
        ("complex", good.astype(complex)),
        ("words", good.astype(str)),
        ("ragged", [[0.0, 1.0, 2.0], [3.0]]),
        ("None", None),
        ("objects", np.array([[object()] * 3])),
        ("a dictionary", {"x": 1}),
        ("true and false", good > 3),
    ]
