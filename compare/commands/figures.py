"""implicit-vs-mesh figures: the still pictures of a run folder."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from compare.errors import InputError
from compare.runs.records import latest


@dataclass
class Figures:
    """Paint the still pictures of a run folder, PNG and PDF, one a shape."""

    folder: tyro.conf.Positional[Path]
    """What `run` wrote."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where the pictures go; by default figures/ in the run folder."""
    formats: tuple[Literal["png", "pdf", "svg", "glb"], ...] = ("png", "pdf")
    """Which kinds; glb is the result of each method in 3D, with the colours of its error."""
    azimuth: float | None = None
    """Degrees about the axis that is up, from where to look; by default where most of what moves is seen."""
    painter: Literal["auto", "pyvista", "matplotlib"] = "auto"
    """What paints: pyvista draws smoother, but needs the extra `figures` and OpenGL; auto takes it where it can."""


def figures(command: Figures) -> int:
    """Paint the pictures from the rows and meshes that are there."""
    from compare.reports.figures import draw_figures, usable_painter, write_models
    from compare.reports.views import Camera, up_of

    try:
        records = latest(command.folder)
        up = up_of(records[0].case.shape) if records else "y"
        camera = None if command.azimuth is None else Camera(command.azimuth, up=up)
        painter, reason = usable_painter(command.painter)
        written = draw_figures(
            records,
            command.folder,
            output=command.output,
            formats=[name for name in command.formats if name != "glb"],
            camera=camera,
            painter=painter,
        )
        if "glb" in command.formats:
            written += write_models(records, command.folder, command.output or command.folder / "figures")
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    if reason is not None:
        print(f"Painted by matplotlib: {reason}", file=sys.stderr)
    for path in written:
        print(path)
    return 0
