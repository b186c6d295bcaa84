"""Learning a family without an encoder: one code a shape, trained together with the decoder.

    loss = mean |f(x; z_s) - clamp(d_s(x), +-0.1)|  +  pull * mean |z_s|^2   [+ coarse_weight * mean |f_coarse - d_s|]

the last for DualSDF's spheres. Only the distance is clamped: clamping the decoder's output too, as the papers write,
leaves it without a gradient wherever it starts out large, and training stalls.
Source: Park et al., "DeepSDF", CVPR 2019, section 4; Hao et al., "DualSDF", CVPR 2020, section 3.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.families.samples import Samples
from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf

TRUNCATION = 0.1  # farther than this the decoder only learns the sign
PULL = 1e-4
# Codes are given out with a spread of one, and have about a sixth of that in training: new ones are pulled less.
PULL_OF_NEW = PULL / 36
COARSE_WEIGHT = 0.1
COARSE_SHARE = 4  # one in so many points is used for the spheres
SPREAD = 0.1  # standard deviation of the first codes


class AutoDecoder:
    """A decoder and the codes of the shapes that it learns.

    Args:
        decoder: Without weight norm: its linear layers are moved as they are.
        samples: Points and distances of the shapes.
        batch: Points of a step, spread evenly over all shapes.
        generator: Source of the first codes.
    """

    def __init__(self, decoder: DeepSdf | DualSdf, samples: Samples, batch: int, generator: torch.Generator) -> None:
        self.decoder, self.samples = decoder, samples
        shapes = len(samples.distances)
        self._each = max(1, batch // shapes)
        codes = SPREAD * torch.randn(shapes, decoder.latent, generator=generator)
        self.codes = codes.to(samples.points).requires_grad_()
        if isinstance(decoder, DualSdf):
            _scatter_spheres(decoder, generator)

    def modules(self) -> dict[str, nn.Module]:
        """Return the decoder by its name."""
        return {"decoder": self.decoder}

    def others(self) -> list[Tensor]:
        """Return the codes."""
        return [self.codes]

    def loss(self, generator: torch.Generator) -> Tensor:
        """Return the loss of a fresh batch."""
        points, distances = self.samples.draw(self._each, generator)
        return _loss(self.decoder, self.codes, points, distances, PULL)

    def reported(self, loss: Tensor) -> float:
        """Return the loss as it is."""
        return float(loss)

    def latents(self) -> Float[Tensor, "s l"]:
        """Return the codes of the training shapes."""
        return self.codes.detach()


def find_codes(
    decoder: DeepSdf | DualSdf,
    samples: Samples,
    start: Float[Tensor, " l"],
    *,
    steps: int = 400,
    batch: int = 300,
    learning_rate: float = 0.1,
    seed: int = 0,
) -> Float[Tensor, "s l"]:
    """Return codes, of a spread of one, of shapes that the decoder has not seen: by the same loss, the decoder fixed.

    Args:
        samples: Points and distances of the shapes.
        start: The code to begin from, such as the mean of the training codes.
        steps, batch, learning_rate: Options of Adam; batch is points of each shape.
        seed: Seed of the batches.
    """
    generator = torch.Generator().manual_seed(seed)
    codes = start.detach().repeat(len(samples.distances), 1).requires_grad_()
    optimiser = torch.optim.Adam([codes])
    for step in range(steps):
        points, distances = samples.draw(batch, generator)
        loss = _loss(decoder, codes, points, distances, PULL_OF_NEW)
        (codes.grad,) = torch.autograd.grad(loss, codes)
        optimiser.param_groups[0]["lr"] = learning_rate * (1 + math.cos(math.pi * step / steps)) / 2
        optimiser.step()
    return codes.detach()


def _loss(decoder: DeepSdf | DualSdf, codes: Tensor, points: Tensor, distances: Tensor, pull: float) -> Tensor:
    each = points.shape[1]
    values = decoder(points.flatten(0, 1), codes.repeat_interleave(each, dim=0))
    error = values - distances.flatten().clamp(-TRUNCATION, TRUNCATION)
    loss = error.abs().mean() + pull * codes.square().sum(dim=1).mean()
    if isinstance(decoder, DualSdf):
        some = slice(None, None, COARSE_SHARE)
        coarse = decoder.coarse(points[:, some], codes) - distances[:, some]
        loss = loss + COARSE_WEIGHT * coarse.abs().mean()
    return loss


@torch.no_grad()
def _scatter_spheres(decoder: DualSdf, generator: torch.Generator) -> None:
    """Start the spheres small and all over the middle of the cube, where shapes are."""
    last = decoder.prim_attr_net.net2[-1]
    assert isinstance(last, nn.Linear)
    bias = torch.rand(last.out_features // 4, 4, generator=generator) - 0.5
    bias[:, 0] = math.log(0.1)
    last.bias.copy_(bias.flatten())
