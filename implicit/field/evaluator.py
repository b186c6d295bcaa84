"""f(x; theta) as a function of both arguments: what a field evaluates and differentiates."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.func import functional_call


@dataclass(frozen=True, eq=False)
class Parameter:
    """Where one edited tensor of the module is in theta."""

    name: str
    shape: torch.Size
    where: slice


class Evaluator(Protocol):
    """The raw values of a function, before level and sign; usable under torch.func transforms."""

    @property
    def module(self) -> nn.Module | None:
        """What is evaluated, frozen; None for a function that is no module."""

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        """Values (N,) or (N, 1) at points (N, D)."""

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> Evaluator:
        """The same in another precision or on another device."""


class OfModule:
    """A module, of which theta holds some parameters or all."""

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

    def __init__(self, decoder: Callable[[Tensor, Tensor], Tensor]) -> None:
        self.module = decoder if isinstance(decoder, nn.Module) else None
        self._decoder = decoder

    def __call__(self, theta: Tensor, points: Tensor) -> Tensor:
        return self._decoder(points, theta)

    def to(self, dtype: torch.dtype | None, device: torch.device | str | None) -> OfDecoder:
        return self if self.module is None else OfDecoder(copy.deepcopy(self.module).to(dtype=dtype, device=device))


def frozen_copy(module: nn.Module) -> nn.Module:
    """A copy in evaluation mode without gradients, detached from the caller's module."""
    # The older weight norm keeps its product, a tensor with a history, as a plain attribute: deepcopy refuses those.
    derived = {
        id(value): value.detach().clone()
        for part in module.modules()
        for value in part.__dict__.values()
        if isinstance(value, Tensor) and not value.is_leaf
    }
    return copy.deepcopy(module, derived).eval().requires_grad_(False)
