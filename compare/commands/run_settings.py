"""The make of a run folder, kept so that a finished run is known without loading anything.

run.json   the settings of the command, hashes of what its files held, and the keys of its cases
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from compare.cases.case import Case, content_of
from compare.files import plain, replace_file
from compare.reports.table import FILE as TABLE
from compare.runs.records import FILE as RECORDS, Record, latest

FILE = "run.json"
PAGE = "report.html"
SCHEMA = 1

# What does not change what a run gives: where it runs, and what it prints.
ASIDE = {"output", "workers", "dask", "resume", "json", "quiet"}


def keep_settings(command: Any, cases: Sequence[Case], folder: Path) -> None:
    """Write what a run is made of, once its cases are known."""
    row = {"schema": SCHEMA, **_settings(command), "cases": [case.key for case in cases]}
    replace_file(folder / FILE, (json.dumps(row, indent=1) + "\n").encode())


def finished_records(command: Any, folder: Path) -> list[Record] | None:
    """Return the records of a folder that holds all that a command asks for; None where something is to be done.

    Args:
        command: The settings, a dataclass.
        folder: The run folder.
    """
    try:
        row = json.loads((folder / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None  # of an earlier version, or broken off before its cases were known
    if not isinstance(row, Mapping) or not all((folder / name).is_file() for name in (RECORDS, TABLE, PAGE)):
        return None
    kept = row.get("cases")
    if not isinstance(kept, list) or {**row, "cases": None} != {"schema": SCHEMA, **_settings(command), "cases": None}:
        return None
    done = {record.key: record for record in latest(folder) if not record.failed}
    if set(kept) <= set(done):
        return [done[key] for key in kept]
    return None


def _settings(command: Any) -> dict[str, Any]:
    """Return the settings that decide what a run gives, with hashes of the files that they name."""
    settings = {name: _word(value) for name, value in asdict(command).items() if name not in ASIDE}
    files = [command.handles, _source_of(command.module)]
    contents = {str(name): content_of(name) for name in command.shapes}
    contents |= {str(path): _hash(Path(path)) for path in files if path is not None}
    return {"settings": json.loads(json.dumps(plain(settings))), "contents": contents}


def _word(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def _source_of(module: str | None) -> str | None:
    """Return the file of a user's function, where it is named by a file."""
    place = module.rpartition(":")[0] if module else ""
    return place if place.endswith(".py") else None


def _hash(path: Path) -> str:
    return "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "nothing"
