"""implicit-vs-mesh report: the page of a run folder again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from compare.errors import InputError
from compare.runs.records import latest


@dataclass
class Report:
    """Write report.html of a run folder again."""

    folder: tyro.conf.Positional[Path]
    """What `run` wrote."""


def report(command: Report) -> int:
    """Write the page from the rows and meshes that are there."""
    from compare.reports.report import report as write_report

    try:
        page = write_report(latest(command.folder), command.folder / "report.html")
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    print(page)
    return 0
