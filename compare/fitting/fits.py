"""The table of fits: every mesh of a folder fitted at one or more widths, with seconds and errors.

python -m compare.fitting.fits FOLDER [--widths 32 64] [-o docs/fits.md]
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path

import torch

import meshref
from compare.cases.case import MESH_SUFFIXES
from compare.files import replace_file
from compare.fitting.fit import FitReport, fit_mesh

COLUMNS = (
    "mesh",
    "network",
    "mean %",
    "max %",
    "volume %",
    "area %",
    "normal °",
    "genus",
    "bodies",
    "seconds",
    "good",
    "mended",
)


def row(name: str, width: int, report: FitReport) -> tuple[str, ...]:
    """Return one line of the table; distances in per cent of the diagonal of the mesh's box."""
    return (
        name,
        f"3 x {width}",
        f"{100 * report.mean_distance:.3f}",
        f"{100 * report.max_distance:.2f}",
        f"{100 * report.volume_error:+.2f}",
        f"{100 * report.area_error:+.1f}",
        f"{report.normal_error:.1f}",
        f"{report.genus} ({report.genus_mesh})",
        f"{report.components} ({report.components_mesh})",
        f"{report.seconds:.0f}",
        "yes" if report.good else "no",
        "; ".join(step.rstrip(".") for step in report.mended) or "nothing",
    )


def table(rows: Iterable[Sequence[str]]) -> str:
    """Return the table as Markdown."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    return "\n".join([*lines, *("| " + " | ".join(r) + " |" for r in rows)]) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit, print each row as it comes, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m compare.fitting.fits", description=__doc__)
    parser.add_argument("folder", type=Path, help="a folder with meshes")
    parser.add_argument("--widths", type=int, nargs="+", default=[32], help="units in each of the three layers")
    parser.add_argument("-o", "--output", type=Path, help="a Markdown file to write the table to")
    options = parser.parse_args(arguments)
    paths = sorted(p for p in options.folder.glob("*") if p.suffix.lower() in MESH_SUFFIXES)
    if not paths:
        print(f"There is no mesh in {options.folder}; it needs files in {', '.join(MESH_SUFFIXES)}.", file=sys.stderr)
        return 2
    rows = []
    for width in options.widths:
        for path in paths:
            try:
                rows.append(row(path.name, width, fit_mesh(*meshref.read_mesh(path), width=width)[1]))
            except meshref.MeshError as error:
                print(f"{path.name} is left out: {error}", file=sys.stderr)
                continue
            print(" | ".join(rows[-1]), flush=True)
            if options.output is not None:  # as far as it came, so that an interruption keeps what is done
                options.output.parent.mkdir(parents=True, exist_ok=True)
                replace_file(options.output, _page(table(rows)).encode())
    return 0


def _page(text: str) -> str:
    return (
        "# Fits\n\n"
        "Made by `python -m compare.fitting.fits FOLDER --widths 32 64 128 -o docs/fits.md` on "
        f"{date.today()}, {platform.machine()}, {torch.get_num_threads()} thread(s). "
        "Distances are in per cent of the diagonal of the mesh's box, "
        "from 20,000 samples on each surface; in brackets, the mesh's own genus and number of bodies. "
        "Seconds count all: mending, sampling, 4000 steps of training, and the report.\n\n" + text
    )


if __name__ == "__main__":
    sys.exit(main())
