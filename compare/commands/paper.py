"""implicit-vs-mesh paper: the figures and numbers of the paper, made again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from compare.commands.checks import require_folder_for
from compare.commands.shown import add_task, progress_bars, teller
from compare.subject import InputError


@dataclass
class Paper:
    """Make the figures and numbers of the paper again, on bundled shapes and on the paper's own if you have them."""

    parts: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names of figures; all of them by default."""
    meshes: Path | None = None
    """A folder with bunny.off, cactus.off, rocker-arm.obj, as far as you have them."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("results/paper")
    """Where the pictures and the findings go."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    seed: int = 0
    """Of every random choice."""
    quiet: bool = False
    """Print nothing but errors."""


def paper(command: Paper) -> int:
    """Draw the parts that are asked for, and say where they are and what was found."""
    from compare.paper import PARTS, Request, draw_parts, pictures

    if unknown := [name for name in command.parts if name not in PARTS]:
        raise InputError(f"There is no figure {unknown[0]!r}; there are {', '.join(PARTS)}.")
    if command.meshes is not None and not command.meshes.is_dir():
        raise InputError(f"There is no folder {command.meshes}. Name the one that holds the meshes, or leave it out.")
    if command.output.exists() and not command.output.is_dir():
        raise InputError(f"The output {command.output} is a file, but figures are written to a folder. Name another.")
    require_folder_for(command.output)
    command.output.mkdir(parents=True, exist_ok=True)
    with progress_bars(command.quiet) as bars:
        tell = teller(bars, add_task(bars, "paper", None))
        request = Request(command.output, command.meshes, command.quick, command.seed, tell)
        draw_parts(request, command.parts or PARTS)
    if not command.quiet:
        print((command.output / "findings.md").read_text())
        for path in pictures(command.output):
            print(path)
    return 0
