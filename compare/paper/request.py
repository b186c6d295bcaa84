"""What a figure of the paper is asked with, and what it gives back."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field as default
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compare.case import Case
from compare.records import replace_file
from compare.subject import InputError, Subject, prepare_subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tell = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Finding:
    """A number of the paper, or of a claim about it, and ours."""

    part: str  # the figure it belongs to
    what: str  # in words, with its definition and unit
    ours: float | str
    paper: float | str | None = None  # None where the paper gives none
    note: str = ""  # why they differ, or how ours was measured


@dataclass(frozen=True)
class Request:
    """Where the pictures go, and how they are to be made."""

    folder: Path
    meshes: Path | None = None  # a folder with meshes of the paper: bunny.off, cactus.off, rocker-arm.obj
    quick: bool = False  # coarser and with fewer steps: to see that it works, not for figures
    seed: int = 0
    tell: Tell = default(default=lambda step, steps, what: None, repr=False)

    def shapes(self, *files: str, bundled: Sequence[str] = ()) -> list[str]:
        """The bundled shapes, and those of the files that are in the folder of meshes, as names of shapes."""
        found = (
            [] if self.meshes is None else [str(self.meshes / name) for name in files if (self.meshes / name).is_file()]
        )
        return [*bundled, *found]

    def subject(self, shape: str, *, vertices: int | None = None, activation: str | None = None) -> Subject:
        """A shape as a field and a mesh; a fit is kept in the folder and read back when asked for again."""
        fit: dict[str, Any] = {"steps": 600} if self.quick else {}
        if activation is not None:
            fit["activation"] = activation
        settings: dict[str, Any] = {"vertices": 1200, "resolution": 48} if self.quick else {}
        if vertices is not None:
            settings["vertices"] = vertices
        case = Case(shape, "smooth", parameters={"fit": fit} if fit else {}, seed=self.seed, **settings)
        try:
            return prepare_subject(case, folder=self.folder, progress=self.tell)
        except (ValueError, OSError) as error:
            raise InputError(f"{shape}: {error}") from error

    def save(self, figure: Figure, name: str) -> list[Path]:
        """Write a figure as PNG and PDF."""
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / f"{name}{suffix}" for suffix in (".png", ".pdf")]
        for path in paths:
            figure.savefig(path, dpi=150)
        return paths


def write_findings(findings: Sequence[Finding], folder: Path) -> None:
    """Keep findings as findings.json, and as a table in findings.md."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(finding) for finding in findings]
    replace_file(folder / "findings.json", json.dumps(rows, indent=1, allow_nan=False).encode())
    lines = ["| figure | what | paper | ours | note |", "|---|---|---|---|---|"]
    for finding in findings:
        paper = "" if finding.paper is None else _text(finding.paper)
        lines.append(f"| {finding.part} | {finding.what} | {paper} | {_text(finding.ours)} | {finding.note} |")
    replace_file(folder / "findings.md", ("\n".join(lines) + "\n").encode())


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
