"""Other libraries beside this package, in one run on one machine: python benchmarks/side_by_side.py

Each row is timed at an accuracy that it states, both sides on the same problem, in turn, the best of three each; a row
whose answer misses its accuracy says so and has no times. The rows are in the folder rows, a file each. Needs the extra
`bench`; takes all cores that it is given.
"""

from __future__ import annotations

import argparse
import os
import time
from importlib import import_module

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
BY_NAME_ONLY = {"scaling", "memory", "phases"}  # with nothing beside them


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    rows = f"of {', '.join(ROWS)}; all but {', '.join(sorted(BY_NAME_ONLY))} if none is named"
    parser.add_argument("rows", nargs="*", metavar="ROW", help=rows)
    cpu = "time by the processor's seconds of this process, for a machine with other work; give it OMP_NUM_THREADS=1"
    parser.add_argument("--cpu", action="store_true", help=cpu)
    given = parser.parse_args()
    if given.cpu:
        import_module("rows.table").clock = time.process_time
    chosen = given.rows or [name for name in ROWS if name not in BY_NAME_ONLY]
    if unknown := set(chosen) - set(ROWS):
        parser.error(f"there is no row {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}")
    start = time.perf_counter()
    if set(chosen) - BY_NAME_ONLY - {"floor"}:
        print("| what | theirs, s | ours, s | ratio | at this accuracy |\n|---|---|---|---|---|", flush=True)
    for name in chosen:
        file, function = ROWS[name]
        getattr(import_module(f"rows.{file}"), function)()
    print(f"\n{time.perf_counter() - start:.0f} s in all.")


if __name__ == "__main__":
    main()
