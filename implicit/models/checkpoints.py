"""Read published checkpoints as they are: decoders with their codes, and networks of single shapes as fields.

The networks' sizes are read off the shapes of the tensors (implicit.models.layouts); then every tensor must be there
and fit. Weights from elsewhere are not trusted: only tensors are read, by safetensors or by torch's loader for weights
alone, and nothing in a file is executed.
"""

from __future__ import annotations

import pickle
import warnings
import zipfile
from collections.abc import Mapping
from os import PathLike
from typing import Any, Literal, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_choice, require_positive
from implicit.field.field import CUBE, Bounds, Field, Units
from implicit.files import as_path
from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet
from implicit.models.layouts import DECODERS, LAYOUTS, NETWORKS, MisfitError, dictionaries, fitting

Architecture = Literal["imnet", "dualsdf", "deepsdf"]
Network = Literal["siren", "sine_layers", "i3d", "igr", "neus", "volsdf"]
Decoder = ImNet | DualSdf | DeepSdf

_CODES = ("latents", "latent_embeddings.weight_mu", "latent_codes.weight", "latent_codes")


def load_checkpoint(
    path: str | PathLike[str],
    architecture: Architecture | Literal["auto"],
    *,
    codes: str | PathLike[str] | None = None,
    dtype: torch.dtype = torch.float32,
) -> tuple[Decoder, Float[Tensor, "s l"]]:
    """Return a decoder and the codes of its training shapes, out of a file.

    Args:
        path: A .safetensors, or what torch.save wrote.
        architecture: Name of the architecture whose layout the file has; "auto" takes the one that it fits.
        codes: Another file that holds the codes, as DeepSDF writes them; None takes those in the same file.
        dtype: Precision of what is returned.

    Returns:
        The decoder in evaluation mode, ready for `decoder_field(decoder, codes[k])`, and the codes, with no rows where
        the file holds none.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is cut short, holds anything but tensors, or a tensor is missing, has another shape than
            the layout says, is not finite, or belongs to no layer: the first one is named. Or "auto" fits no layout of
            a decoder, or several.
    """
    _require_one_of("architecture", architecture, tuple(DECODERS), tuple(NETWORKS), "load_network")
    content = read_tensors(path)
    chosen = _chosen(path, content, architecture, tuple(DECODERS), "load_network")
    decoder = cast(Decoder, _module(path, content, chosen, dtype))
    latents = _codes_of(content if codes is None else read_tensors(codes), path if codes is None else codes)
    if latents is None:
        latents = torch.zeros(0, decoder.latent)
    if latents.ndim != 2 or latents.shape[1] != decoder.latent:
        raise ValueError(
            f"{codes or path}: the codes have shape {tuple(latents.shape)}, but the decoder in {path} takes codes of "
            f"{decoder.latent} numbers. Give the codes of the same training."
        )
    return decoder.eval().requires_grad_(False), latents.to(dtype)


