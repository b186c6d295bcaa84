"""implicit-vs-mesh train-family: a generative model of parametric shapes, for semantic edits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from compare.commands.checks import require_folder_for, require_new_safetensors, require_seed
from compare.commands.shown import add_task, progress_bars, teller
from compare.errors import InputError


@dataclass
class TrainFamily:
    """Train a generative model on a family of parametric shapes, for semantic edits."""

    architecture: tyro.conf.Positional[Literal["deepsdf", "dualsdf", "imnet"]]
    """The decoder; imnet is trained with its encoder."""
    family: tyro.conf.Positional[Literal["chairs", "airplanes", "lamps"]]
    """What to learn."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Where the model goes: a file ending in .safetensors that is not there yet. Its scores go beside it, as .json."""
    shapes: int = 400
    """Shapes to learn."""
    latent: int = 16
    """Numbers in a code."""
    width: int = 128
    """Units in the hidden layers."""
    steps: int = 2500
    """Of the training."""
    batch: int = 9600
    """Points a step."""
    validation: int = 40
    """Further shapes, whose reconstruction is scored."""
    seed: int = 0
    """Of every random choice."""
    device: str = "cpu"
    """Where to train: cpu, cuda."""
    checkpoint: Path | None = None
    """A file to keep the state of the training in; if it is there already, the training goes on from it."""
    half: bool = False
    """Write float16, half the size; the scores are those of what is written."""
    quiet: bool = False
    """Print nothing but errors."""


def train_family(command: TrainFamily) -> int:
    """Check the output, train, save, and score what was saved."""
    require_seed(command.seed)
    require_new_safetensors("A model", command.output)
    numbers = ("shapes", "latent", "width", "steps", "batch", "validation")
    if small := [f"--{name}" for name in numbers if getattr(command, name) < 1]:
        raise InputError(f"{' and '.join(small)} must be at least 1.")
    if command.checkpoint is not None:
        require_folder_for(command.checkpoint)
        command.checkpoint.parent.mkdir(parents=True, exist_ok=True)

    import torch

    from compare.fitting.train_family import train_and_save

    try:
        torch.device(command.device)
    except RuntimeError as error:
        raise InputError(f"--device must be one of torch, such as cpu or cuda, but is {command.device!r}.") from error
    if command.device.startswith("cuda") and not torch.cuda.is_available():
        raise InputError(
            f"--device {command.device}: torch finds no CUDA device here. Leave it out to train on the CPU."
        )
    with progress_bars(command.quiet) as bars:
        name = f"{command.architecture}, {command.family}"
        tell = teller(bars, add_task(bars, name, None))
        try:
            report = train_and_save(
                command.family,
                command.architecture,
                command.output,
                dtype=torch.float16 if command.half else torch.float32,
                progress=lambda step, steps, loss: tell(step, steps, f"{name}, loss {loss:.2g}"),
                checkpoint=command.checkpoint,
                device=command.device,
                seed=command.seed,
                **{name: getattr(command, name) for name in numbers},
            )
        except (ValueError, RuntimeError, FloatingPointError) as error:
            raise InputError(str(error)) from error
    if not command.quiet:
        scores = report["validation"]
        print(
            f"{command.output}: IoU {scores['mean_iou']:.3f}, least {scores['least_iou']:.3f}, of {scores['shapes']} "
            f"shapes not learned; {report['seconds']} s."
        )
    return 0
