"""Fields as files: safetensors, with what makes the module again as text.

A module is made again in one of two ways:

    architecture   one that `implicit.models.build` knows: its name and arguments, as its `describe()` states them
    builder        the user's own: the name of a function and its arguments, and the field's values at a few points

A builder's code is never run because a file names it: whoever loads the file names the code in the call. What is
written is read back first: a field whose file would be another shape is refused, not saved.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from implicit.field.decoder import decoder_field
from implicit.field.field import Field, Units, require_field
from implicit.field.frozen import Frozen
from implicit.files import as_path, replace_file
from implicit.models.named_code import FORMS, build_module, named_function, split_name
from implicit.models.registry import build, is_registered

FORMAT = "implicit-field-1"
FORMAT_OF_OTHERS = "implicit-field-2"  # with a builder, or with words on where a module takes and gives its values

PROBES = 64  # points at which a file is held against its field before it is written
KEPT_PROBES = 8  # of them in the file of a user's own module, to be held against the code that loads it

Maker = str | Callable[..., nn.Module] | nn.Module


def save_field(
    field: Field,
    path: str | PathLike[str],
    *,
    builder: str | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> None:
    """Write the field as safetensors: its weights as edited (and code), and what makes its module again as text.

    An architecture made by `implicit.models.build` says itself how it was made. Any other module needs the name of a
    function that builds it; load_field then wants that code named again. What is written is read back and compared
    with the field at random points first.

    Args:
        field: The field to keep.
        path: The file.
        builder: Name of a function that returns such a module, with weights of any values: "my_nets.py:make" or
            "package.module:function". It is called once, here, to compare. None takes what the module says of itself.
        arguments: Keyword arguments of the builder, which JSON can say; None is no arguments.

    Raises:
        TypeError: The field's module does not say how it was made and no builder is named, or what it says or the
            arguments are no plain data.
        ValueError: The builder cannot be run, its module does not take the field's tensors, or the field read back
            has other values: something that it is made of is not among its parameters and buffers.
        OSError: The file cannot be written.
    """
    path = as_path(path)
    replace_file(path, encode_field(field, builder=builder, arguments=arguments))


def encode_field(field: Field, *, builder: str | None = None, arguments: Mapping[str, Any] | None = None) -> bytes:
    """Return what `save_field` writes, with its arguments and errors."""
    from safetensors.torch import load, save

    recipe = _recipe(require_field(field), builder, arguments)
    state = _state(field)
    form = _form(field)
    header = {
        "format": FORMAT if builder is None and not form else FORMAT_OF_OTHERS,
        **recipe,
        **form,
        "parameters": [block.name for block in field.layout],
        "level": field.level,
        "inside": field.inside,
        "bounds": field.bounds.tolist(),
        "units": [field.units.scale, list(field.units.offset)],
    }
    if field.takes_code:
        header["latent"] = field.layout[0].name
    points = _probes(field)
    values = field.value(points)
    if builder is not None:
        kept = torch.isfinite(values).nonzero()[:KEPT_PROBES, 0]
        header["probes"] = {"points": points[kept].tolist(), "values": values[kept].tolist()}
    # One entry: safetensors writes several in any order, and the same field should give the same bytes.
    metadata = {"field": json.dumps(header)}
    content = save({name: tensor.clone() for name, tensor in state.items()}, metadata=metadata)
    make = None if builder is None else _function("builder", builder)
    try:
        again = _assembled(json.loads(metadata["field"]), load(content), make, field.device)
        read_back = again.value(points.to(again.theta))
    except (KeyError, TypeError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"The field could not be made again from what would be saved: {_said(error)} Nothing is written. "
            f"{_remedy(builder)}"
        ) from error
    off = _difference(values, read_back.to(values))
    if off is not None:
        raise ValueError(
            f"The field read back would have other values, off by up to {off:.3g} at random points: something that "
            f"makes its values is not among its parameters and buffers. Nothing is written. {_remedy(builder)}"
        )
    return content


def load_field(path: str | PathLike[str], *, module: Maker | None = None, device: torch.device | str = "cpu") -> Field:
    """Read a field that `save_field` wrote. Nothing in the file is executed.

    Args:
        path: The file.
        module: What makes the field's module, where the file was saved with the name of a builder: a function or its
            name, "my_nets.py:make" or "package.module:function", called with the arguments in the file; or a module,
            of which a copy takes the file's weights. None makes those that `implicit.models.build` knows, and refuses
            others: code is run only when it is named here.
        device: Where the field is to live.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is cut short, is no field, its weights do not fit its module, the module is the user's own
            and not named, or gives other values than the field had when it was saved.
        TypeError: The module is neither a name, a function nor a module.
    """
    header, state = _read(as_path(path))
    if module is None and "builder" in header:
        name = header["builder"].get("name") if isinstance(header["builder"], Mapping) else None
        raise ValueError(
            f"{fspath(path)} holds the weights of a module of the user's own, and says that {name} builds it. No code "
            "is run because a file names it: if you trust that code, name it yourself, load_field(path, "
            f"module={str(name)!r}) or --module {name} on the command line; or give a function or a module."
        )
    if module is not None and not isinstance(module, str) and not callable(module):
        raise TypeError(f"module must be {FORMS}, a function or a torch module, but is {module!r}.")
    make = _function("module", module) if isinstance(module, str) else module
    try:
        field = _assembled(header, state, make, device)
        off = _off_probes(field, header)
    except (KeyError, TypeError, RuntimeError, ValueError, AttributeError) as error:
        what, remedy = "the architecture that it names", "Write it again with save_field."
        if module is not None:
            what, remedy = f"the module of {_name_of(module)}", "Name what built the module that was saved."
        raise ValueError(f"{fspath(path)} does not fit {what}: {_said(error)} {remedy}") from error
    if off is not None:
        raise ValueError(
            f"{fspath(path)}: the module of {_name_of(module)} gives other values than the field had when it was "
            f"saved, off by up to {off:.3g} at {KEPT_PROBES} points. Its code or arguments have changed since: "
            "name those that built it then."
        )
    return field


def builder_of(path: str | PathLike[str]) -> tuple[str, dict[str, Any]] | None:
    """Return the name and the arguments of what builds the module in a field's file, or None if it needs no code.

    Nothing is imported, and only the header is read.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is cut short, or is no field.
    """
    header, _ = _read(as_path(path), tensors=False)
    if "builder" not in header:
        return None
    try:
        return str(header["builder"]["name"]), dict(header["builder"]["arguments"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{fspath(path)} does not say what builds its module. Write it again.") from error


# What is written


def _recipe(field: Field, builder: str | None, arguments: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the part of the header that says how the module is made again."""
    module = field.module
    if module is None:
        raise TypeError(
            "save_field needs a module, but the field's decoder is a function, which holds its weights where they "
            "cannot be seen. Make it a torch module that describes itself or that a builder builds."
        )
    if builder is not None:
        _function("builder", builder, split_name)
        if arguments is not None and not isinstance(arguments, Mapping):
            raise TypeError(f"arguments must be a dictionary of keyword arguments, but are {arguments!r}.")
        given = {} if arguments is None else dict(arguments)
        return {"builder": {"name": builder, "arguments": _plain("arguments", given)}}
    if arguments is not None:
        raise TypeError(f"arguments are those of a builder: name it too, builder={FORMS}.")
    describe = getattr(module, "describe", None)
    kind = type(module).__name__
    if not callable(describe):
        raise TypeError(
            "save_field needs a module that describes itself (Siren, an analytic shape, or a class registered with "
            f"implicit.models.register), or the name of what builds it, but the field holds a {kind}. Write a function "
            "that returns such a module and name it: save_field(field, path, builder="
            '"my_nets.py:make", arguments={...}).'
        )
    description = describe()
    if not isinstance(description, Mapping) or not {"name", "arguments"} <= set(description):
        raise TypeError(
            f'describe() of a module must return {{"name": ..., "arguments": {{...}}}}, but that of {kind} returned '
            f"{description!r}."
        )
    if not is_registered(description["name"]):
        raise ValueError(
            f"{kind} describes itself as {description['name']!r}, but no architecture of that name is registered, so "
            f"no file of it could be loaded. Call implicit.models.register({description['name']!r}, {kind}) first, or "
            "name what builds it: builder=..."
        )
    return {"architecture": _plain(f"describe() of {kind}", description)}


