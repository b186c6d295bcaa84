"""Run the diagram of work and precision, and put it in docs/studies.md: python -m benchmarks.diagram_page

What the folder has already is not measured again, so that a run that was stopped goes on. Timings are of the clock: run
it with nothing beside it; it takes some twenty minutes of one core. --quick runs the small one, and leaves docs alone.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.pages import DOCS, made_by, replace_part
from compare.studies.diagram import DiagramRow
from compare.studies.diagram_page import sentences
from compare.studies.diagram_run import run_diagram
from compare.studies.diagrams import DIAGRAMS

DIAGRAM = DIAGRAMS["work-precision"]


def write_page(rows: Sequence[DiagramRow], folder: Path, page: Path) -> None:
    """Copy the picture of a folder beside the page, and write its sentences under it, and which points failed."""
    picture = f"{DIAGRAM.name}.png"
    shutil.copyfile(folder / "chart.png", page.parent / picture)
    made = made_by("python -m benchmarks.diagram_page")
    lines = [
        f"![Error against seconds and against numbers stored, of volume, smoothing and rigid editing]({picture})",
        "",
    ]
    lines += [f"{made}; seconds are medians of two to five runs.", ""]
    lines += [f"- {sentence}" for sentence in sentences(DIAGRAM, rows)]
    reasons = dict.fromkeys(row.status for row in rows if row.failed)
    for reason in reasons:
        lines.append(
            f"- Not drawn: {', '.join(row.key for row in rows if row.failed and row.status == reason)}. {reason}"
        )
    replace_part(page, DIAGRAM.name, "\n".join(lines))


def told(row: DiagramRow, number: int, count: int) -> None:
    print(f"{number} of {count}: {row.key}: {row.status}", flush=True)


def main(arguments: Sequence[str]) -> int:
    """Run the diagram, print a line for each point, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="folder; default: results/work-precision, or -quick")
    parser.add_argument("--quick", action="store_true", help="run the small one, and leave docs alone")
    asked = parser.parse_args(arguments)
    folder = asked.output or Path("results") / (DIAGRAM.name + "-quick" * asked.quick)
    start = time.perf_counter()
    rows = run_diagram(DIAGRAM, folder, quick=asked.quick, on_row=told)
    failed = [row.key for row in rows if row.failed]
    print(f"{time.perf_counter() - start:.0f} s in all; failed: {', '.join(failed) or 'none'}.")
    if not asked.quick:
        write_page(rows, folder, DOCS / "studies.md")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
