"""IM-NET: occupancy from point and code, and the encoder that makes a code of voxels.

    h <- leaky relu(W_k h + b_k),  h_0 = [x, z];   a the last linear output;
    value = max(min(a, 0.01 a + 0.99), 0.01 a)

so that the value is a between 0 and 1 and nearly level beyond: large inside, the surface at 0.5, in the cube
[-0.5, 0.5]^3. The defaults and the names of the parameters are those of the published checkpoints; the paper describes
eight layers of 1024, the published network tapers.
Source: Chen and Zhang, "Learning implicit fields for generative shape modeling", CVPR 2019, arXiv:1812.02822.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.models.registry import register

SLOPE = 0.02  # of the leaky ReLU
TAPER = (8, 8, 8, 4, 2, 1)  # hidden widths in units of `width`


class ImNet(nn.Module):
    """Network from points (N, 3) and one code (L,), or a code a point (N, L), to values (N,).

    Args:
        latent: Numbers in a code, L.
        width: Units in the last hidden layer; the first has eight times as many.
    """

    level = 0.5
    inside = "positive"
    bounds = ((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))

    def __init__(self, latent: int = 256, width: int = 128) -> None:
        super().__init__()
        if latent < 1 or width < 1:
            raise ValueError(f"ImNet needs latent and width of at least 1, but got {latent}, {width}.")
        self.latent, self.width = latent, width
        widths = [latent + 3, *(factor * width for factor in TAPER), 1]
        for k in range(len(widths) - 1):
            self.add_module(f"linear_{k + 1}", nn.Linear(widths[k], widths[k + 1]))

    def forward(self, points: Float[Tensor, "n 3"], latent: Float[Tensor, "*n l"]) -> Float[Tensor, " n"]:
        """Return the values at the points."""
        h = torch.cat([points, latent.expand(len(points), -1)], dim=1)
        for k in range(len(TAPER)):
            h = nn.functional.leaky_relu(self.get_submodule(f"linear_{k + 1}")(h), SLOPE)
        a = self.get_submodule(f"linear_{len(TAPER) + 1}")(h).squeeze(1)
        return torch.maximum(torch.minimum(a, 0.01 * a + 0.99), 0.01 * a)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        return {"name": "imnet", "arguments": {"latent": self.latent, "width": self.width}}


register("imnet", ImNet)


class ImNetEncoder(nn.Module):
    """Network from voxels (S, 1, R, R, R), 1 inside, to codes (S, L) between 0 and 1.

    Convolutions of stride 2 halve the grid down to 4^3, the last takes that to one cell.

    Args:
        latent: Numbers in a code, L.
        width: Channels after the first convolution; each further one doubles them, the last but one keeps them.
        resolution: R, a power of two of at least 16.
    """

    def __init__(self, latent: int = 256, width: int = 32, resolution: int = 64) -> None:
        super().__init__()
        halvings = resolution.bit_length() - 3
        if latent < 1 or width < 1 or resolution < 16 or resolution != 4 << halvings:
            raise ValueError(
                "ImNetEncoder needs latent and width of at least 1 and a resolution that is a power of two of at least "
                f"16, but got {latent}, {width}, {resolution}."
            )
        self._arguments = {"latent": latent, "width": width, "resolution": resolution}
        self.halvings, self.resolution = halvings, resolution
        channels = [1, *(width << k for k in range(halvings))]
        for k in range(halvings):
            self.add_module(
                f"conv_{k + 1}", nn.Conv3d(channels[k], channels[k + 1], 4, stride=2, padding=1, bias=False)
            )
            self.add_module(f"in_{k + 1}", nn.InstanceNorm3d(channels[k + 1]))
        self.add_module(f"conv_{halvings + 1}", nn.Conv3d(channels[-1], latent, 4))

    def forward(self, voxels: Float[Tensor, "s 1 r r r"]) -> Float[Tensor, "s l"]:
        """Return the codes of the shapes."""
        h = voxels
        for k in range(self.halvings):
            h = self.get_submodule(f"in_{k + 1}")(self.get_submodule(f"conv_{k + 1}")(h))
            h = nn.functional.leaky_relu(h, SLOPE)
        return torch.sigmoid(self.get_submodule(f"conv_{self.halvings + 1}")(h).flatten(1))

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        return {"name": "imnet-encoder", "arguments": dict(self._arguments)}