def _form(field: Field) -> dict[str, Any]:
    """Return the part of the header that says how points go into the module and where its values come out."""
    form = getattr(field._evaluator, "form", None)
    said = {name: getattr(form, name, None) for name in ("inputs", "output")}
    for name, value in said.items():
        if callable(value):
            raise TypeError(
                f"A file cannot hold the function that the field has as {name}, for it would be code. Make it a part "
                "of the module's forward, or say it by a number or a name."
            )
    return {name: _plain(name, value) for name, value in said.items() if value is not None}


def _plain(what: str, value: Any) -> Any:
    """Return the value as JSON will give it back, or refuse it."""
    try:
        return json.loads(json.dumps(value, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise TypeError(
            f"{what} must be plain data that JSON can say (numbers, texts, lists, dictionaries), but are {value!r}: "
            f"{error}."
        ) from error


def _state(field: Field) -> dict[str, Tensor]:
    """Return the module's tensors with theta in them, under each of the names that a shared tensor has."""
    module = field.module
    assert module is not None
    held = module.state_dict(keep_vars=True)
    named = dict(module.named_parameters(remove_duplicate=False))
    # The field edits a tensor by its first name; the state has it under all, and the last one read wins.
    edited = {id(named[block.name]): block for block in field.layout if block.name in named}
    state: dict[str, Tensor] = {}
    for name, tensor in held.items():
        if not isinstance(tensor, Tensor):
            raise TypeError(
                f"The state of {type(module).__name__} must be tensors, but its {name} is a {type(tensor).__name__}. "
                "Keep it in the arguments of a builder."
            )
        block = edited.get(id(tensor))
        own = tensor if block is None else field.theta[block.where].view(block.shape)
        state[name] = own.detach().cpu().contiguous()
    if field.takes_code:  # which the field holds beside the weights
        state[field.layout[0].name] = field.theta.cpu().contiguous()
    return state


def _probes(field: Field) -> Tensor:
    lower, upper = field.bounds
    random = torch.rand(PROBES, field.dimension, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return lower + random.to(field.theta) * (upper - lower)


def _difference(wanted: Tensor, came: Tensor, precision: float | None = None) -> float | None:
    """Return the largest difference, None where it is rounding; what is not finite must be so in both."""
    finite = torch.isfinite(wanted)
    if not torch.equal(finite, torch.isfinite(came)):
        return float("inf")
    if not bool(finite.any()):
        return None
    off = float((wanted[finite] - came[finite]).abs().max())
    allowed = 100 * torch.finfo(wanted.dtype).eps if precision is None else precision
    return off if off > allowed * float(wanted[finite].abs().max()) else None


def _off_probes(field: Field, header: Mapping[str, Any]) -> float | None:
    """Return by how much a field's values differ from those kept in its file, None where only by rounding."""
    probes = header.get("probes")
    if not probes or not probes["points"]:
        return None
    points = torch.tensor(probes["points"], dtype=field.dtype, device=field.device)
    values = torch.tensor(probes["values"], dtype=field.dtype, device=field.device)
    # Another machine or device rounds otherwise, which deep sines magnify; and torch's weight norm on a graphics card
    # takes norms in single precision even where the field is in double.
    return _difference(values, field.value(points), max(1e-6, torch.finfo(field.dtype).eps ** 0.5))


def _remedy(builder: str | None) -> str:
    if builder is None:
        return "Let describe() state all that makes the module, and keep the rest in parameters and buffers."
    return f"Check that the builder {builder} and its arguments build that module, and keep all else in its state."


def _function(argument: str, name: str, look: Callable[[str], Any] = named_function) -> Any:
    """Return the function of a name, or refuse the argument that has it."""
    try:
        return look(name)
    except (ValueError, TypeError) as error:
        raise type(error)(f"{argument} cannot be used. {error}") from error


# What is read


def _of_another_program(path: Path) -> str | None:
    """Return what a file is that is no safetensors file, and what reads it, or None where that is not known."""
    with open(path, "rb") as file:
        start = file.read(8)
    in_its_program = "load it in its own program, give the module to Field, and save that with save_field."
    if path.suffix in (".npz", ".npy") or start.startswith(b"\x93NUMPY"):
        return f"what numpy.save writes. To make a field of it, {in_its_program}"
    if start[:1] == b"\x80" or zipfile.is_zipfile(path):
        return (
            'what torch.save writes. If it holds a published network, read it by load_network(path, "auto") or '
            f'load_checkpoint(path, "auto"); otherwise {in_its_program}'
        )
    if path.suffix not in (".safetensors", ""):
        return (
            f"by its name, {path.suffix}, of another format. Fit a field to a mesh by compare.fit_mesh; of a network "
            f"of another program, {in_its_program}"
        )
    return None


def _read(path: Path, *, tensors: bool = True) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return the header and the tensors of a field's file."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise FileNotFoundError(
            f"There is no field file {fspath(path)}. Make one with save_field or fit it from a mesh."
        )
    try:
        with safe_open(fspath(path), framework="pt") as file:
            metadata = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()} if tensors else {}  # noqa: SIM118  no dict
    except SafetensorError as error:
        other = _of_another_program(path)
        if other is not None:
            raise ValueError(f"{fspath(path)} is no field file but {other}") from error
        raise ValueError(
            f"{fspath(path)} is not a whole safetensors file ({error}). It may have been cut short: write it again."
        ) from error
    try:
        header = json.loads(metadata.get("field", "{}"))
        found = header.get("format")
    except (ValueError, AttributeError):
        header, found = {}, None
    if found not in (FORMAT, FORMAT_OF_OTHERS):
        raise ValueError(
            f"{fspath(path)} holds no field: its format is {found!r}, wanted {FORMAT!r}. A field is written by "
            'save_field; of a published network\'s weights load_network(path, "auto") makes one, and the weights of '
            "another program belong in its own module, given to Field."
        )
    return header, state


def _assembled(
    header: Mapping[str, Any],
    state: Mapping[str, Tensor],
    made_by: Callable[..., nn.Module] | nn.Module | None,
    device: torch.device | str,
) -> Field:
    """Return the field that a header and tensors say."""
    module = _made(header, made_by)
    scale, offset = header["units"]
    weights = dict(state)
    code = weights.pop(header["latent"]) if "latent" in header else None
    dtypes = {tensor.dtype for tensor in state.values() if tensor.is_floating_point()}
    module = module.to(device=device, dtype=dtypes.pop() if len(dtypes) == 1 else None)
    names = [] if code is not None else [str(name) for name in header["parameters"]]
    _fill(module, weights, names)
    place: dict[str, Any] = {
        "level": float(header["level"]),
        "inside": header["inside"],
        "bounds": header["bounds"],
        "units": Units(scale, tuple(offset)),
    }
    place |= {name: header[name] for name in ("inputs", "output") if name in header}
    if code is not None:
        return decoder_field(module, code.to(device), **place)
    return Field(module, parameters=names, **place)


def _made(header: Mapping[str, Any], made_by: Callable[..., nn.Module] | nn.Module | None) -> nn.Module:
    if isinstance(made_by, nn.Module):
        copied = Frozen(made_by).function
        assert isinstance(copied, nn.Module)
        return copied
    if made_by is None:
        return build(header["architecture"])
    return build_module(made_by, header["builder"]["arguments"] if "builder" in header else {})


@torch.no_grad()
def _fill(module: nn.Module, state: Mapping[str, Tensor], edited: list[str]) -> None:
    """Load the tensors after comparing each with what the module has there; the edited ones last."""
    own = module.state_dict(keep_vars=True)
    for name in own:
        if name not in state:
            raise ValueError(f"{name} is missing in the file, but the module has it.")
        if own[name].shape != state[name].shape:
            raise ValueError(
                f"{name} has shape {tuple(state[name].shape)} in the file and {tuple(own[name].shape)} in the module."
            )
        if own[name].dtype != state[name].dtype:  # a module of several precisions
            own[name].data = own[name].data.to(state[name].dtype)
    for name in state:
        if name not in own:
            raise ValueError(f"{name} is in the file, but the module has no such tensor.")
    module.load_state_dict(dict(state))
    # Files of before have the edited values of a shared tensor under the first of its names alone.
    for name in edited:
        own[name].data.copy_(state[name])


def _name_of(made_by: Maker | None) -> str:
    if isinstance(made_by, nn.Module):
        return type(made_by).__name__
    return made_by if isinstance(made_by, str) else getattr(made_by, "__qualname__", repr(made_by))


def _said(error: Exception) -> str:
    """Return what an error says as a sentence."""
    text = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) and error.args else str(error)
    return text if text.endswith(".") else text + "."
