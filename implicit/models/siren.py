"""A sine network: h <- sin(frequency (W h + b)) in each hidden layer, then one linear layer.

Source: Sitzmann, Martel, Bergman, Lindell, Wetzstein, NeurIPS 2020, arXiv:2006.09661, section 3.2.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_positive, require_whole
from implicit.models.linear import unset_linear
from implicit.models.registry import register


class Siren(nn.Module):
    """Network from points (N, D) to values (N,) through hidden layers of sines.

    The default, 3 hidden layers of 32, has 2273 parameters: the network of Berzins et al. 2023.

    Args:
        dimension: D, 2 or 3.
        width: Sines in each hidden layer.
        depth: Hidden layers.
        first_frequency: Factor inside the first sine: about how many half waves cross a box of side 2 at the start.
            High values fit detail sooner and ripple between the samples. Chosen by measurement on three shapes
            (fandisk, armadillo, cactus; 1500 steps of fit_field): 6 leaves a mean distance of 0.051, 0.129, 0.070 % of
            the diagonal, 12 leaves 0.037, 0.091, 0.056 %, 20 leaves 0.040, 0.082, 0.047 %, and 30 grows 22 stray
            pieces on the armadillo. 12 stays a factor of two clear of that.
        frequency: Factor inside the later sines. With 12 in the first, 3 leaves 0.048, 0.126, 0.077 %, 6 what stands
            above, and 12 leaves 0.036, 0.088, 0.049 %. Both at 30, as published for images, grew thousands of pieces.
        generator: Source of the initial weights; None starts one with seed 0.
    """

    def __init__(
        self,
        dimension: int = 3,
        width: int = 32,
        depth: int = 3,
        *,
        first_frequency: float = 12.0,
        frequency: float = 6.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        require_whole("dimension", dimension, 2, "", 3)
        require_whole("width", width)
        require_whole("depth", depth)
        require_positive("first_frequency", first_frequency)
        require_positive("frequency", frequency)
        self.first_frequency = float(first_frequency)
        self.frequency = float(frequency)
        widths = [dimension] + [width] * depth + [1]
        generator = torch.Generator().manual_seed(0) if generator is None else generator
        layers = [unset_linear(a, b) for a, b in pairwise(widths)]
        self.layers = nn.ModuleList(layers)
        with torch.no_grad():
            for k, layer in enumerate(layers):
                inputs = widths[k]
                # Keeps the arguments of the later sines near unit variance (their section 3.2).
                reach = 1 / inputs if k == 0 else (6 / inputs) ** 0.5 / self.frequency
                layer.weight.uniform_(-reach, reach, generator=generator)
                layer.bias.uniform_(-(inputs**-0.5), inputs**-0.5, generator=generator)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n ..."]:
        """Return the values at the points."""
        *hidden, last = self.layers  # a slice would be a new list of modules each time
        h = points
        for k, layer in enumerate(hidden):
            h = self.activate(k, layer(h))
        return last(h).squeeze(-1)

    def activate(self, layer: int, z: Tensor) -> Tensor:
        """Return the sine after a hidden layer."""
        return torch.sin((self.first_frequency if layer == 0 else self.frequency) * z)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        first = self.layers[0]
        return {
            "name": "siren",
            "arguments": {
                "dimension": first.in_features,
                "width": first.out_features,
                "depth": len(self.layers) - 1,
                "first_frequency": self.first_frequency,
                "frequency": self.frequency,
            },
        }


register("siren", Siren)
