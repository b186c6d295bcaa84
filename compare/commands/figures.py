"""implicit-vs-mesh figures: the still pictures of a run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from compare.records import latest
from compare.subject import InputError


@dataclass
class Figures:
    """Paint the still pictures of a run folder, PNG and PDF, one a shape."""

    folder: tyro.conf.Positional[Path]
    """What `run` wrote."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Where the pictures go; by default figures/ in the run folder."""
    formats: tuple[Literal["png", "pdf", "svg"], ...] = ("png", "pdf")
    """Which kinds."""
    azimuth: float | None = None
    """Degrees about the y axis, from where to look; by default where most of what moves is seen."""


def figures(command: Figures) -> int:
    """Paint the pictures from the rows and meshes that are there."""
    from compare.figures import Camera, draw_figures

    camera = None if command.azimuth is None else Camera(command.azimuth)
    try:
        written = draw_figures(
            latest(command.folder), command.folder, output=command.output, formats=command.formats, camera=camera
        )
    except (FileNotFoundError, ValueError) as error:
        raise InputError(str(error)) from error
    for path in written:
        print(path)
    return 0
