"""The network of signed distances that IGR, IDR, NeuS and VolSDF share: softplus layers with the input given again.

    e(x) = [x, sin(x), cos(x), sin(2 x), cos(2 x), ..., cos(2^(m-1) x)],   h = e(scale x)
    before layer k of `skips`:  h <- [h, e(scale x)] / sqrt(2);   h <- softplus(W_k h + b_k)
    f = (the first of W h + b) / scale

with softplus(z) = log(1 + exp(100 z)) / 100. Negative inside. IGR has no encoding (m = 0), no weight norm and one
output; NeuS and VolSDF have m = 6, the older weight norm on every layer and 257 outputs, of which the first is the
distance and the others go to their renderers. The names of the parameters are those of the published checkpoints.

Sources: Gropp, Yariv, Haim, Atzmon, Lipman, "Implicit geometric regularization for learning shapes", ICML 2020,
arXiv:2002.10099; Wang, Liu, Liu, Theobalt, Komura, Wang, "NeuS", NeurIPS 2021, arXiv:2106.10689; Yariv, Gu, Kasten,
Lipman, "Volume rendering of neural implicit surfaces", NeurIPS 2021, arXiv:2106.12052.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_positive, require_whole
from implicit.models.registry import register
from implicit.models.weight_norm import linear


class SdfNetwork(nn.Module):
    """Network from points (N, D) to values (N,), lin0 ... lin`depth`.

    Args:
        dimension: D, 2 or 3.
        width: Units in each hidden layer; those before a skip have fewer by the numbers that the skip adds.
        depth: Hidden layers.
        skips: Layers that the input is given to again.
        octaves: Frequencies m of the encoding, 0 for none.
        outputs: Numbers that the last layer puts out.
        weight_norm: True puts all layers under weight norm.
        sharpness: Of the softplus.
        scale: Factor of the points; the value is divided by it.
    """

    def __init__(
        self,
        dimension: int = 3,
        width: int = 256,
        depth: int = 8,
        skips: Sequence[int] = (4,),
        *,
        octaves: int = 0,
        outputs: int = 1,
        weight_norm: bool = False,
        sharpness: float = 100.0,
        scale: float = 1.0,
    ) -> None:
        super().__init__()
        require_whole("dimension", dimension, 2, "", 3)
        require_whole("width", width)
        require_whole("depth", depth)
        require_whole("octaves", octaves, 0)
        require_whole("outputs", outputs)
        require_positive("sharpness", sharpness)
        require_positive("scale", scale)
        inputs = dimension * (1 + 2 * octaves)
        if not all(0 < skip <= depth for skip in skips) or (skips and width <= inputs):
            raise ValueError(
                f"skips must be layers from 1 to {depth}, and the width more than the {inputs} numbers that they add, "
                f"but are {tuple(skips)} and {width}."
            )
        self._arguments = {
            "dimension": dimension, "width": width, "depth": depth, "skips": list(skips), "octaves": octaves,
            "outputs": outputs, "weight_norm": weight_norm, "sharpness": float(sharpness), "scale": float(scale),
        }  # fmt: skip
        self.depth, self.skips, self.octaves = depth, tuple(skips), octaves
        self.sharpness, self.scale = float(sharpness), float(scale)
        for k in range(depth + 1):
            rows = outputs if k == depth else width - inputs if k + 1 in self.skips else width
            self.add_module(f"lin{k}", linear(inputs if k == 0 else width, rows, normed=weight_norm))

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return the values at the points."""
        start = self._encoded(points * self.scale)
        h = start
        for k in range(self.depth + 1):
            if k in self.skips:
                h = torch.cat([h, start], dim=1) / 2**0.5
            h = self.get_submodule(f"lin{k}")(h)
            if k < self.depth:
                h = nn.functional.softplus(h, self.sharpness)
        return h[:, 0] / self.scale

    def _encoded(self, x: Tensor) -> Tensor:
        waves = [wave(2.0**k * x) for k in range(self.octaves) for wave in (torch.sin, torch.cos)]
        return torch.cat([x, *waves], dim=1)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        return {"name": "sdf_network", "arguments": dict(self._arguments)}


register("sdf_network", SdfNetwork)
