"""Diagrams of work and precision in a folder: measured point by point, gone on with, and drawn.

diagram.json   its name, shapes, and whether it is the quick one
rows.jsonl     a row for each point, kept as it comes
table.csv      the same for a spreadsheet
chart.svg, .png, .pdf
report.html    the chart, the crossing points in sentences, and the table
"""

from __future__ import annotations

import csv
import io
import json
import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from compare.errors import InputError, Progress
from compare.files import plain, replace_file
from compare.runs.lock import FILE as LOCK_FILE, lock
from compare.runs.provenance import surroundings
from compare.studies.diagram import Diagram, DiagramRow, Point, words_of

DIAGRAM_FILE = "diagram.json"
ROWS_FILE = "rows.jsonl"
INPUTS = "inputs"  # a folder for the networks that are fitted on the way


def run_diagram(
    diagram: Diagram,
    folder: Path,
    *,
    shapes: Sequence[str] = (),
    quick: bool = False,
    progress: Progress | None = None,
    on_row: Callable[[DiagramRow, int, int], None] | None = None,
) -> list[DiagramRow]:
    """Measure what is missing of a diagram in a folder, one point after another in this process, and draw it.

    Args:
        diagram: The diagram.
        folder: Made, or gone on with if it holds this very diagram.
        shapes: In place of its own.
        quick: Whether a few coarse points do.
        progress: Called as progress(step, steps, what) in long steps.
        on_row: Called with each row as it comes, its number and how many there are.

    Returns:
        The rows of all points; a point that failed has the reason as its status.

    Raises:
        InputError: A shape is none, or the folder holds something else or is in use.
    """
    asked = tuple(shapes) or (diagram.quick_shapes if quick else diagram.shapes)
    for shape in asked:
        _check(diagram, shape)
    head = {"diagram": diagram.name, "shapes": list(asked), "quick": quick}
    _require_folder(folder, head)
    folder.mkdir(parents=True, exist_ok=True)
    with lock(folder):
        replace_file(folder / DIAGRAM_FILE, (json.dumps(head, indent=1) + "\n").encode())
        there = {row.key: row for row in read_rows(folder) if not row.failed}
        points = diagram.points(asked, quick, folder / INPUTS, progress)
        origin = plain(surroundings())
        rows = []
        for number, point in enumerate(points, start=1):
            row = there.get(point.row.key) or _measured(point, origin)
            if point.row.key not in there:
                _append(folder / ROWS_FILE, row)
            rows.append(row)
            if on_row is not None:
                on_row(row, number, len(points))
        sum_up(diagram, rows, folder)
    return rows


def sum_up(diagram: Diagram, rows: Sequence[DiagramRow], folder: Path) -> None:
    """Write the table, the chart and the page."""
    from compare.studies.diagram_page import write_page

    write_diagram_table(rows, folder / "table.csv")
    write_page(diagram, rows, folder)


def read_rows(folder: Path) -> list[DiagramRow]:
    """Return the rows that a folder holds, the last of each key; a line that was cut off is left out."""
    path = folder / ROWS_FILE
    if not path.is_file():
        return []
    rows: dict[str, DiagramRow] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            row = DiagramRow.from_dict(json.loads(line))
        except (ValueError, TypeError, KeyError):  # the process was killed while it wrote: measured anew
            continue
        rows[row.key] = row
    return list(rows.values())


def read_head(folder: Path) -> Mapping[str, Any]:
    """Return the name of a folder's diagram, its shapes, and whether it is the quick one.

    Raises:
        InputError: The file that says so cannot be read.
    """
    path = folder / DIAGRAM_FILE
    try:
        head = json.loads(path.read_text(encoding="utf-8"))
        return {"diagram": head["diagram"], "shapes": head["shapes"], "quick": head["quick"]}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} cannot be read: {error!r}. Begin the diagram in another folder.") from error


def write_diagram_table(rows: Sequence[DiagramRow], path: Path) -> None:
    """Write a line for each row, with median, least and most of its seconds."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    what = "panel shape side method at numbers error floor seconds seconds_least seconds_most runs status"
    lines.writerow(what.split())
    for row in rows:
        times = [statistics.median(row.seconds), min(row.seconds), max(row.seconds)] if row.seconds else ["", "", ""]
        head = [row.panel, row.shape, row.side, row.method, words_of(row.at)]
        numbers = ["" if value is None else value for value in (row.numbers, row.error, row.floor)]
        lines.writerow([*head, *numbers, *times, len(row.seconds), row.status])
    replace_file(path, text.getvalue().encode())


def _measured(point: Point, origin: Mapping[str, Any]) -> DiagramRow:
    try:
        found = point.measure()
    except InputError:
        raise
    except Exception as error:  # whatever it is, it belongs to this point alone, and stands in its row
        return replace(point.row, status=f"{type(error).__name__}: {error}", provenance=origin)
    return replace(point.row, **found, provenance=origin)


def _append(path: Path, row: DiagramRow) -> None:
    with open(path, "ab") as file:
        file.write((json.dumps(plain(asdict(row))) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def _check(diagram: Diagram, shape: str) -> None:
    if shape in diagram.known_shapes:
        return
    from compare.runs.subject import check_shape

    try:
        check_shape(shape)
    except InputError as error:
        if Path(shape).suffix:
            raise
        raise InputError(
            f"A shape of {diagram.name} is one of {', '.join(diagram.known_shapes)}, or a file of a mesh or a field, "
            f"but got {shape!r}."
        ) from error


def _require_folder(folder: Path, head: Mapping[str, Any]) -> None:
    if (folder / DIAGRAM_FILE).is_file():
        before = read_head(folder)
        for name, now in head.items():
            if before.get(name) != now:
                raise InputError(
                    f"The folder {folder} holds another diagram: {name} was {before.get(name)!r}, and is {now!r} now. "
                    "Name another folder."
                )
    elif folder.is_dir() and any(path.name != LOCK_FILE for path in folder.iterdir()):
        raise InputError(f"The folder {folder} is not empty and holds no diagram. Name another or an empty one.")
