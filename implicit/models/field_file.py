"""Fields as files: safetensors, with the architecture's name and arguments as text."""

from __future__ import annotations

import json
from os import PathLike, fspath
from typing import Any

import torch

from implicit.field.decoder import decoder_field
from implicit.field.field import Field, Units, require_field

FORMAT = "implicit-field-1"


def save_field(field: Field, path: str | PathLike[str]) -> None:
    """Write the field as safetensors: its weights (and code), and its architecture's name and arguments as text.

    Any architecture made by `implicit.models.build` can be saved: it states itself in `describe()`.

    Raises:
        TypeError: The field's module does not say how it was made.
    """
    from safetensors.torch import save

    from implicit.files import as_path, replace_file

    path = as_path(path)
    module = require_field(field).module
    describe = getattr(module, "describe", None)
    if module is None or not callable(describe):
        raise TypeError(
            "save_field needs a module that describes itself (Siren, an analytic shape, or a class registered with "
            f"implicit.models.register), but the field holds a {type(module).__name__}. Save its state_dict yourself."
        )
    state = {name: tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}
    # A decoder's field holds its code beside the weights.
    for block in field.layout:
        state[block.name] = field.theta[block.where].view(block.shape).cpu().contiguous()
    header = {
        "format": FORMAT,
        "architecture": describe(),
        "parameters": [block.name for block in field.layout],
        "level": field.level,
        "inside": field.inside,
        "bounds": field.bounds.tolist(),
        "units": [field.units.scale, list(field.units.offset)],
    }
    if field.takes_code:
        header["latent"] = field.layout[0].name
    # One entry: safetensors writes several in any order, and the same field should give the same bytes.
    metadata = {"field": json.dumps(header)}
    replace_file(path, save({name: tensor.clone() for name, tensor in state.items()}, metadata=metadata))


def load_field(path: str | PathLike[str], *, device: torch.device | str = "cpu") -> Field:
    """Read a field that `save_field` wrote. Nothing in the file is executed.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is cut short, is no field, or its weights do not fit its architecture.
    """
    from safetensors import SafetensorError, safe_open

    from implicit.files import as_path
    from implicit.models.registry import build

    path = as_path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"There is no field file {fspath(path)}. Make one with save_field or fit it from a mesh."
        )
    try:
        with safe_open(fspath(path), framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  a safe_open is no dict
    except SafetensorError as error:
        raise ValueError(
            f"{fspath(path)} is not a whole safetensors file ({error}). It may have been cut short: write it again."
        ) from error
    try:
        header = json.loads(metadata.get("field", "{}"))
        found = header.get("format")
    except (ValueError, AttributeError):
        found = None
    if found != FORMAT:
        raise ValueError(
            f"{fspath(path)} holds no field: its format is {found!r}, wanted {FORMAT!r}. A field is written by "
            "save_field; the weights of another program belong in its own module, given to Field."
        )
    try:
        module = build(header["architecture"])
        scale, offset = header["units"]
        dtypes = {tensor.dtype for tensor in state.values() if tensor.is_floating_point()}
        module = module.to(device=device, dtype=dtypes.pop() if len(dtypes) == 1 else None)
        code = state.pop(header["latent"]) if "latent" in header else None
        module.load_state_dict(state)
        place: dict[str, Any] = {
            "level": float(header["level"]),
            "inside": header["inside"],
            "bounds": header["bounds"],
            "units": Units(scale, tuple(offset)),
        }
        if code is not None:
            return decoder_field(module, code.to(device), **place)
        return Field(module, parameters=header["parameters"], **place)
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"{fspath(path)} does not fit the architecture that it names: {error}. Write it again with save_field."
        ) from error
