"""One point of a diagram of work and precision, and one kind of diagram.

A point is one side of one operation on one shape at one resolution, with its error against a reference that has an
error estimate of its own, and the seconds of several runs.
"""

from __future__ import annotations

import statistics
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field as default
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

from compare.errors import Progress

T = TypeVar("T")

# Times a run is repeated, and how often one that takes longer than LONG seconds.
REPEATS = 5
REPEATS_OF_LONG = 2
LONG = 5.0

FIELD, MESH = "field", "mesh"  # the two sides; a curve of a mesh may have a second method


@dataclass(frozen=True)
class DiagramRow:
    """One point of a diagram.

    Attributes:
        key: Its name among all points of the diagram.
        panel: The operation, or the kind of error.
        shape: The shape.
        side: "field" or "mesh".
        method: How, for a reader; a curve is a shape, a side and a method.
        costs: Which costs it may be drawn against: "seconds", "numbers", or both.
        at: Its resolution, by the names of the settings.
        numbers: Numbers stored: parameters of the network, or coordinates of the vertices.
        error: Its error, a pure number; None where it failed.
        floor: Estimated error of the reference; an error below it says no more than that.
        seconds: Of each of the repeated runs; empty where time is not the question.
        status: How it ended, a sentence.
        provenance: Versions, threads and machine that the seconds are of.
    """

    key: str
    panel: str
    shape: str
    side: str
    method: str
    costs: tuple[str, ...]
    at: Mapping[str, Any]
    numbers: int | None = None
    error: float | None = None
    floor: float = 0.0
    seconds: tuple[float, ...] = ()
    status: str = "Done."
    provenance: Mapping[str, Any] = default(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Return whether there is no error to draw."""
        return self.error is None

    def cost(self, name: str) -> float | None:
        """Return the median of the seconds, or the numbers stored; None where it is not to be drawn against them."""
        if name not in self.costs or self.failed:
            return None
        if name == "seconds":
            return statistics.median(self.seconds) if self.seconds else None
        return None if self.numbers is None else float(self.numbers)

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> DiagramRow:
        """Return the row that was kept as plain data."""
        return cls(**{**row, "costs": tuple(row["costs"]), "seconds": tuple(row["seconds"])})


@dataclass(frozen=True, eq=False)
class Point:
    """A row to come: all of it but what is measured, and how that is."""

    row: DiagramRow
    measure: Callable[[], Mapping[str, Any]]  # gives numbers, error, floor, seconds and status, or some of them


class Diagram(ABC):
    """One kind of diagram.

    Attributes:
        name: For the command line and the folder.
        title: A sentence, over the chart.
        shapes, quick_shapes: Those that it has unless others are named.
        known_shapes: Those that can be named beside files of meshes and fields.
        panels: Each with what its error is.
        costs: What errors are drawn against.
    """

    name: str
    title: str
    shapes: tuple[str, ...]
    quick_shapes: tuple[str, ...]
    known_shapes: tuple[str, ...]
    panels: Mapping[str, str]
    costs: tuple[str, ...]

    @abstractmethod
    def points(self, shapes: Sequence[str], quick: bool, folder: Path, progress: Progress | None) -> list[Point]:
        """Return all points, cheap ones first; nothing is computed before they are measured."""


def timed(work: Callable[[], T], repeats: int = REPEATS) -> tuple[T, tuple[float, ...]]:
    """Return what some work gives, and the seconds of each of several runs of it: never of one alone."""
    seconds: list[float] = []
    while True:
        start = perf_counter()
        result = work()
        seconds.append(perf_counter() - start)
        if len(seconds) >= (min(repeats, REPEATS_OF_LONG) if seconds[0] > LONG else repeats):
            return result, tuple(seconds)


def words_of(at: Mapping[str, Any]) -> str:
    """Return a resolution in words."""
    return ", ".join(f"{value} {name}" for name, value in at.items())
