"""The part of a field that stands before it is examined: a function of theta and points, with derivatives."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from implicit.field.evaluator import OfDecoder, OfModule, Parameter


class Differentiable(Protocol):
    """A function f(x; theta) in a box, as the examination and the measures of smoothness see it; see Field."""

    theta: Tensor
    bounds: Tensor
    layout: tuple[Parameter, ...]
    level: float
    sign: float
    _evaluator: OfModule | OfDecoder

    @property
    def dimension(self) -> int:
        """D, 2 or 3."""

    @property
    def dtype(self) -> torch.dtype:
        """Precision of theta."""

    @property
    def size(self) -> float:
        """Length of the longest side of the bounds."""

    @property
    def takes_code(self) -> bool:
        """True if theta is the code of a decoder."""

    def function(self, theta: Tensor, points: Tensor) -> Tensor:
        """Return f(points; theta)."""

    def gradient(self, points: Tensor) -> Tensor:
        """Return df/dx."""

    def gradient_length(self, gradients: Tensor) -> Tensor:
        """Return |df/dx|, refused where it vanishes."""

    def value_and_gradient(self, points: Tensor, *, validate: bool = True) -> tuple[Tensor, Tensor]:
        """Return f and df/dx."""

    def raw_gradient_and_hessian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return df/dx and d2f/dx2 as torch gives them."""

    def require_points(self, points: Tensor, name: str = "points") -> Tensor:
        """Return the points, or refuse them."""

    def to(self, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> Differentiable:
        """Return the same in another precision."""
