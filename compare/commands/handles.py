"""implicit-vs-mesh handles: where a shape lies, and a file of handles to begin with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from compare.cases.handles_file import handles_text
from compare.cases.registry import OPERATIONS
from compare.commands import exits
from compare.commands.checks import require_folder_for
from compare.errors import InputError
from compare.files import replace_file
from compare.runs.subject import check_shape

DIGITS = 6
REMARK = '   # those of the shape\'s file; or "field"'


@dataclass
class Handles:
    """Say where a shape lies, in its file's coordinates and in its field's, and write handles to begin with."""

    shape: tyro.conf.Positional[str]
    """A bundled shape, a mesh or a field, as for `run`."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE.toml")] = None
    """Where handles go that `run --handles` takes, in the coordinates of the shape's file; a file that is not there."""
    module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:FUNCTION")] = None
    """What builds the network of a field of your own, my_nets.py:make or package.module:function; its code is run."""


def handles(command: Handles) -> int:
    """Print the ranges of the shape, and write its default handles of a rigid edit."""
    if command.output is not None:
        if command.output.exists() or command.output.suffix != ".toml":
            raise InputError(f"Handles are written to a new file ending in .toml, but the output is {command.output}.")
        require_folder_for(command.output)
    check_shape(command.shape, command.module)

    from compare.studies.plan import placed_outline

    V, N, _, units = placed_outline(command.shape, command.module)
    of_user = V * units.scale + units.offset
    for axis, name in enumerate("xyz"):
        ranges = [f"{points[:, axis].min():.4g} to {points[:, axis].max():.4g}" for points in (of_user, V)]
        print(f"{name}  {ranges[0]} in the file's coordinates, {ranges[1]} in the field's")
    if command.output is not None:
        back = 1 / units.scale, [-x / units.scale for x in units.offset]  # the user's as seen from the field's
        found = [handle.in_field(*back) for handle in OPERATIONS["rigid"].default_handles(V, N)]
        replace_file(command.output, handles_text(found, "user", digits=DIGITS, remark=REMARK).encode())
        print(f"{command.output}: {len(found)} handles; change them, and give them to run --handles {command.output}.")
    return exits.DONE
