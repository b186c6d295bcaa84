"""DualSDF: one code decoded twice, to spheres that a user can grasp and to a fine signed distance.

    fine:    f = tanh(net2([net1([z, x]), z, x])),  both perceptrons of ReLU
    coarse:  the same without x gives (log r_m, c_m) of M spheres, and
             f = -1/k log sum_m exp(-k (|x - c_m| - r_m)),  k = 100

Negative inside, truncated at 0.1, shapes within the unit sphere. The defaults and the names of the parameters are those
of the published checkpoints: where dropout was used in training, the linear layers stand at every third place of
`net1` and `net2`, else at every second.
Source: Hao, Averbuch-Elor, Snavely, Belongie, "DualSDF: Semantic shape manipulation using a two-level representation",
CVPR 2020, arXiv:2004.02869.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.field.field import CUBE
from implicit.models.registry import register
from implicit.models.weight_norm import linear

SHARPNESS = 100.0  # k of the smooth minimum over spheres


class SkipPerceptron(nn.Module):
    """Layers `net1`, then the input again, then layers `net2`; ReLU after each layer but the last.

    Args:
        inputs, width, outputs: Units.
        depths: Layers of net1 and of net2.
        dropout: Dropout of the training; it decides where the layers stand.
        weight_norm: True puts all layers but the last under weight norm.
    """

    def __init__(
        self, inputs: int, width: int, outputs: int, depths: tuple[int, int], *, dropout: float, weight_norm: bool
    ) -> None:
        super().__init__()
        first = [inputs] + [width] * (depths[0] - 1) + [width - inputs]
        second = [width] * depths[1] + [outputs]
        self.net1 = nn.Sequential(*_layers(first, dropout, weight_norm, last=False))
        self.net2 = nn.Sequential(*_layers(second, dropout, weight_norm, last=True))

    def forward(self, x: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        """Return the outputs of rows of inputs."""
        return self.net2(torch.cat([self.net1(x), x], dim=1))


def _layers(widths: list[int], dropout: float, normed: bool, *, last: bool) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for k in range(len(widths) - 1):
        output = last and k == len(widths) - 2
        layers.append(linear(widths[k], widths[k + 1], normed=normed and not output))
        if not output:
            layers.append(nn.ReLU())
            if dropout > 0:
                layers.append(nn.Dropout(dropout))
    return layers


class DualSdf(nn.Module):
    """Network from points (N, 3) and one code (L,), or a code a point (N, L), to values (N,) of the fine level.

    Args:
        latent: Numbers in a code, L.
        width: Units in each hidden layer, of both decoders.
        depths: Layers before and after the input is given again, of both.
        spheres: Spheres of the coarse level, M.
        dropout: Dropout of the fine decoder's training: 0.2 for the published chairs, planes and cars.
        weight_norm: True puts all layers but the last under weight norm.
    """

    level = 0.0
    inside = "negative"
    bounds = CUBE

    def __init__(
        self,
        latent: int = 128,
        width: int = 512,
        depths: tuple[int, int] = (4, 5),
        spheres: int = 256,
        *,
        dropout: float = 0.2,
        weight_norm: bool = True,
    ) -> None:
        super().__init__()
        if latent < 1 or spheres < 1 or min(depths) < 1 or width <= latent + 3:
            raise ValueError(
                "DualSdf needs at least 1 latent, sphere and layer on each side, and a width of more than latent + 3, "
                f"but got {latent}, {spheres}, {tuple(depths)}, {width}."
            )
        self._arguments = {
            "latent": latent,
            "width": width,
            "depths": list(depths),
            "spheres": spheres,
            "dropout": dropout,
            "weight_norm": weight_norm,
        }
        self.latent = latent
        pair = (depths[0], depths[1])
        self.deepsdf_net = SkipPerceptron(latent + 3, width, 1, pair, dropout=dropout, weight_norm=weight_norm)
        self.prim_attr_net = SkipPerceptron(latent, width, 4 * spheres, pair, dropout=0.0, weight_norm=weight_norm)

    def forward(self, points: Float[Tensor, "n 3"], latent: Float[Tensor, "*n l"]) -> Float[Tensor, " n"]:
        """Return the fine values at the points."""
        rows = torch.cat([latent.expand(len(points), -1), points], dim=1)
        return torch.tanh(self.deepsdf_net(rows)).squeeze(1)

    def spheres(self, latent: Float[Tensor, "*s l"]) -> tuple[Float[Tensor, "*s m"], Float[Tensor, "*s m 3"]]:
        """Return the radii and centres of the spheres."""
        rows = self.prim_attr_net(latent.reshape(-1, self.latent))
        attributes = rows.reshape(*latent.shape[:-1], -1, 4)
        return attributes[..., 0].exp(), attributes[..., 1:]

    def coarse(self, points: Float[Tensor, "*s n 3"], latent: Float[Tensor, "*s l"]) -> Float[Tensor, "*s n"]:
        """Return the coarse values at the points: the smooth union of the spheres."""
        radii, centers = self.spheres(latent)
        away = points[..., :, None, :] - centers[..., None, :, :]
        distances = away.square().sum(dim=-1).clamp(min=1e-12).sqrt() - radii[..., None, :]
        return -torch.logsumexp(-SHARPNESS * distances, dim=-1) / SHARPNESS

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this network again."""
        return {"name": "dualsdf", "arguments": dict(self._arguments)}


register("dualsdf", DualSdf)
