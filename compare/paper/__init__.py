"""The paper's figures and numbers, made again with shapes at hand: a file a figure, each with one function `draw`.

A figure is asked for by name (`PARTS`), draws its pictures into the folder of the request, and returns what it
measured beside what the paper says.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from compare.paper.request import Finding, Request, write_findings

__all__ = ["PARTS", "Finding", "Request", "draw_parts"]

# Modules of this package, in the order of the paper.
PARTS: tuple[str, ...] = (
    "basis",
    "geometric",
    "splitting",
    "semantic",
    "semantic_basis",
    "semantic_spheres",
    "semantic_damping",
    "smoothing",
    "rigid",
    "rigid_bends",
)


def draw_parts(request: Request, parts: Sequence[str] = PARTS) -> list[Finding]:
    """Draw parts of the paper, one after the other, keeping the findings of each as soon as it is done.

    Args:
        request: Where to, on which shapes, how finely.
        parts: Names out of PARTS.

    Returns:
        The findings, which are also in findings.json and findings.md of the folder, beside the pictures.
    """
    findings: list[Finding] = []
    for done, part in enumerate(parts):
        request.tell(done, len(parts), part)
        findings += import_module(f"compare.paper.{part}").draw(request)
        write_findings(findings, request.folder)
    request.tell(len(parts), len(parts), "done")
    return findings


def pictures(folder: Path) -> list[Path]:
    """The pictures that are in a folder."""
    return sorted(path for path in folder.iterdir() if path.suffix in (".png", ".pdf"))
