"""Read published checkpoints of generative models as they are: IM-NET, DualSDF, DeepSDF.

The networks' sizes are read off the shapes of the tensors; then every tensor must be there and fit. Weights from
elsewhere are not trusted: only tensors are read, by safetensors or by torch's loader for weights alone, and nothing in
a file is executed.

| architecture | tensors | codes |
|---|---|---|
| imnet | linear_1 ... linear_7, in an auto-encoder after "generator." | made by its encoder |
| dualsdf | deepsdf_net., prim_attr_net., in "trainer_state_dict" | latent_embeddings.weight_mu |
| deepsdf | lin0 ... lin8, after "module." in "model_state_dict" | a file of their own, "latent_codes" |
"""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from os import PathLike
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_choice
from implicit.files import as_path
from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet

Architecture = Literal["imnet", "dualsdf", "deepsdf"]
Decoder = ImNet | DualSdf | DeepSdf
State = Mapping[str, Tensor]

# A tensor that each layout begins with, by which its place in a file is found.
_FIRST = {"imnet": "linear_1.bias", "dualsdf": "deepsdf_net.net1.0.bias", "deepsdf": "lin0.bias"}

_LAYOUTS = {
    "imnet": "linear_1 ... linear_7, weight and bias each",
    "dualsdf": "deepsdf_net and prim_attr_net, each with net1.k and net2.k under weight norm",
    "deepsdf": "lin0 ... linK, all but the last under weight norm",
}

# What may stand beside a decoder's tensors.
_BESIDE = ("latents", "latent_codes.", "latent_embeddings.", "parameters", "encoder.")
_CODES = ("latents", "latent_embeddings.weight_mu", "latent_codes.weight", "latent_codes")


def load_checkpoint(
    path: str | PathLike[str],
    architecture: Architecture,
    *,
    codes: str | PathLike[str] | None = None,
    dtype: torch.dtype = torch.float32,
) -> tuple[Decoder, Float[Tensor, "s l"]]:
    """Return a decoder and the codes of its training shapes, out of a file.

    Args:
        path: A .safetensors, or what torch.save wrote.
        architecture: Name of the architecture whose layout the file has.
        codes: Another file that holds the codes, as DeepSDF writes them; None takes those in the same file.
        dtype: Precision of what is returned.

    Returns:
        The decoder in evaluation mode, ready for `decoder_field(decoder, codes[k])`, and the codes, with no rows where
        the file holds none.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is cut short, holds anything but tensors, or a tensor is missing, has another shape than
            the layout says, is not finite, or belongs to no layer. The first one is named.
    """
    require_choice("architecture", architecture, tuple(_FIRST))
    content = read_tensors(path)
    state = _state_of(content, architecture, path)
    arguments: Callable[[State], Decoder] = _BUILDERS[architecture]
    try:
        decoder = arguments(state)
    except KeyError as error:
        raise ValueError(_misfit(path, architecture, f"{error.args[0]} is missing")) from error
    except (ValueError, IndexError) as error:
        raise ValueError(_misfit(path, architecture, str(error))) from error
    fill(decoder, state, path, _LAYOUTS[architecture])
    latents = _codes_of(content if codes is None else read_tensors(codes), path if codes is None else codes)
    if latents is None:
        latents = torch.zeros(0, decoder.latent)
    if latents.ndim != 2 or latents.shape[1] != decoder.latent:
        raise ValueError(
            f"{codes or path}: the codes have shape {tuple(latents.shape)}, but the decoder in {path} takes codes of "
            f"{decoder.latent} numbers. Give the codes of the same training."
        )
    return decoder.to(dtype).eval().requires_grad_(False), latents.to(dtype)


def read_tensors(path: str | PathLike[str]) -> dict[str, Any]:
    """Return all that is in a file, with nothing executed: tensors, dictionaries, and numbers and text about them.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It is cut short, or holds anything else.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    path = as_path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no checkpoint file {path}. Check the path.")
    try:
        if path.suffix == ".safetensors":
            return dict(load_file(path))
        content = torch.load(path, map_location="cpu", weights_only=True)
    except SafetensorError as error:
        raise ValueError(f"{path} is not a whole safetensors file ({error}). Fetch or write it again.") from error
    except pickle.UnpicklingError as error:
        if zipfile.is_zipfile(path) or "Unsupported" in str(error):
            raise ValueError(
                f"{path} holds more than tensors, and what else it holds is not executed. Where you trust its source, "
                "load it in its own program and save the state_dict alone."
            ) from error
        raise ValueError(f"{path} is cut short or no checkpoint of torch. Fetch it again.") from error
    except (RuntimeError, EOFError, OSError, ValueError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is cut short or no checkpoint of torch ({_brief(error)}). Fetch it again.") from error
    if not isinstance(content, Mapping):
        raise ValueError(f"{path} holds a {type(content).__name__}, but a checkpoint is a dictionary of tensors.")
    return dict(content)


def fill(module: nn.Module, state: State, path: str | PathLike[str], layout: str) -> None:
    """Load tensors into a module after comparing each with what the module has there."""
    expected = module.state_dict()
    for name, own in expected.items():
        if name not in state:
            raise ValueError(f"{path} does not fit its architecture: {name} is missing. Wanted is {layout}.")
        if state[name].shape != own.shape:
            raise ValueError(
                f"{path} does not fit its architecture: {name} has shape {tuple(state[name].shape)}, but the layers "
                f"before it want {tuple(own.shape)}. Wanted is {layout}."
            )
        if not bool(torch.isfinite(state[name]).all()):
            raise ValueError(f"{path}: {name} holds NaN or infinite numbers. Fetch or train it again.")
    for name in state:
        if name not in expected and not name.startswith(_BESIDE):
            raise ValueError(f"{path} does not fit its architecture: {name} belongs to no layer. Wanted is {layout}.")
    module.load_state_dict({name: state[name] for name in expected})


def _state_of(content: Mapping[str, Any], architecture: str, path: str | PathLike[str]) -> State:
    """Return the decoder's tensors by the names of its layout, wherever in the file and after whatever prefix."""
    first = _FIRST[architecture]
    for part in _dictionaries(content):
        for name in part:
            if isinstance(name, str) and (name == first or name.endswith("." + first)):
                prefix = name.removesuffix(first)
                return {
                    key.removeprefix(prefix): value
                    for key, value in part.items()
                    if isinstance(key, str) and key.startswith(prefix) and isinstance(value, Tensor)
                }
    raise ValueError(_misfit(path, architecture, f"{first} is missing"))


