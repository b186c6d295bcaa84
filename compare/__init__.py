"""Neural and mesh editing of the same shapes with the same handles: run, measure, keep, show.

Importing this package is quick; torch and the mesh libraries are imported by what needs them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from compare import operations  # noqa: F401, registers what cases can name
from compare.reports.report import report  # here, for a later import of its module would take the function's place

if TYPE_CHECKING:
    from compare.cases.case import Case
    from compare.cases.default_cases import default_cases
    from compare.cases.handles import HandleSpec
    from compare.cases.subject import Subject
    from compare.errors import InputError
    from compare.fitting.fit import FitReport, fit_mesh
    from compare.reports.animation import write_animation
    from compare.reports.show import draw, show
    from compare.runs.executors import Workers
    from compare.runs.records import Record
    from compare.runs.run import run_case, run_cases
    from compare.runs.subject import prepare_subject
    from compare.studies.study import Study, find_study
    from compare.studies.study_folder import run_study

# Where each public name lives. Its module is imported when the name is first used.
_MODULES = {
    "run_case": "runs.run",
    "run_cases": "runs.run",
    "run_study": "studies.study_folder",
    "find_study": "studies.study",
    "Study": "studies.study",
    "Workers": "runs.executors",
    "Case": "cases.case",
    "HandleSpec": "cases.handles",
    "default_cases": "cases.default_cases",
    "Record": "runs.records",
    "show": "reports.show",
    "draw": "reports.show",
    "fit_mesh": "fitting.fit",
    "FitReport": "fitting.fit",
    "prepare_subject": "runs.subject",
    "write_animation": "reports.animation",
    "Subject": "cases.subject",
    "InputError": "errors",
}

__all__ = [
    "run_case",
    "run_cases",
    "run_study",
    "find_study",
    "Study",
    "Workers",
    "Case",
    "HandleSpec",
    "default_cases",
    "Record",
    "report",
    "show",
    "draw",
    "write_animation",
    "fit_mesh",
    "FitReport",
    "prepare_subject",
    "Subject",
    "InputError",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'compare' has no attribute {name!r}; it has {', '.join(__all__)}.")
    value = getattr(importlib.import_module(f"compare.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
