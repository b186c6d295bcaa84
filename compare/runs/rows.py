"""The rows of a record: its numbers by attribute, and by name as in its JSON.

    record.sides["implicit"].volume_drift  ==  record.sides["implicit"]["volume_drift"]

Which numbers a row has depends on the operation, and on the version that wrote it: a row holds those that it was given.
A number that JSON could not say (NaN, or one that was not to be had) is None; one that the row lacks is no key of it,
and an AttributeError. What no field is for, as the error of another operation, stands in `more`, and is a key like any.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

Number = float | None
R = TypeVar("R", bound="Row")


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Row(Mapping[str, Any]):
    """A frozen row; equal to any mapping with the same keys and values."""

    more: Mapping[str, Any]  # what no field is for

    def __init__(self, /, **numbers: Any) -> None:
        for name in self._names():
            if name in numbers:
                object.__setattr__(self, name, numbers.pop(name))
        object.__setattr__(self, "more", numbers)

    @classmethod
    def from_row(cls: type[R], row: Mapping[str, Any]) -> R:
        """Return the row that holds what a mapping holds.

        Raises:
            TypeError: It is no mapping.
        """
        if isinstance(row, cls):
            return row
        if not isinstance(row, Mapping):
            raise TypeError(f"A row of a record must be a dictionary, but is {row!r:.100}.")
        return cls(**row)

    @classmethod
    def _names(cls) -> list[str]:
        """Return the names of the fields that are keys, in the order of the JSON."""
        return [field.name for field in dataclasses.fields(cls) if field.name != "more"]

    def __getitem__(self, name: str) -> Any:
        if name != "more" and name in self.__dict__:
            return self.__dict__[name]
        return self.more[name]

    def __iter__(self) -> Iterator[str]:
        yield from (name for name in self._names() if name in self.__dict__)
        yield from self.more

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __repr__(self) -> str:
        """Return the numbers in one line; of what is long, only its length."""
        words = (f"{name}={_word(value)}" for name, value in self.items())
        return f"{type(self).__name__}({', '.join(words)})"

    if not TYPE_CHECKING:  # or every misspelt attribute would pass the type checker

        def __getattr__(self, name: str) -> Any:
            if name == "more" or name.startswith("__"):  # asked for before there is anything, as by pickle
                raise AttributeError(name)
            raise AttributeError(f"This {type(self).__name__} has no {name}; it has {', '.join(self)}.")


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CurveRow(Row):
    """An edit's numbers after a step."""

    step: Number
    seconds: Number
    volume_drift: Number
    area_drift: Number
    killing_energy: Number


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SideRow(Row):
    """One editor's result of a case, measured; see docs/metrics.md for each number."""

    method: str
    status: str
    complete: bool
    killing_energy: Number
    killing_ambient: Number
    killing_notebook: Number
    killing_spokes_and_rims: Number
    arap_energy: Number
    volume_before: Number
    volume_after: Number
    volume_drift: Number
    area_before: Number
    area_after: Number
    area_drift: Number
    volume_error: Number  # estimated, of the drifts of a field
    area_error: Number
    flow_error_relative: Number  # estimated, for smoothing
    constraint_error: Number  # estimated, where something is held
    displacement_max: Number
    error_mean: Number
    error_rms: Number
    error_p95: Number
    error_max: Number
    strain_mean: Number  # in place of the error, for rigid edits
    strain_rms: Number
    strain_p95: Number
    strain_max: Number
    handle_error_rms: Number  # where handles have targets
    handle_error_max: Number
    handle_error_relative: Number
    error_relative: Number  # for geometric edits
    seconds: Number
    seconds_by_phase: Mapping[str, float]
    peak_memory: Number
    details: Mapping[str, Any]
    bodies: int  # of the edited field
    curve: Sequence[CurveRow]

    def __init__(self, /, **numbers: Any) -> None:
        super().__init__(**numbers)
        if "curve" in self:
            object.__setattr__(self, "curve", [CurveRow.from_row(row) for row in self.curve])


@dataclass(frozen=True, init=False, eq=False, repr=False)
class SubjectRow(Row):
    """The common mesh and the field, in the user's units."""

    vertices: int
    faces: int
    parameters: int  # of the network
    scale: float
    offset: Sequence[float]
    sides: Sequence[float]  # of the box round the mesh
    volume: Number
    area: Number
    genus: int
    bodies: int
    fit: Mapping[str, Any] | None
    error_means: str  # the error of a vertex in words


@dataclass(frozen=True, init=False, eq=False, repr=False)
class BetweenRow(Row):
    """Two-sided distances between the results of the field and of the mesh."""

    chamfer: Number
    hausdorff: Number
    distance_rms: Number
    normal_consistency: Number
    iou: Number


def _word(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping | list | tuple):
        return f"<{len(value)}>"
    return str(value)
