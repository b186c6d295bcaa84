"""An operation as one object that knows its handles, settings, editors, error and headline.

    cases      name, takes_handles, settings, full, quick, default_handles     (CaseRules, in compare.cases.registry)
    studies    option_sources: the functions whose keyword options a study may set
    runs       edit_field, mesh_editors, error_field, error_name, error_is_length, error_over_target
    reports    error_means, headline, columns

A new operation is a file with a subclass of `Operation`, and its name in the tuple of `compare/operations/__init__.py`;
one from outside is given to `register`. The objects are imported with the package, so their methods import torch and
the mesh libraries where they use them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field as default
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, cast

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.handles import HandleSpec
from compare.cases.registry import OPERATIONS, CaseRules, add_rules
from compare.cases.settings import OF_A_CASE, OF_A_PART
from compare.cases.subject import Subject
from compare.errors import Progress

if TYPE_CHECKING:
    from implicit import Field


@dataclass(frozen=True, eq=False)
class Target:
    """Places to which the handles of a case send the vertices of the common mesh."""

    handle: Int[ndarray, " n"]  # the handle that holds each vertex, counted from 1; 0 for none
    at: Bool[ndarray, " n"]  # which vertices have a target
    displacement: Float[ndarray, "n 3"]  # from each of these to its target; zero elsewhere

    @property
    def largest(self) -> float:
        """Length of the largest target displacement, the scale of relative errors; 0 if there is none."""
        return float(np.linalg.norm(self.displacement, axis=1).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Halfway:
    """An editor's result after one of its steps."""

    displacement: Float[ndarray, "n 3"]  # of the vertices of the common mesh since the start
    seconds: float  # since the start
    volume: float | None = None  # of the field itself, where the editor measures it in every step
    area: float | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """One editor's result of a case."""

    displacement: Float[ndarray, "n 3"]  # of the vertices of the common mesh, in the field's units
    method: str  # which it was, and its settings, for a reader
    status: str  # how it ended, a sentence
    complete: bool  # whether it did all of its task
    seconds: float
    field: Field | None = None  # the edited field, of the neural editor
    seconds_by_phase: Mapping[str, float] = default(default_factory=dict)  # as docs/metrics.md has them
    path: Sequence[Halfway] = ()  # after each step, of an editor that takes steps
    peak_memory: float | None = None  # megabytes, see compare.runs.memory
    details: Mapping[str, Any] = default(default_factory=dict)
    notes: Sequence[str] = ()  # what the editor says of the result, a sentence each
    estimates: Mapping[str, float] = default(default_factory=dict)  # of errors, by their names in a row


# Gives what a method makes of a case; None where it has no answer for it.
Editor: TypeAlias = Callable[[Case, Subject, Target, Progress | None], Outcome | None]


@dataclass(frozen=True)
class Column:
    """A number of one side of a record and how it is written."""

    name: str
    title: str
    explains: str
    percent: bool = False
    brief: bool = True  # whether the table of a terminal, 80 characters wide, has it
    label: str = ""  # what a chart calls it, where there is more room; empty is the title
    unit: str = ""  # of the number; "%" where it is a share

    def __post_init__(self) -> None:
        if self.percent and not self.unit:
            object.__setattr__(self, "unit", "%")


@dataclass(frozen=True)
class Headline:
    """The one number of an operation that stands over a picture."""

    column: str  # the name of a column
    words: str  # with {} for the number


class Operation(CaseRules, Protocol):
    """Something to do to a shape, as a neural field and as a mesh, and how both are judged."""

    settings: tuple[str, ...] = ()
    sums_handles: bool = False  # whether handles' weighted displacements add up; else vertices in them are prescribed
    error_means: str  # the error of a vertex in words
    error_name: str = "error"  # of its statistics in a record: error_rms and so on
    error_is_length: bool = True  # or else a pure number
    error_needs_other: bool = True  # whether error_field asks for the outcome of the other representation
    error_over_target: bool = False  # whether error_relative is kept too, the rms over the largest target displacement
    headline: Headline
    columns: tuple[Column, ...] = ()  # that the tables have for this operation alone

    def default_handles(self, V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"]) -> tuple[HandleSpec, ...]:
        """Return the handles for any shape: none, unless the operation says otherwise."""
        return ()

    @abstractmethod
    def option_sources(self) -> Mapping[str, tuple[Callable[..., Any], ...]]:
        """Return for "implicit" and for "mesh" the functions whose keyword options a case may set."""
        ...

    @abstractmethod
    def edit_field(self, case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
        """Edit the neural field; the outcome has the edited field."""
        ...

    @abstractmethod
    def mesh_editors(self) -> Mapping[str, Editor]:
        """Return the mesh methods by the name of their side: "mesh" first, the one that is compared with the field."""
        ...

    def mesh_editors_beside(self, subject: Subject, target: Target, neural: Outcome) -> Mapping[str, Editor]:
        """Return further mesh methods, by the name of their side, that depend on what the neural editor has made."""
        return {}

    @abstractmethod
    def error_field(self, subject: Subject, target: Target, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
        """Return the error of an outcome at each vertex of the common mesh, in the field's units; see error_means.

        Args:
            subject: What was edited.
            target: What the handles say.
            own: The outcome to judge.
            other: The outcome of the other representation.
        """
        ...


def register(operation: Operation) -> None:
    """Let cases, studies and the command line name an operation.

    Raises:
        ValueError: The name is taken, by another operation or by a setting.
    """
    if not operation.name.isidentifier() or operation.name in (*OF_A_CASE, *OF_A_PART, *operation.settings):
        raise ValueError(
            f"The name of an operation must be a word that names no setting, but is {operation.name!r}. Take another."
        )
    add_rules(operation)


def operation_of(name: str) -> Operation:
    """Return the operation of a name.

    Raises:
        ValueError: There is none.
    """
    if name not in OPERATIONS:
        raise ValueError(f"operation must be one of {', '.join(OPERATIONS)}, but is {name!r}.")
    return cast(Operation, OPERATIONS[name])  # register takes nothing less


def operations() -> list[Operation]:
    """Return all operations, in the order in which they are run and shown."""
    return [operation_of(name) for name in OPERATIONS]


def normal_part(subject: Subject, displacement: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Return the component of a displacement along the field's outward normal at each vertex."""
    return (displacement * subject.N).sum(axis=1)


def teller(progress: Progress | None, what: str) -> Callable[[int, int, Any], None]:
    """Return the callback of an editor that tells each step on, with what is being done."""

    def tell(step: int, steps: int, row: Any) -> None:
        if progress is not None:
            progress(step, steps, what)

    return tell
