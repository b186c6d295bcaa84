"""implicit-vs-mesh paper: the figures and numbers of the paper, made again."""

from __future__ import annotations

from ast import get_docstring, parse
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import tyro

from compare.commands import exits
from compare.commands.checks import require_folder_for
from compare.commands.shown import add_task, print_markdown, progress_bars, speaker, teller
from compare.errors import InputError


@dataclass
class Paper:
    """Make the figures and numbers of the paper again, on bundled shapes and on the paper's own if you have them."""

    parts: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names of figures; all of them by default."""
    meshes: Path | None = None
    """A folder with bunny.off, cactus.off, rocker-arm.obj, bar.off, armadillo.obj, as far as you have them."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("results/paper")
    """Where the pictures and the findings go."""
    quick: bool = False
    """Coarser and with fewer steps: to see that it works, not for figures."""
    seed: int = 0
    """Of every random choice."""
    list: bool = False
    """Print the names of the figures and what each holds."""
    resume: bool = False
    """Leave out the parts that the output already holds with the same settings."""
    quiet: bool = False
    """Print nothing but errors."""


def paper(command: Paper) -> int:
    """Draw the parts that are asked for, and say where they are and what was found."""
    from compare.paper import PARTS, Request, draw_parts, pictures
    from compare.paper.findings import FILE, read_measured

    if command.list:
        return _list(PARTS)
    if unknown := [name for name in command.parts if name not in PARTS]:
        raise InputError(f"There is no figure {unknown[0]!r}; there are {', '.join(PARTS)}.")
    if command.meshes is not None and not command.meshes.is_dir():
        raise InputError(f"There is no folder {command.meshes}. Name the one that holds the meshes, or leave it out.")
    if command.output.exists() and not command.output.is_dir():
        raise InputError(f"The output {command.output} is a file, but figures are written to a folder. Name another.")
    require_folder_for(command.output)
    say = speaker(command.quiet)
    with progress_bars(command.quiet) as bars:
        all_parts, this_part = add_task(bars, "paper", None), add_task(bars, "part", None)
        request = Request(command.output, command.meshes, command.quick, command.seed, teller(bars, this_part))
        try:
            read_measured(command.output / FILE)
        except ValueError as error:
            raise InputError(str(error)) from error
        for sentence in request.check():
            say(sentence)
        parts, tell = command.parts or tuple(PARTS), teller(bars, all_parts)
        try:
            draw_parts(request, parts, resume=command.resume, progress=tell)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("The parts that are done are kept; add --resume to go on with the rest.") from None
        request.tell(1, 1, "done")
    if not command.quiet:
        print_markdown((command.output / "findings.md").read_text(encoding="utf-8"))
    for path in pictures(command.output):
        say(str(path))
    measured = read_measured(command.output / FILE)
    minutes, of_processor = (sum(p.seconds for p in measured) / 60, sum(p.processor_seconds for p in measured) / 60)
    say(f"The {len(measured)} parts took {minutes:.1f} min, {of_processor:.1f} min of processor time.")
    return exits.DONE


def _list(parts: Iterable[str]) -> int:
    """Print each part with the first sentence of its module, which is not imported: that would take torch's seconds."""
    width = max(map(len, parts))
    for name in parts:
        spec = find_spec(f"compare.paper.{name}")
        assert spec is not None
        assert spec.origin is not None
        said = get_docstring(parse(Path(spec.origin).read_text(encoding="utf-8"))) or ""
        print(f"{name:{width}}  {said.splitlines()[0]}")
    return exits.DONE
