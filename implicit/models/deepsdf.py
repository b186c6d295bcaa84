"""DeepSDF's decoder: code and point through ReLU layers, with the input given again in the middle.

    h = [z, x];   h <- relu(W_k h + b_k);   before layer `skip`:  h <- [h, z, x];   f = tanh(W h + b)

Negative inside, truncated at 0.1, shapes within the unit sphere. The defaults and the names of the parameters are those
of the published checkpoints (lin0 ... lin8), weight norm on all layers but the last.
Source: Park, Florence, Straub, Newcombe, Lovegrove, "DeepSDF", CVPR 2019, arXiv:1901.05103.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.field.field import CUBE
from implicit.models.registry import register
from implicit.models.weight_norm import linear


class DeepSdf(nn.Module):
    """Network from points (N, 3) and one code (L,), or a code a point (N, L), to values (N,).

    Args:
        latent: Numbers in a code, L.
        width: Units in each hidden layer.
        depth: Hidden layers.
        skip: The layer that the input is given to again.
        weight_norm: True puts all layers but the last under weight norm.
        tanh: Times that tanh is applied to the output; some published models do it twice.
    """

    level = 0.0
    inside = "negative"
    bounds = CUBE

    def __init__(
        self,
        latent: int = 256,
        width: int = 512,
        depth: int = 8,
        skip: int = 4,
        *,
        weight_norm: bool = True,
        tanh: int = 1,
    ) -> None:
        super().__init__()
        if latent < 1 or depth < 2 or not 0 < skip <= depth or width <= latent + 3 or tanh < 0:
            raise ValueError(
                "DeepSdf needs a latent of at least 1, a width of more than latent + 3, at least 2 hidden layers, a "
                f"skip within them and tanh of at least 0, but got {latent}, {width}, {depth}, {skip}, {tanh}."
            )
        self._arguments = {
            "latent": latent,
            "width": width,
            "depth": depth,
            "skip": skip,
            "weight_norm": weight_norm,
            "tanh": tanh,
        }
        self.latent, self.depth, self.skip, self.tanh = latent, depth, skip, tanh
        for k in range(depth + 1):
            inputs = latent + 3 if k == 0 else width
            outputs = 1 if k == depth else width - (latent + 3) if k == skip - 1 else width
            self.add_module(f"lin{k}", linear(inputs, outputs, normed=weight_norm and k < depth))

    def forward(self, points: Float[Tensor, "n 3"], latent: Float[Tensor, "*n l"]) -> Float[Tensor, " n"]:
        """Return the values at the points."""
        start = torch.cat([latent.expand(len(points), -1), points], dim=1)
        h = start
        for k in range(self.depth + 1):
            if k == self.skip:
                h = torch.cat([h, start], dim=1)
            h = self.get_submodule(f"lin{k}")(h)
            if k < self.depth:
                h = torch.relu(h)
        for _ in range(self.tanh):
            h = torch.tanh(h)
        return h.squeeze(1)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        return {"name": "deepsdf", "arguments": dict(self._arguments)}


register("deepsdf", DeepSdf)
