"""Layouts of published networks: by which tensors each is known, and how its sizes are read off their shapes.

| architecture | tensors | where |
|---|---|---|
| imnet | linear_1 ... linear_7 | in an auto-encoder after "generator." |
| dualsdf | deepsdf_net., prim_attr_net. | in "trainer_state_dict" |
| deepsdf | lin0 ... linK under weight norm but the last | after "module." in "model_state_dict" |
| siren | net.net.0.0 ... net.net.K.0 | the state of a SingleBVPNet |
| sine_layers | net.0.linear ... net.K | the state of the Siren of its authors' notebook, and of many after it |
| i3d | net.0.0 ... net.K.0 | the state of a SIREN |
| igr | lin0 ... linK | in "model_state_dict" |
| neus | lin0 ... linK, all under weight norm | in "sdf_network_fine" |
| volsdf | lin0 ... linK, all under weight norm | after "implicit_network." in "model_state_dict" |

The first three are decoders, which take a code; of the others `load_network` makes a field. Layers under torch's newer
weight norm are read as those under the older one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet
from implicit.models.sdf_network import SdfNetwork
from implicit.models.siren import Siren
from implicit.models.weight_norm import by_older_names

State = Mapping[str, Tensor]

# What may stand beside a decoder's tensors.
_BESIDE = ("latents", "latent_codes.", "latent_embeddings.", "parameters", "encoder.")


class MisfitError(ValueError):
    """The tensors are not of a layout; the message names the first that does not fit."""


@dataclass(frozen=True)
class Layout:
    """One published architecture.

    Attributes:
        first: Tensor that it begins with, by which its place in a file is found.
        wanted: Its tensors in words, for refusals.
        make: Returns a module of the sizes of some tensors; takes the options as keywords.
        options: Numbers that the tensors do not tell, with those of the publication.
        published: The name that one of the module's tensors has in a file.
        stands: Whether the tensors after this prefix, with the keys of the dictionaries round them, can be its own.
        unmistakable: Whether tensors that fit can be of no other architecture.
        renamed: Returns the tensors by the names that the rest of the layout has for them.
    """

    first: str
    wanted: str
    make: Callable[..., nn.Module]
    options: Mapping[str, float]
    published: Callable[[str], str] = lambda name: name
    stands: Callable[[str], bool] = lambda place: True
    unmistakable: Callable[[State], bool] = lambda state: True
    renamed: Callable[[State], State] = lambda state: state

    def find(self, content: Mapping[str, Any]) -> State:
        """Return its tensors by their published names, wherever in the file and after whatever prefix.

        Raises:
            MisfitError: They are not there.
        """
        for place, part in _dictionaries(content):
            own = {key: value for key, value in part.items() if isinstance(key, str) and isinstance(value, Tensor)}
            tensors = by_older_names(own)
            for name in tensors:
                prefix = name.removesuffix(self.first)
                begins = name == self.first or name.endswith("." + self.first)
                if begins and self.stands(place + prefix):
                    return self.renamed({k.removeprefix(prefix): tensors[k] for k in tensors if k.startswith(prefix)})
        raise MisfitError(f"{self.first} is missing")

    def module(self, content: Mapping[str, Any], dtype: torch.dtype, **options: float) -> nn.Module:
        """Return the module with the tensors in it, each compared with what the module has there.

        Raises:
            MisfitError: A tensor is missing, has another shape than the layout says, or belongs to no layer.
            ValueError: A tensor holds NaN or infinite numbers.
        """
        state = self.find(content)
        try:
            module = self.make(state, **{**self.options, **options})
        except KeyError as error:
            raise MisfitError(f"{error.args[0]} is missing") from error
        except (ValueError, IndexError) as error:
            raise MisfitError(str(error).rstrip(".")) from error
        fill(module.to(dtype), state, self.published)
        return module


def fill(module: nn.Module, state: State, published: Callable[[str], str] = lambda name: name) -> None:
    """Load tensors into a module after comparing each with what the module has there."""
    expected = module.state_dict()
    for own, tensor in expected.items():
        name = published(own)
        if name not in state:
            raise MisfitError(f"{name} is missing")
        if state[name].shape != tensor.shape:
            raise MisfitError(
                f"{name} has shape {tuple(state[name].shape)}, but the layers before it want {tuple(tensor.shape)}"
            )
        if not bool(torch.isfinite(state[name]).all()):
            raise ValueError(f"{name} holds NaN or infinite numbers. Fetch or train it again.")
    known = {published(own) for own in expected}
    for name in state:
        if name not in known and not name.startswith(_BESIDE):
            raise MisfitError(f"{name} belongs to no layer")
    module.load_state_dict({own: state[published(own)] for own in expected})


def fitting(content: Mapping[str, Any]) -> list[str]:
    """Return the names of the layouts that the tensors in a file fit and can be told by."""
    names = []
    for name, layout in LAYOUTS.items():
        try:
            layout.module(content, torch.float32)
            fits = layout.unmistakable(layout.find(content))
        except MisfitError:
            fits = False
        except ValueError:  # loading it will say what else is wrong
            fits = True
        if fits:
            names.append(name)
    return names


def _dictionaries(content: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each dictionary in a file, outermost first, with the keys on the way to it."""
    yield place, content
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _dictionaries(value, f"{place}{key}.")


