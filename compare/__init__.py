"""Neural and mesh editing of the same shapes with the same handles: run, measure, keep, show.

Importing this package is quick; torch and the mesh libraries are imported by what needs them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from compare.report import report  # here, for a later import of its module would take the function's place

if TYPE_CHECKING:
    from compare.case import Case, HandleSpec, default_cases
    from compare.executors import Workers
    from compare.fit import FitReport, fit_mesh
    from compare.records import Record
    from compare.run import run_case, run_cases
    from compare.study import Study, find_study
    from compare.study_folder import run_study
    from compare.subject import InputError, Subject, prepare_subject

# Where each public name lives. Its module is imported when the name is first used.
_MODULES = {
    "run_case": "run",
    "run_cases": "run",
    "run_study": "study_folder",
    "find_study": "study",
    "Study": "study",
    "Workers": "executors",
    "Case": "case",
    "HandleSpec": "case",
    "default_cases": "case",
    "Record": "records",
    "fit_mesh": "fit",
    "FitReport": "fit",
    "prepare_subject": "subject",
    "Subject": "subject",
    "InputError": "subject",
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