def _codes_of(content: Mapping[str, Any], path: str | PathLike[str]) -> Tensor | None:
    for part in _dictionaries(content):
        for name in _CODES:
            value = part.get(name)
            if isinstance(value, Tensor):
                if not bool(torch.isfinite(value).all()):
                    raise ValueError(f"{path}: {name} holds NaN or infinite numbers. Fetch or train it again.")
                # Early DeepSDF wrote (S, 1, L).
                return value.squeeze(1) if value.ndim == 3 else value
            if isinstance(value, Mapping) and isinstance(value.get("weight"), Tensor):
                return value["weight"]
    return None


def _dictionaries(content: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    yield content
    for value in content.values():
        if isinstance(value, Mapping):
            yield from _dictionaries(value)


# The sizes of each architecture, read off its tensors


def _imnet(state: State) -> ImNet:
    outputs, inputs = _matrix(state, "linear_1")
    return ImNet(inputs - 3, max(1, outputs // 8))


def _deepsdf(state: State) -> DeepSdf:
    width, inputs = _matrix(state, "lin0")
    depth = max(int(found[1]) for name in state if (found := re.match(r"lin(\d+)\.", name)))
    short = [k for k in range(depth - 1) if _matrix(state, f"lin{k}")[0] == width - inputs]
    if len(short) != 1:
        raise ValueError(
            f"one of lin0 ... lin{depth - 2} must put out {width - inputs} numbers, so that the input can be given "
            f"again after it, but {len(short)} do"
        )
    return DeepSdf(inputs - 3, width, depth, short[0] + 1, weight_norm="lin0.weight_v" in state)


def _dualsdf(state: State) -> DualSdf:
    width, inputs = _matrix(state, "deepsdf_net.net1.0")
    depths = [_places(state, f"deepsdf_net.{net}.") for net in ("net1", "net2")]
    if len(depths[1]) < 2:
        raise KeyError("deepsdf_net.net2.2.bias")
    last = _places(state, "prim_attr_net.net2.")
    if not last:
        raise KeyError("prim_attr_net.net2.0.bias")
    outputs, _ = _matrix(state, f"prim_attr_net.net2.{last[-1]}")
    return DualSdf(
        inputs - 3,
        width,
        (len(depths[0]), len(depths[1])),
        outputs // 4,
        # Linear, ReLU, Dropout triples stand for any dropout; 0.2 is the published one.
        dropout=0.2 if depths[1][1] == 3 else 0.0,
        weight_norm="deepsdf_net.net1.0.weight_v" in state,
    )


_BUILDERS: dict[str, Callable[[State], Decoder]] = {"imnet": _imnet, "dualsdf": _dualsdf, "deepsdf": _deepsdf}


def _matrix(state: State, layer: str) -> tuple[int, int]:
    """Return the number of units out of a layer and into it."""
    name = f"{layer}.weight" if f"{layer}.weight" in state else f"{layer}.weight_v"
    if state[name].ndim != 2:
        raise ValueError(f"{name} must be a matrix, but has shape {tuple(state[name].shape)}")
    return state[name].shape[0], state[name].shape[1]


def _places(state: State, prefix: str) -> list[int]:
    """Return the places in a Sequential at which linear layers stand."""
    return sorted(
        int(name.removeprefix(prefix).removesuffix(".bias"))
        for name in state
        if name.startswith(prefix) and name.endswith(".bias")
    )


def _misfit(path: str | PathLike[str], architecture: str, what: str) -> str:
    return f"{path} does not fit the layout of {architecture}: {what}. Wanted is {_LAYOUTS[architecture]}."


def _brief(error: Exception) -> str:
    return str(error).split("\n", 1)[0][:200]
