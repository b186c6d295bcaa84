"""The numbers of a run or a study as a table for other programs: a line for each case and method."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from compare.cases.settings import setting_of
from compare.files import replace_file
from compare.runs.columns import SIDES, columns, number
from compare.runs.records import Record

FILE = "table.csv"


def write_table(records: Sequence[Record], path: Path, varied: Sequence[str] = ()) -> None:
    """Write a line for each case and method: shape, what was varied, numbers and notes; for a failed case, its reason.

    Args:
        records: In the order of the lines.
        path: The file, replaced if it is there.
        varied: Names of settings, a column each.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    names = [column.name for column in columns()]
    rows.writerow(["shape", "operation", *varied, "by", "method", *names, "complete", "status", "key", "notes"])
    for record in records:
        case = record.case
        head = [case.name, case.operation, *(_word(setting_of(case, name)) for name in varied)]
        end = [record.key, " ".join(record.notes)]
        for side, row in record.sides.items():
            numbers = [_word(number(row, column)) for column in columns()]
            rows.writerow([*head, SIDES.get(side, side), row.method, *numbers, row.complete, row.status, *end])
        if record.failed:
            rows.writerow([*head, "", "", *("" for _ in columns()), False, record.status, *end])
    replace_file(path, text.getvalue().encode())


def _word(value: Any) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
