"""The paper's figures and those measured, kept part by part: a run that is cut short loses one part at most.

findings.json of a folder holds each part with the settings it was made with, when, where, and in what time;
findings.md is the same as a table. A part that is made again takes the place of the older one; the others stay.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from compare.files import plain, replace_file

FILE = "findings.json"
SCHEMA = 1


@dataclass(frozen=True)
class Finding:
    """A number of the paper, or of a claim about it, and ours."""

    part: str  # the figure it belongs to
    what: str  # in words, with its definition, and its unit in brackets at the end
    ours: float | str | None  # None where it could not be measured; the note says why
    paper: float | str | None = None  # None where the paper gives none, or none is known to us
    note: str = ""  # why they differ, or how ours was measured
    headline: bool = False  # whether it is a row of the README's table


@dataclass(frozen=True)
class Measured:
    """The findings of one part, and how they came about."""

    part: str
    findings: tuple[Finding, ...]
    settings: Mapping[str, Any]  # whatever decides the numbers, as `Request.settings` has it
    provenance: Mapping[str, Any]  # when, on which machine, with which versions
    seconds: float  # by the clock
    processor_seconds: float  # of all threads together, whatever else the machine did

    @property
    def quick(self) -> bool:
        """Return whether it was made coarsely."""
        return bool(self.settings["quick"])


def read_measured(path: Path) -> list[Measured]:
    """Return the parts that a file holds; none if it is not there.

    Raises:
        ValueError: It is no file of findings.
    """
    if not path.exists():
        return []
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"its schema is {document['schema']}, but this version reads {SCHEMA}")
        names = {entry.name for entry in fields(Measured)}
        return [
            Measured(**{**{n: row[n] for n in names}, "findings": tuple(Finding(**f) for f in row["findings"])})
            for row in document["parts"]
        ]
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise ValueError(
            f"{path} holds no findings of `paper` that can be read ({error}). Move it away, or name another folder."
        ) from error


def write_measured(measured: Iterable[Measured], path: Path) -> None:
    """Keep parts in a file, whole or not at all."""
    document = plain({"schema": SCHEMA, "parts": [asdict(part) for part in measured]})
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
    replace_file(path, f"{text}\n".encode())


def table(measured: Iterable[Measured], *, headlines: bool = False) -> str:
    """Findings as a table in Markdown, and their notes by number below it; those of a quick run say so.

    Args:
        measured: Parts, in the order of the table.
        headlines: Whether to take only the findings that are marked so.
    """
    lines = ["| part | what | paper | ours | note |", "|---|---|---|---|---|"]
    notes: dict[str, int] = {}
    for part in measured:
        for finding in part.findings:
            if finding.headline or not headlines:
                cells = (
                    f"{part.part} (quick)" if part.quick else part.part,
                    finding.what,
                    _text(finding.paper),
                    _text(finding.ours),
                    str(notes.setdefault(finding.note, len(notes) + 1)) if finding.note else "",
                )
                row = " | ".join(cell.replace("|", "\\|") for cell in cells)
                lines.append(f"| {row} |")
    if notes:
        lines += ["", "Notes:", "", *(f"{number}. {note}" for note, number in notes.items())]
    return "\n".join(lines) + "\n"


def _text(value: float | str | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.4g}"
