"""implicit-vs-mesh report: the page of a run folder again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from compare.errors import InputError
from compare.runs.records import latest


@dataclass
class Report:
    """Write report.html of a run folder again."""

    folder: tyro.conf.Positional[Path]
    """What `run` or `study` wrote."""
    up: Literal["auto", "x", "y", "z"] = "auto"
    """Axis that points up; auto is z for .stl and .3mf and y for all else."""


def report(command: Report) -> int:
    """Write the page from the rows and meshes that are there."""
    from compare.reports.report import report as write_report

    try:
        page = write_report(latest(command.folder), command.folder / "report.html", up=command.up)
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    print(page)
    return 0
