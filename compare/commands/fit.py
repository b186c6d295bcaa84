"""implicit-vs-mesh fit: a neural field for a mesh, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from compare.cases.case import MESH_SUFFIXES
from compare.commands.checks import require_folder_for, require_hole_limit, require_new_safetensors, require_seed
from compare.commands.shown import add_task, progress_bars, say_mending, speaker, teller
from compare.errors import InputError
from compare.fitting.mending import Mending
from compare.runs.subject import check_shape

if TYPE_CHECKING:
    from torch import nn


@dataclass
class Fit:
    """Fit a neural field to a mesh, and write how good it is beside it, as .json."""

    mesh: tyro.conf.Positional[Path]
    """The mesh: .obj, .off, .ply, .stl, .glb, .gltf, and with the packages of the extra "formats" .3mf and .dae."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where the field goes: a file ending in .safetensors that is not there yet."""
    width: int = 32
    """Units in each hidden layer."""
    depth: int = 3
    """Hidden layers."""
    activation: Literal["sine", "softplus", "relu"] = "sine"
    """Of the hidden layers."""
    module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:FUNCTION")] = None
    """What builds a network of your own to train in place of these, my_nets.py:make or package.module:function, called
    without arguments; its code is run. The field's file names it."""
    steps: int = 4000
    """Of the training."""
    bodies: Literal["refuse", "largest", "keep"] = "refuse"
    """What is done with several bodies that are not connected: refused, only the largest fitted, or all."""
    hole_limit: Annotated[float, tyro.conf.arg(metavar="DIAGONALS")] = 1.0
    """Longest way round a hole that is closed, in diagonals of the mesh's box."""
    budget: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Seconds in which a fit below the stated quality begins anew, twice as wide each time; the best is kept."""
    checkpoint: Path | None = None
    """A file to keep the state of the training in; if it is there already, the training goes on from it."""
    seed: int = 0
    """Of the samples and the first weights."""
    quiet: bool = False
    """Print nothing but errors."""


def fit(command: Fit) -> int:
    """Check the mesh and the output, fit, and save."""
    require_seed(command.seed)
    require_new_safetensors("A field", command.output)
    if command.mesh.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"A mesh is a file ending in {', '.join(MESH_SUFFIXES)}, but got {command.mesh}.")
    if min(command.width, command.depth, command.steps) < 1:
        raise InputError(
            f"--width, --depth and --steps must be at least 1, but are {command.width}, {command.depth} and "
            f"{command.steps}."
        )
    if command.checkpoint is not None:
        require_folder_for(command.checkpoint)
        command.checkpoint.parent.mkdir(parents=True, exist_ok=True)
    say = speaker(command.quiet)
    mending = Mending(command.bodies, command.hole_limit)
    require_hole_limit(command.hole_limit)
    say_mending(
        say, [str(command.mesh)], lambda name, tell: check_shape(name, None, mending, progress=tell), command.quiet
    )

    import implicit
    import meshref
    from compare.files import replace_file
    from compare.fitting.fit import fit_mesh

    module = None if command.module is None else _module(command.module)
    V, F = meshref.read_mesh(command.mesh)  # as it is, so that the report says what was mended; it is not done again
    with progress_bars(command.quiet) as bars:
        tell = teller(bars, add_task(bars, command.mesh.name, None))
        try:
            field, quality = fit_mesh(
                V,
                F,
                module=module,
                width=command.width,
                depth=command.depth,
                activation=command.activation,
                steps=command.steps,
                seed=command.seed,
                bodies=command.bodies,
                hole_limit=command.hole_limit,
                budget=command.budget,
                checkpoint=command.checkpoint,
                progress=lambda step, steps, _: tell(step, steps, f"{command.mesh.name}, fitting a field"),
            )
        except (ValueError, TypeError) as error:  # a checkpoint of another fit, say
            raise InputError(str(error)) from error
    implicit.save_field(field, command.output, builder=command.module)
    replace_file(command.output.with_suffix(".json"), dumps(quality.to_dict(), indent=2).encode())
    say(f"{command.output}: {quality.parameters} parameters, {quality.seconds:.0f} s. {quality.verdict}")
    return 0


def _module(name: str) -> nn.Module:
    """Return the user's module, of which it is known that a field of it can be trained and saved."""
    from implicit.fitting.subjects import starting_field
    from implicit.models.field_file import encode_field
    from implicit.models.named_code import build_module, named_function

    try:
        module = build_module(named_function(name), {})
        encode_field(starting_field(module, None, dimension=3), builder=name)
    except (ValueError, TypeError) as error:
        raise InputError(f"--module {name}: {error}") from error
    return module
