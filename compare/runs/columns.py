"""The columns by which a record is summed up, for the terminal, the report and whoever reads neither."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from compare.operations.operation import Column, operation_of, operations
from compare.runs.records import Record

SIDES = {
    "implicit": "neural",
    "mesh": "mesh",
    "mesh, ARAP": "ARAP",
    "mesh, biharmonic": "biharmonic",
    "mesh, conformalised": "conformalised",
    "mesh, equal error": "mesh, as far off",
    "mesh, ARAP, equal error": "ARAP, as far off",
}

# Of a side's line in every chart; Okabe and Ito's, told apart with any kind of colour vision.
SIDE_COLOURS = {
    "implicit": "#0072b2",
    "mesh": "#d55e00",
    "mesh, ARAP": "#009e73",
    "mesh, biharmonic": "#cc79a7",
    "mesh, conformalised": "#cc79a7",
    "mesh, equal error": "#e69f00",
    "mesh, ARAP, equal error": "#56b4e9",
}

LEAST_SHARE = 1e-5  # below this a share says that something was held, and not by how much
LEAST_SECONDS = 0.01

# What every side has, before and after what single operations add.
_JUDGED = (
    Column(
        "killing_energy",
        "Killing",
        "Killing energy: integral of |P(J+J')P|² over the common mesh, a squared length",
        label="Killing energy",
        unit="length²",
    ),
    Column(
        "volume_drift",
        "volume",
        "volume after over before, minus one; of the field itself for the neural side",
        percent=True,
        label="drift of the volume",
    ),
    Column(
        "area_drift",
        "area",
        "area after over before, minus one; of the field itself for the neural side",
        percent=True,
        label="drift of the area",
    ),
    Column(
        "handle_error_relative",
        "missed",
        "rms distance from the targets, over the largest displacement asked for",
        percent=True,
        label="handles missed, relative",
    ),
)
# How well the above is known.
_ESTIMATED = (
    Column(
        "volume_error",
        "volume±",
        "estimated error of the volume's drift, of the quadratures of the field",
        percent=True,
        brief=False,
        label="estimated error of the volume's drift",
    ),
    Column(
        "area_error",
        "area±",
        "estimated error of the area's drift, of the quadratures of the field",
        percent=True,
        brief=False,
        label="estimated error of the area's drift",
    ),
    Column(
        "constraint_error",
        "held±",
        "estimated error with which it is known that the volume was held",
        percent=True,
        brief=False,
        label="estimated error of what is held",
    ),
)
_COSTS = (
    Column("seconds", "s", "seconds of the editor alone", label="seconds of the editor", unit="s"),
    Column("peak_memory", "MB", "peak memory of the editor, megabytes", brief=False, unit="MB"),
)


def columns() -> tuple[Column, ...]:
    """Return the columns of every table, in their order."""
    own = [column for operation in operations() for column in operation.columns]
    return (*_JUDGED, *own, *_ESTIMATED, *_COSTS)


def column_of(name: str) -> Column | None:
    """Return the column of a name; None where there is none."""
    return next((column for column in columns() if column.name == name), None)


def number(row: Mapping[str, Any], column: Column) -> float | None:
    """Return the value of a column in one side of a record, or None where it has no meaning."""
    return row.get(column.name)


def text(value: float | None, column: Column) -> str:
    """Return the value as a reader likes to have it; what is too small to count is said to be below what counts."""
    if value is None:
        return ""
    if column.percent:
        if abs(value) < 1e-9:  # rounding of the sums, no finding
            return "0 %"
        if abs(value) < LEAST_SHARE:
            return f"<{100 * LEAST_SHARE:g} %"
        return percentage(value, sign=column.name.endswith("_drift"))
    if column.name == "seconds":
        return duration(value)
    return f"{value:{'.0f' if column.name == 'peak_memory' else '.3g'}}"


def duration(seconds: float) -> str:
    """Return seconds with two digits that count, and those too short to be measured as what they are."""
    if seconds < LEAST_SECONDS:
        return f"<{LEAST_SECONDS:g}"
    return f"{seconds:.2f}" if seconds < 0.1 else f"{seconds:.1f}" if seconds < 99.5 else f"{seconds:.0f}"


def percentage(value: float, *, sign: bool = False) -> str:
    """Return a share in per cent with two digits that count, and without powers of ten where it is large."""
    percent = 100 * value
    size = f"{percent:{'+' if sign else ''}.2g}" if abs(percent) < 99.5 else f"{percent:{'+' if sign else ''},.0f}"
    return f"{size} %"


def lines(record: Record) -> list[tuple[str, str, str, str, list[float | None]]]:
    """Return a line for each side: shape, operation, side, method, and the values of the columns."""
    return [
        (
            record.case.name,
            record.case.operation,
            SIDES.get(side, side),
            row.method,
            [number(row, c) for c in columns()],
        )
        for side, row in record.sides.items()
    ]


def error_label(record: Record) -> str:
    """Return what the colours of a record mean, with the unit."""
    is_length = operation_of(record.case.operation).error_is_length
    unit = "in the shape's unit of length" if is_length else "a pure number"
    return f"{record.subject.error_means}, {unit}"
