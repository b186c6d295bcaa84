"""A perceptron with softplus or ReLU, started near the distance to a sphere.

Source of the start: Atzmon and Lipman, "SAL: Sign agnostic learning of shapes from raw data", CVPR 2020, theorem 1:
with hidden weights of variance 2 / width, equal weights sqrt(pi / width) in the last layer and its bias -r, the
network of ReLUs is close to |x| - r.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_whole
from implicit.models.linear import unset_linear
from implicit.models.registry import register


class Mlp(nn.Module):
    """Network from points (N, D) to values (N,) through hidden layers of softplus or ReLU.

    Args:
        dimension: D, 2 or 3.
        width: Units in each hidden layer.
        depth: Hidden layers.
        activation: "softplus", infinitely often differentiable, or "relu", whose normals jump and whose curvature
            is zero almost everywhere.
        sharpness: The softplus is log(1 + exp(sharpness x)) / sharpness; it bends within about 1 / sharpness.
        generator: Source of the initial weights; None starts one with seed 0.
    """

    def __init__(
        self,
        dimension: int = 3,
        width: int = 512,
        depth: int = 8,
        *,
        activation: Literal["softplus", "relu"] = "softplus",
        sharpness: float = 100.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        require_whole("dimension", dimension, 2, "", 3)
        require_whole("width", width)
        require_whole("depth", depth)
        if activation not in ("softplus", "relu") or not sharpness > 0:
            raise ValueError(
                'Mlp needs activation "softplus" or "relu" and a positive sharpness, but got '
                f"{activation!r}, {sharpness}."
            )
        self.activation = activation
        self.sharpness = float(sharpness)
        widths = [dimension] + [width] * depth + [1]
        generator = torch.Generator().manual_seed(0) if generator is None else generator
        layers = [unset_linear(a, b) for a, b in pairwise(widths)]
        self.layers = nn.ModuleList(layers)
        with torch.no_grad():
            for layer in layers[:-1]:
                layer.weight.normal_(0, (2 / layer.out_features) ** 0.5, generator=generator)
                layer.bias.zero_()
            layers[-1].weight.fill_((torch.pi / width) ** 0.5)
            layers[-1].bias.fill_(-0.5)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return the values at the points."""
        *hidden, last = self.layers  # a slice would be a new list of modules each time
        h = points
        for layer in hidden:
            h = layer(h)
            h = torch.relu(h) if self.activation == "relu" else nn.functional.softplus(h, self.sharpness)
        return last(h).squeeze(-1)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        first = self.layers[0]
        return {
            "name": "mlp",
            "arguments": {
                "dimension": first.in_features,
                "width": first.out_features,
                "depth": len(self.layers) - 1,
                "activation": self.activation,
                "sharpness": self.sharpness,
            },
        }


register("mlp", Mlp)
