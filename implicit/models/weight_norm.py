"""A linear layer under weight norm, W = g v / |v| a row, by the names of the published checkpoints.

They were written with torch's older weight norm, whose parameters are weight_g (out, 1) and weight_v (out, in).
Source: Salimans and Kingma, "Weight normalization", NeurIPS 2016.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn


class WeightNormLinear(nn.Module):
    """x W^T + b with W = weight_g weight_v / |weight_v|."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        # The start of nn.Linear, as weight norm gives it.
        start = nn.Linear(inputs, outputs)
        self.bias = nn.Parameter(start.bias.detach())
        self.weight_v = nn.Parameter(start.weight.detach())
        self.weight_g = nn.Parameter(start.weight.detach().norm(dim=1, keepdim=True))

    @property
    def weight(self) -> Tensor:
        """The weights W (out, in)."""
        return self.weight_v * (self.weight_g / self.weight_v.norm(dim=1, keepdim=True))

    def forward(self, x: Tensor) -> Tensor:
        """Return the outputs (..., out) of rows (..., in)."""
        return nn.functional.linear(x, self.weight, self.bias)


def linear(inputs: int, outputs: int, *, normed: bool) -> nn.Module:
    """Return a layer with or without weight norm."""
    return WeightNormLinear(inputs, outputs) if normed else nn.Linear(inputs, outputs)


def with_weight_norm(state: dict[str, Tensor], module: nn.Module) -> dict[str, Tensor]:
    """Return the state of the same network without weight norm, in the names of `module`, where some layers have it."""
    normed = {name for name, part in module.named_modules() if isinstance(part, WeightNormLinear)}
    result = {}
    for name, value in state.items():
        layer, _, kind = name.rpartition(".")
        if layer in normed and kind == "weight":
            result[f"{layer}.weight_v"] = value
            result[f"{layer}.weight_g"] = torch.linalg.vector_norm(value, dim=1, keepdim=True)
        else:
            result[name] = value
    return result


def by_older_names(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the state of layers under torch's newer weight norm by the names of the older one."""
    newer = {".parametrizations.weight.original0": ".weight_g", ".parametrizations.weight.original1": ".weight_v"}
    result = dict(state)
    for new, old in newer.items():
        result = {name.removesuffix(new) + old if name.endswith(new) else name: result[name] for name in result}
    return result
