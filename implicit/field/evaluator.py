"""f(x; theta) as a function of both arguments, which a field evaluates and differentiates, and where theta is from."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.func import functional_call


@dataclass(frozen=True, eq=False)
class Parameter:
    """One edited tensor of a module: its name, its shape and its place in theta."""

    name: str
    shape: torch.Size
    where: slice


class Evaluator(Protocol):
    """The raw values of a function, before level and sign; usable under torch.func transforms."""

    @property
    def module(self) -> nn.Module | None:
        """The module that is evaluated, frozen; None for a function that is no module."""

    @property
    def takes_code(self) -> bool:
        """True where theta is the latent code of a decoder."""

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        """Return values (N,) or (N, 1) at points (N, D)."""

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> Evaluator:
        """Return the same function in another precision or on another device."""


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """A function with the parameters that it starts from, and the memory that they came from.

    Attributes:
        evaluator: The raw values of the function.
        theta: All edited parameters, one after the other, (P,).
        layout: The blocks of theta, in its order.
        store: Writes a theta to where the parameters came from, in place.
    """

    evaluator: Evaluator
    theta: Tensor
    layout: tuple[Parameter, ...]
    store: Callable[[Tensor], None]


def parametrised(module: nn.Module, patterns: Iterable[str] | None = None) -> Parametrisation:
    """Return a module's function of those of its parameters that fit the patterns, or of all.

    Args:
        module: From points (N, D) to values (N,) or (N, 1). A frozen copy of it is evaluated.
        patterns: Names or shell-style patterns of the parameters; None takes all.

    Raises:
        TypeError: It is no module, or the patterns are no names.
        ValueError: No parameter fits, or they differ in dtype or device.
    """
    if not isinstance(module, nn.Module):
        raise TypeError(
            f"module must be a torch module, but is a {type(module).__name__}. Wrap a function in one, or give "
            "decoder_field a function of points and a code."
        )
    blocks = _selected(module, patterns)
    layout = _layout({name: block.shape for name, block in blocks.items()})

    def store(theta: Tensor) -> None:
        with torch.no_grad():
            for block in layout:
                blocks[block.name].copy_(theta[block.where].view(block.shape))

    theta = torch.cat([block.detach().reshape(-1) for block in blocks.values()])
    return Parametrisation(OfModule(frozen_copy(module), layout), theta, layout, store)


def parametrised_by_code(decoder: Callable[[Tensor, Tensor], Tensor], latent: Tensor) -> Parametrisation:
    """Return a decoder's function of its latent code, (L,).

    Args:
        decoder: From points (N, D) and a code (L,) to values (N,) or (N, 1); of a module a frozen copy is evaluated.
        latent: The code to start from; edited ones are stored in it.
    """

    def store(theta: Tensor) -> None:
        with torch.no_grad():
            latent.copy_(theta)

    evaluator = OfDecoder(frozen_copy(decoder) if isinstance(decoder, nn.Module) else decoder)
    return Parametrisation(evaluator, latent.detach(), _layout({"latent": latent.shape}), store)


class OfModule:
    """A module, of which theta holds some parameters or all."""

    takes_code = False

    def __init__(self, module: nn.Module, layout: tuple[Parameter, ...]) -> None:
        self.module = module
        self._layout = layout

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        edited = {block.name: theta[block.where].view(block.shape) for block in self._layout}
        return functional_call(self.module, edited, (points,))

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> OfModule:
        return OfModule(copy.deepcopy(self.module).to(dtype=dtype, device=device), self._layout)


class OfDecoder:
    """A decoder, of which theta is the latent code; a module, or any function of points and a code."""

    takes_code = True

    def __init__(self, decoder: Callable[[Tensor, Tensor], Tensor]) -> None:
        self.module = decoder if isinstance(decoder, nn.Module) else None
        self._decoder = decoder

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        return self._decoder(points, theta)

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> OfDecoder:
        return self if self.module is None else OfDecoder(copy.deepcopy(self.module).to(dtype=dtype, device=device))


def frozen_copy(module: nn.Module) -> nn.Module:
    """Return a copy in evaluation mode without gradients, detached from the caller's module."""
    # The older weight norm keeps its product, a tensor with a history, as a plain attribute: deepcopy refuses those.
    derived = {
        id(value): value.detach().clone()
        for part in module.modules()
        for value in part.__dict__.values()
        if isinstance(value, Tensor) and not value.is_leaf
    }
    return copy.deepcopy(module, derived).eval().requires_grad_(False)


def _selected(module: nn.Module, patterns: Iterable[str] | None) -> dict[str, nn.Parameter]:
    """Return the parameters to edit, by name, all of one floating dtype on one device."""
    named = dict(module.named_parameters())
    if patterns is not None:
        if not isinstance(patterns, Iterable):
            raise TypeError(f"parameters must be names or patterns of names, but are {patterns!r}.")
        patterns = [patterns] if isinstance(patterns, str) else [str(pattern) for pattern in patterns]
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) for name in named):
                raise ValueError(
                    f"parameters must be names or patterns of the module's own, but {pattern!r} matches none of "
                    f"{', '.join(named) or 'none'}."
                )
        named = {name: p for name, p in named.items() if any(fnmatchcase(name, pattern) for pattern in patterns)}
    if not named:
        raise ValueError("The module must have parameters to edit, but has none. For a latent code use decoder_field.")
    kinds = {(p.dtype, p.device) for p in named.values()}
    if len(kinds) > 1 or not next(iter(kinds))[0].is_floating_point:
        raise ValueError(
            f"The parameters must share one floating dtype and device, but have {sorted(map(str, kinds))}."
        )
    if next(iter(kinds))[1].type == "meta":
        raise ValueError(
            "The parameters must hold numbers, but are on the meta device. Load the module to the CPU or a GPU."
        )
    return named


def _layout(shapes: dict[str, torch.Size]) -> tuple[Parameter, ...]:
    blocks, start = [], 0
    for name, shape in shapes.items():
        blocks.append(Parameter(name, shape, slice(start, start + shape.numel())))
        start += shape.numel()
    return tuple(blocks)
