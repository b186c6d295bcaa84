"""Other libraries beside this package, in one run on one machine: python benchmarks/side_by_side.py

Each row is timed at an accuracy that it states, both sides on the same problem, in turn, the best of three each; a row
whose answer misses its accuracy says so and has no times. The rows are in the folder rows, a file each. Needs the extra
`bench`; takes all cores that it is given, and about five minutes of two. --write makes the tables of
docs/side-by-side.md anew; --quick takes small problems, to see that all rows run.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import os
import sys
import time
from importlib import import_module
from typing import Any

from pages import DOCS, made_by, replace_part

# Idle OpenMP threads that spin steal the core from whatever else runs; this must stand before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# The file and the function of each.
ROWS = {
    "step": ("edit_step", "edit_step"),
    "semantic": ("semantic_edit", "semantic_edit"),
    "extraction": ("extraction", "extraction"),
    "samples": ("samples", "samples"),
    "smoothing": ("smoothing", "smoothing"),
    "killing": ("rigid", "killing"),
    "arap": ("rigid", "arap"),
    "arap_minimum": ("arap_minimum", "arap_minimum"),
    "iarap": ("iarap", "by_iarap"),
    "floor": ("floor", "floor"),
    "scaling": ("scaling", "scaling"),
    "memory": ("scaling", "memory_of_a_large_decoder"),
    "phases": ("phases", "phases"),
}
BY_IARAP = {"samples", "iarap"}
BY_NAME_ONLY = {"scaling", "memory", "phases"}  # with nothing beside them

# Small problems, of --quick; what is not here is small as it is.
QUICK: dict[str, dict[str, Any]] = {
    "extraction": {"resolution": 160},
    "samples": {"n": 2000},
    "smoothing": {"vertices": 2000, "steps": 2},
    "killing": {"sizes": (1000,), "repeats": 1},
    "arap": {"sizes": (1000,)},
    "arap_minimum": {"iterations": 20},
    "iarap": {"seconds": 2.0},
}
PAGE = DOCS / "side-by-side.md"


class Both(io.StringIO):
    """What is printed, kept as well."""

    def write(self, text: str) -> int:
        sys.__stdout__.write(text)
        sys.__stdout__.flush()
        return super().write(text)


def write_page(printed: str, seconds: float) -> None:
    """Put the tables of a run in the page, in the place of those it has."""
    tables = [part for part in printed.split("\n\n") if part.strip().startswith("|")]
    made = f"{made_by('python benchmarks/side_by_side.py --write')}, {seconds:.0f} seconds in all."
    replace_part(PAGE, "made", made)
    for name, table in zip(("rows", "floor"), tables, strict=True):
        replace_part(PAGE, name, table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    rows = f"of {', '.join(ROWS)}; all but {', '.join(sorted(BY_NAME_ONLY))} if none is named"
    parser.add_argument("rows", nargs="*", metavar="ROW", help=rows)
    cpu = "time by the processor's seconds of this process, for a machine with other work; give it OMP_NUM_THREADS=1"
    parser.add_argument("--cpu", action="store_true", help=cpu)
    parser.add_argument("--quick", action="store_true", help="take small problems, to see that all rows run")
    parser.add_argument("--write", action="store_true", help="put the tables in docs/side-by-side.md; takes all rows")
    given = parser.parse_args()
    if given.write and (given.rows or given.quick):
        parser.error("the page has all rows at their full size: --write goes without rows and without --quick")
    if given.cpu:
        import_module("rows.table").clock = time.process_time
    chosen = given.rows or [name for name in ROWS if name not in BY_NAME_ONLY]
    if unknown := set(chosen) - set(ROWS):
        parser.error(f"there is no row {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}")
    absent = [name for name in chosen if name in BY_IARAP and importlib.util.find_spec("iarap") is None]
    if absent and (given.write or given.rows):
        parser.error(f"{', '.join(absent)} compare with iarap, which is not installed: pip install -e '.[bench]'")
    start = time.perf_counter()
    with contextlib.redirect_stdout(Both()) as printed:
        if set(chosen) - BY_NAME_ONLY - {"floor"}:
            print("| what | theirs, s | ours, s | ratio | at this accuracy |\n|---|---|---|---|---|", flush=True)
        for name in [name for name in chosen if name not in absent]:
            file, function = ROWS[name]
            getattr(import_module(f"rows.{file}"), function)(**(QUICK.get(name, {}) if given.quick else {}))
    for name in absent:
        print(f"\nLeft out: {name}, for iarap is not installed (pip install -e '.[bench]').")
    seconds = time.perf_counter() - start
    print(f"\n{seconds:.0f} s in all.")
    if given.write:
        write_page(printed.getvalue(), seconds)


if __name__ == "__main__":
    main()
