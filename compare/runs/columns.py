"""The columns by which a record is summed up, for the terminal, the report and whoever reads neither."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from compare.runs.records import Record


@dataclass(frozen=True)
class Column:
    """A number of one side of a record and how it is written."""

    name: str
    title: str
    explains: str
    percent: bool = False
    brief: bool = True  # whether the table of a terminal, 80 characters wide, has it


SIDES = {"implicit": "neural", "mesh": "mesh", "mesh, ARAP": "ARAP", "mesh, biharmonic": "biharmonic"}

# Of a side's line in every chart; Okabe and Ito's, told apart with any kind of colour vision.
SIDE_COLOURS = {"implicit": "#0072b2", "mesh": "#d55e00", "mesh, ARAP": "#009e73", "mesh, biharmonic": "#cc79a7"}

COLUMNS = (
    Column(
        "killing_energy", "Killing", "Killing energy: integral of |P(J+J')P|² over the common mesh, a squared length"
    ),
    Column(
        "volume_drift", "volume", "volume after over before, minus one; of the field itself for the neural side", True
    ),
    Column("area_drift", "area", "area after over before, minus one; of the field itself for the neural side", True),
    Column(
        "handle_error_relative",
        "missed",
        "rms distance from the targets, over the largest displacement asked for",
        True,
    ),
    Column(
        "error_relative", "normal", "the same of the motion along the normal alone, for geometric edits", True, False
    ),
    Column("strain_rms", "strain", "rms of the local linear strain, for rigid edits", True, False),
    Column("seconds", "s", "seconds of the editor alone"),
    Column("peak_memory", "MB", "peak memory of the editor, megabytes", False, False),
)


def number(row: Mapping[str, Any], column: Column) -> float | None:
    """The value of a column in one side of a record, or None where it has no meaning."""
    return row.get(column.name)


def text(value: float | None, column: Column) -> str:
    """The value as a reader wants it."""
    if value is None:
        return ""
    if column.percent:
        if abs(value) < 1e-9:  # rounding of the sums, no finding
            return "0 %"
        return f"{100 * value:{'+' if column.name.endswith('_drift') else ''}.2g} %"
    digits = {"seconds": ".1f", "peak_memory": ".0f"}.get(column.name, ".3g")
    return f"{value:{digits}}"


def lines(record: Record) -> list[tuple[str, str, str, str, list[float | None]]]:
    """A line for each side: shape, operation, side, method, and the values of COLUMNS."""
    return [
        (
            record.case.name,
            record.case.operation,
            SIDES.get(side, side),
            row["method"],
            [number(row, c) for c in COLUMNS],
        )
        for side, row in record.sides.items()
    ]


def error_label(record: Record) -> str:
    """What the colours of a record mean, with the unit."""
    unit = "a pure number" if record.case.operation == "rigid" else "in the shape's unit of length"
    return f"{record.subject['error_means']}, {unit}"