def load_network(
    path: str | PathLike[str],
    architecture: Network | Literal["auto"] = "auto",
    *,
    first_frequency: float | None = None,
    frequency: float | None = None,
    scale: float | None = None,
    sharpness: float | None = None,
    level: float = 0.0,
    inside: Literal["negative", "positive"] = "negative",
    bounds: Bounds = CUBE,
    units: Units | None = None,
    dtype: torch.dtype = torch.float32,
) -> Field:
    """Return a field of a published network of one shape, out of a file.

    "siren" is vsitzmann's SingleBVPNet, "sine_layers" the Siren of the same authors' notebook, "i3d" the SIREN of i3d,
    "igr" the network of IGR, "neus" and "volsdf" the networks of signed distances in the checkpoints of NeuS and
    VolSDF, whose renderers are left out; so is VolSDF's sphere round the scene, which bounds its distances from above
    far from the object. `save_field` keeps any of them.

    Args:
        path: A .safetensors, or what torch.save wrote.
        architecture: Name of the architecture whose layout the file has; "auto" takes the one that it fits.
        first_frequency: Factor in the first sine of a SIREN (omega_0, w0), which no tensor tells; None is 30. Networks
            of the notebook have all kinds, so that a UserWarning says that 30 was taken.
        frequency: Factor in its later sines (i3d's ww); None is 30.
        scale: Factor of the points in IGR, NeuS and VolSDF, by which the value is divided; None is 1.
        sharpness: Of their softplus; None is 100.
        level, inside, bounds, units: As for Field.
        dtype: Precision of the field.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: As for load_checkpoint; or an option is one that the architecture has not.
    """
    _require_one_of("architecture", architecture, tuple(NETWORKS), tuple(DECODERS), "load_checkpoint")
    given = {"first_frequency": first_frequency, "frequency": frequency, "scale": scale, "sharpness": sharpness}
    options = {name: value for name, value in given.items() if value is not None}
    for name, value in options.items():
        require_positive(name, value)
    content = read_tensors(path)
    chosen = _chosen(path, content, architecture, tuple(NETWORKS), "load_checkpoint")
    foreign = [name for name in options if name not in LAYOUTS[chosen].options]
    if foreign:
        raise ValueError(
            f"{foreign[0]} is no option of {chosen}, which takes {', '.join(LAYOUTS[chosen].options)}. Leave it out."
        )
    module = _module(path, content, chosen, dtype, **options)
    if chosen == "sine_layers" and not {"first_frequency", "frequency"} <= set(options):
        warnings.warn(
            f"{path} does not tell the factors in its sines (first_omega_0, hidden_omega_0), and 30 was taken for what "
            "was not given. Where it was trained with others, name them: first_frequency=, frequency=.",
            stacklevel=2,
        )
    return Field(module, level=level, inside=inside, bounds=bounds, units=units)


def _require_one_of(name: str, value: Any, own: tuple[str, ...], others: tuple[str, ...], other: str) -> None:
    if isinstance(value, str) and value in others:
        kind = "takes no code" if other == "load_network" else "takes a code"
        raise ValueError(f"{value} is an architecture that {kind}. Load it by {other}(path, {value!r}).")
    require_choice(name, value, (*own, "auto"))


def _chosen(
    path: str | PathLike[str], content: Mapping[str, Any], architecture: str, own: tuple[str, ...], other: str
) -> str:
    """Return the architecture as named, or the only one that fits."""
    if architecture != "auto":
        return architecture
    fits = fitting(content)
    here = [name for name in fits if name in own]
    if len(here) == 1:
        return here[0]
    if here:
        raise ValueError(f"{path} fits the layouts of {' and '.join(here)}. Name the one that it was trained as.")
    if fits:
        raise ValueError(f"{path} fits the layout of {' and '.join(fits)}. Load it by {other}(path, {fits[0]!r}).")
    layouts = "; ".join(f"{name}: {layout.wanted}" for name, layout in LAYOUTS.items())
    names = [name for part in dictionaries(content) for name, value in part.items() if isinstance(value, Tensor)]
    raise ValueError(
        f"{path} fits no published layout that is known. It holds {', '.join(map(str, names[:4])) or 'no tensors'}"
        f"{', ...' if len(names) > 4 else ''}; known are {layouts}. Name an architecture to see what does not fit, or "
        "load it in its own program and give the module to Field."
    )


def _module(
    path: str | PathLike[str], content: Mapping[str, Any], architecture: str, dtype: torch.dtype, **options: float
) -> nn.Module:
    layout = LAYOUTS[architecture]
    try:
        return layout.module(content, dtype, **options)
    except MisfitError as error:
        raise ValueError(
            f"{path} does not fit the layout of {architecture}: {error}. Wanted is {layout.wanted}."
        ) from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


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


def _codes_of(content: Mapping[str, Any], path: str | PathLike[str]) -> Tensor | None:
    for part in dictionaries(content):
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


def _brief(error: Exception) -> str:
    return str(error).split("\n", 1)[0][:200]
