"""A trained generative model of a family, in one file: decoder, codes, exact parameters of the training shapes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field as default
from os import PathLike, fspath
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import counted, kind_of
from implicit.families.airplanes import AIRPLANES
from implicit.families.chairs import CHAIRS
from implicit.families.family import Family
from implicit.families.lamps import LAMPS
from implicit.field.decoder import decoder_field
from implicit.field.field import Field, Units
from implicit.files import replace_file
from implicit.models.checkpoints import Decoder, load_checkpoint, read_tensors
from implicit.models.imnet import ImNetEncoder
from implicit.models.layouts import MisfitError, fill

FAMILIES = {family.name: family for family in (CHAIRS, AIRPLANES, LAMPS)}
FORMAT = "implicit-family-1"


@dataclass(frozen=True, eq=False)
class FamilyModel:
    """A trained generative model of a family.

    Attributes:
        family: The family of the shapes.
        decoder: Code and point to value, by its published architecture.
        latents: A code for each training shape.
        parameters: The exact parameters of each training shape.
        encoder: Voxels to codes; None for an auto-decoder.
        report: The command that made it, its training and its reconstruction scores.
    """

    family: Family
    decoder: Decoder
    latents: Float[Tensor, "s l"]
    parameters: Float[Tensor, "s p"]
    encoder: ImNetEncoder | None = None
    report: dict[str, Any] = default(default_factory=dict)

    def __repr__(self) -> str:
        codes, numbers = self.latents.shape
        score = self.report.get("validation", {}).get("mean_iou")
        return (
            f"FamilyModel: {self.family.name} by {type(self.decoder).__name__}, {counted(codes, 'code')} of "
            f"{counted(numbers, 'number')} ({kind_of(self.latents)})"
            + ("" if score is None else f", mean IoU {score:.3g} on shapes it has not seen")
        )

    @property
    def scale(self) -> float:
        """The decoder's coordinates over the family's: 1/2 for IM-NET, whose cube is [-0.5, 0.5]^3, else 1."""
        return float(self.decoder.bounds[1][0])

    def field(self, code: Float[Tensor, " l"]) -> Field:
        """Return the shape of a code (L,) as a field, its units those of the family."""
        return decoder_field(self.decoder, code, units=Units(1 / self.scale))

    def nearest(self, parameters: Float[Tensor, " p"]) -> int:
        """Return the index of the training shape whose parameters, each relative to its range, are nearest."""
        lower, upper = self.parameters.new_tensor(list(self.family.ranges.values())).T
        return int(((self.parameters - parameters.to(lower)) / (upper - lower)).square().sum(dim=1).argmin())


def save_model(model: FamilyModel, path: str | PathLike[str], *, dtype: torch.dtype = torch.float32) -> None:
    """Write a model as safetensors; its decoder and codes can be read by `load_checkpoint` too.

    Args:
        model: The model.
        path: The file; one that is there is replaced.
        dtype: Precision of the weights and codes in the file. float16 halves it, and moves surfaces by some 1e-4.
    """
    from safetensors.torch import save

    state = {name: value.to(dtype) for name, value in model.decoder.state_dict().items()}
    if model.encoder is not None:
        state |= {f"encoder.{name}": value.to(dtype) for name, value in model.encoder.state_dict().items()}
    state |= {"latents": model.latents.to(dtype), "parameters": model.parameters.float()}
    encoder = None if model.encoder is None else model.encoder.describe()["arguments"]
    header = {
        "format": FORMAT,
        "family": model.family.name,
        "architecture": model.decoder.describe()["name"],
        "encoder": encoder,
        "report": model.report,
    }
    content = {name: value.detach().cpu().contiguous().clone() for name, value in state.items()}
    replace_file(path, save(content, metadata={"family": json.dumps(header)}))


def load_model(path: str | PathLike[str]) -> FamilyModel:
    """Read what `save_model` wrote, in float32. Nothing in the file is executed.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is cut short, or holds something else.
    """
    from safetensors import safe_open

    state = read_tensors(path)  # refuses what is not whole
    with safe_open(fspath(path), framework="pt") as file:
        text = (file.metadata() or {}).get("family", "{}")
    header = json.loads(text)
    if header.get("format") != FORMAT or header["family"] not in FAMILIES or "parameters" not in state:
        raise ValueError(
            f"{path} holds no model of a family: its format is {header.get('format')!r}, wanted {FORMAT!r}. Models are "
            "written by save_model; for weights from elsewhere use load_checkpoint."
        )
    decoder, latents = load_checkpoint(path, header["architecture"])
    encoder = None
    if header["encoder"] is not None:
        encoder = ImNetEncoder(**header["encoder"])
        own = {k.removeprefix("encoder."): v for k, v in state.items() if k.startswith("encoder.")}
        try:
            fill(encoder, own)
        except MisfitError as error:
            raise ValueError(f"{path} does not fit the encoder that it names: {error}. Write it again.") from error
        encoder.eval().requires_grad_(False)
    return FamilyModel(
        FAMILIES[header["family"]], decoder, latents, state["parameters"].double(), encoder, header["report"]
    )
