"""The record of a case, kept as one line of JSON.

A study may be killed at any moment and its rows must survive: a row is one write to a file opened for appending,
followed by fsync; a last line cut short by a crash is cut away before the next row is appended, and skipped on
reading. NaN and infinities, which JSON has no words for, are written as null.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field as default
from os import PathLike
from pathlib import Path
from typing import Any

from compare.cases.case import Case
from compare.files import plain, unwritten
from compare.runs.rows import BetweenRow, SideRow, SubjectRow

SCHEMA = 1
FILE = "results.jsonl"


@dataclass(frozen=True)
class Artefact:
    """A file that belongs to a record: its path in the run folder and the hash of its content."""

    path: str
    sha256: str

    @classmethod
    def of(cls, path: Path, folder: Path) -> Artefact:
        """Return the artefact for a file that was just written under the folder."""
        return cls(path.relative_to(folder).as_posix(), hashlib.sha256(path.read_bytes()).hexdigest())


@dataclass(frozen=True, repr=False)
class Record:
    """One case, what both representations made of it, and what is needed to believe it.

    Its rows may be given as any mapping, and are kept as those of `compare.runs.rows`: numbers by name, as in
    record.sides["implicit"]["volume_drift"], or by attribute.
    """

    case: Case
    key: str
    status: str  # a sentence
    failed: bool = False
    subject: SubjectRow = default(default_factory=SubjectRow)  # the common mesh: vertices, volume, area, scale, ...
    sides: Mapping[str, SideRow] = default(default_factory=dict)  # "implicit", "mesh" -> numbers and words
    between: BetweenRow = default(default_factory=BetweenRow)  # distances between the two results
    seconds: Mapping[str, float] = default(default_factory=dict)  # of the phases that both sides share
    notes: tuple[str, ...] = ()  # sentences: what was mended, what a reader should know
    artefacts: Mapping[str, Artefact] = default(default_factory=dict)
    provenance: Mapping[str, Any] = default(default_factory=dict)
    schema: int = SCHEMA

    def __post_init__(self) -> None:
        sides = {name: SideRow.from_row(row) for name, row in self.sides.items()}
        object.__setattr__(self, "subject", SubjectRow.from_row(self.subject))
        object.__setattr__(self, "sides", sides)
        object.__setattr__(self, "between", BetweenRow.from_row(self.between))

    def __repr__(self) -> str:
        """Return the case and how it ended in a line, and the main numbers of each side in one each."""
        lines = [f"Record({self.key}, {self.case}, {self.status!r:.160})"]
        names = ("killing_energy", "volume_drift", "handle_error_relative", "seconds")
        for side, row in self.sides.items():
            numbers = (f"{name} {row[name]:.3g}" for name in names if row.get(name) is not None)
            lines.append(f"  {side}: {', '.join(numbers)}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; numbers that JSON cannot say are None."""
        row = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        row["case"] = self.case.to_dict()
        row["artefacts"] = {name: dataclasses.asdict(a) for name, a in self.artefacts.items()}
        return plain(row)

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Record:
        """Return the record that `to_dict` wrote.

        Raises:
            ValueError: The row is of a newer schema, or no record.
        """
        if not isinstance(row, Mapping):
            raise ValueError(f"The row must be a dictionary, but is a {type(row).__name__}.")
        if row.get("schema") != SCHEMA:
            raise ValueError(
                f"The row is of schema {row.get('schema')}, but this version reads {SCHEMA}. Read it with the version "
                "that wrote it, or run the case again."
            )
        if missing := [name for name in ("case", "key", "status", "notes", "artefacts") if row.get(name) is None]:
            raise ValueError(f"The row must have {missing[0]}, but has none. Run the case again.")
        known = {f.name for f in dataclasses.fields(cls)}
        rest = {k: v for k, v in row.items() if k in known}
        rest["notes"] = tuple(row["notes"])
        rest["case"] = Case.from_dict(row["case"])
        rest["artefacts"] = {name: Artefact(**a) for name, a in row["artefacts"].items()}
        return cls(**rest)


def append(path: str | PathLike[str], record: Record) -> None:
    """Add one row to the file, whole or not at all."""
    line = json.dumps(record.to_dict(), allow_nan=False, separators=(",", ":")).encode() + b"\n"
    _cut_torn_line(Path(path))
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            written = os.write(descriptor, line)
            if written == len(line):
                os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise unwritten(Path(path), error.strerror) from error
    if written != len(line):
        raise unwritten(Path(path), f"only {written} of {len(line)} bytes found room")


def read(path: str | PathLike[str]) -> list[Record]:
    """Return all records of a file (or of a run folder), in the order they were written.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A line other than the last is not a record.
    """
    path = Path(path)
    path = path / FILE if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(f"There is no {path}. Name a folder that `implicit-vs-mesh run` wrote.")
    lines = path.read_bytes().split(b"\n")
    records = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except ValueError as error:
            if number == len(lines):  # no newline after it: the writer was killed in the middle
                break
            raise ValueError(f"Line {number} of {path} is not JSON: {error}. Remove that line.") from error
        try:
            records.append(Record.from_dict(row))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"Line {number} of {path} is no record: {error}") from error
    return records


def latest(path: str | PathLike[str]) -> list[Record]:
    """Return the last record of each case, as `read` does all: a case that failed may have been run again."""
    return list({record.key: record for record in read(path)}.values())


def _cut_torn_line(path: Path) -> None:
    """Cut the file back to its last newline: what follows was left by a writer that was killed."""
    try:
        with open(path, "rb+") as file:
            content = file.read()
            whole = content.rfind(b"\n") + 1
            if whole != len(content):
                file.truncate(whole)
                os.fsync(file.fileno())
    except FileNotFoundError:
        pass