def dictionaries(content: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield each dictionary in a file, outermost first."""
    for _, part in _dictionaries(content):
        yield part


# The sizes of each architecture, read off its tensors


def _imnet(state: State) -> ImNet:
    outputs, inputs = _matrix(state, "linear_1")
    return ImNet(inputs - 3, max(1, outputs // 8))


def _deepsdf(state: State) -> DeepSdf:
    width, inputs = _matrix(state, "lin0")
    depth = _last(state)
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


def _siren(prefix: str) -> Callable[..., Siren]:
    """Return what makes a Siren whose layer k is called prefix.k.0."""

    def make(state: State, first_frequency: float, frequency: float) -> Siren:
        width, inputs = _matrix(state, f"{prefix}.0.0")
        places = [int(found[1]) for name in state if (found := re.match(rf"{re.escape(prefix)}\.(\d+)\.0\.", name))]
        if max(places) == 0:
            raise KeyError(f"{prefix}.1.0.weight")
        return Siren(inputs, width, max(places), first_frequency=first_frequency, frequency=frequency)

    return make


def _of_siren(prefix: str) -> Callable[[str], str]:
    return lambda own: re.sub(r"^layers\.(\d+)\.", rf"{prefix}.\1.0.", own)


def _sine_layers(state: State, first_frequency: float, frequency: float) -> Siren:
    width, inputs = _matrix(state, "net.0.linear")
    places = [int(found[1]) for name in state if (found := re.match(r"net\.(\d+)\.", name))]
    last = max(places)
    if LAST_SINE in state:
        raise ValueError(f"its last layer, net.{last}, is a sine, but values on both sides of 0 want a linear one")
    if last == 0:
        raise KeyError("net.1.weight")
    return Siren(inputs, width, last, first_frequency=first_frequency, frequency=frequency)


def _with_linear(state: State) -> State:
    """Return the tensors with the last layer, which has no sine, called as those before; one with a sine is marked."""
    places = [int(found[1]) for name in state if (found := re.match(r"net\.(\d+)\.", name))]
    last = max(places, default=0)
    if f"net.{last}.linear.weight" in state and last > 0:
        return {**state, LAST_SINE: state[f"net.{last}.linear.weight"]}
    return {re.sub(rf"^net\.{last}\.(weight|bias)$", rf"net.{last}.linear.\1", name): state[name] for name in state}


def _igr(state: State, scale: float, sharpness: float) -> SdfNetwork:
    if "lin0.weight" not in state:
        raise KeyError("lin0.weight")
    inputs = _matrix(state, "lin0")[1]
    if inputs not in (2, 3):
        raise ValueError(f"lin0.weight takes {inputs} numbers, but points have 2 or 3: codes are not read here")
    return _sdf_network(state, inputs, 0, scale, sharpness)


def _neus(state: State, scale: float, sharpness: float) -> SdfNetwork:
    if "lin0.weight_g" not in state:
        raise KeyError("lin0.weight_g")
    inputs = _matrix(state, "lin0")[1]
    if inputs < 3 or (inputs - 3) % 6:
        raise ValueError(
            f"lin0.weight_v takes {inputs} numbers, but the encoding of a point by m octaves has 3 + 6 m of them"
        )
    return _sdf_network(state, 3, (inputs - 3) // 6, scale, sharpness)


def _sdf_network(state: State, dimension: int, octaves: int, scale: float, sharpness: float) -> SdfNetwork:
    depth, inputs = _last(state), dimension * (1 + 2 * octaves)
    if depth == 0:
        raise KeyError("lin1.bias")
    normed = "lin0.weight_g" in state
    missing = [name for k in range(depth) if (name := f"lin{k}.weight" + "_v" * normed) not in state]
    if missing:
        raise KeyError(missing[0])
    sizes = [_matrix(state, f"lin{k}") for k in range(depth + 1)]
    skips = [k for k in range(1, depth + 1) if sizes[k][1] == sizes[k - 1][0] + inputs]
    return SdfNetwork(
        dimension, sizes[1][1], depth, skips, octaves=octaves, outputs=sizes[-1][0],
        weight_norm=normed, sharpness=sharpness, scale=scale,
    )  # fmt: skip


def _last(state: State) -> int:
    """Return the largest K of the layers lin0 ... linK."""
    return max(int(found[1]) for name in state if (found := re.match(r"lin(\d+)\.", name)))


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


def _renders(place: str) -> bool:
    return re.search(r"(color|rendering|implicit|bg)_network|nerf", place) is not None


LAST_SINE = "the last layer's sine"  # a mark among tensors
_FREQUENCIES = {"first_frequency": 30.0, "frequency": 30.0}
_SCALE = {"scale": 1.0, "sharpness": 100.0}

DECODERS: dict[str, Layout] = {
    "imnet": Layout("linear_1.bias", "linear_1 ... linear_7, weight and bias each", _imnet, {}),
    "dualsdf": Layout(
        "deepsdf_net.net1.0.bias",
        "deepsdf_net and prim_attr_net, each with net1.k and net2.k under weight norm",
        _dualsdf,
        {},
    ),
    "deepsdf": Layout(
        "lin0.bias",
        "lin0 ... linK, all but the last under weight norm",
        _deepsdf,
        {},
        # IGR's networks with a code have the same tensors, but other activations.
        unmistakable=lambda state: "lin0.weight_v" in state,
    ),
}

NETWORKS: dict[str, Layout] = {
    "siren": Layout(
        "net.net.0.0.bias",
        "net.net.0.0 ... net.net.K.0, weight and bias each, of one width",
        _siren("net.net"),
        _FREQUENCIES,
        published=_of_siren("net.net"),
    ),
    "sine_layers": Layout(
        "net.0.linear.bias",
        "net.0.linear ... net.(K-1).linear and net.K, weight and bias each, of one width",
        _sine_layers,
        _FREQUENCIES,
        published=lambda own: re.sub(r"^layers\.(\d+)\.", r"net.\1.linear.", own),
        renamed=_with_linear,
    ),
    "i3d": Layout(
        "net.0.0.bias",
        "net.0.0 ... net.K.0, weight and bias each, of one width",
        _siren("net"),
        _FREQUENCIES,
        published=_of_siren("net"),
        stands=lambda place: not place.endswith("net."),
    ),
    "igr": Layout(
        "lin0.bias",
        "lin0 ... linK, weight and bias each, the input of 2 or 3 numbers given again to some",
        _igr,
        _SCALE,
        stands=lambda place: not _renders(place),
    ),
    "neus": Layout(
        "lin0.bias",
        "lin0 ... linK, all under weight norm, the encoded point given again to some",
        _neus,
        _SCALE,
        stands=lambda place: not _renders(place),
    ),
    "volsdf": Layout(
        "lin0.bias",
        "implicit_network.lin0 ... linK, all under weight norm, the encoded point given again to some",
        _neus,
        _SCALE,
        stands=lambda place: place.endswith("implicit_network."),
    ),
}

LAYOUTS = DECODERS | NETWORKS
