"""Learning a family with an encoder: voxels to a code, and the code to occupancies, which are compared.

    loss = mean (f(x; E(voxels_s)) - o_s(x))^2,    o_s = clamp(1/2 - d_s / ramp, 0, 1)

The occupancy o_s falls from 1 to 0 over a ramp about the surface, where IM-NET's own jumps: between 0 and 1 the decoder
is linear in its last layer, so that it learns a distance there, and the edits get a gradient to go by. Coordinates are
halved for the network: IM-NET's cube is [-0.5, 0.5]^3, the families' [-1, 1]^3.
Source: Chen and Zhang, "Learning implicit fields for generative shape modeling", CVPR 2019, section 3.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.families.family import Family
from implicit.families.samples import Samples
from implicit.models.imnet import ImNet, ImNetEncoder

SCALE = 0.5  # of IM-NET's coordinates to the family's
RAMP = 0.1  # in the family's units; narrower than any part is thick
POINTS_A_SHAPE = 256


def voxels(family: Family, parameters: Float[Tensor, "s p"], resolution: int) -> Float[Tensor, "s 1 r r r"]:
    """Return the part of each cell of [-1, 1]^3 that is inside each shape, from 0 to 1.

    A yes or no would hide where in a cell a face lies, with 32^3 cells a fifth of what a leg is thick: so trained, the
    encoder brought chairs that it had not learned back with an IoU of 0.76.
    """
    cell = 2 / resolution
    middles = (torch.arange(resolution) + 0.5) * cell - 1
    grid = torch.stack(torch.meshgrid(middles, middles, middles, indexing="ij"), dim=-1).reshape(1, -1, 3)
    inside = [(0.5 - family.distance(row[None], grid) / cell).clamp(0, 1) for row in parameters]
    return torch.cat(inside).view(-1, 1, resolution, resolution, resolution)


class AutoEncoder:
    """An encoder and a decoder, and the shapes that they learn.

    Args:
        decoder, encoder: To be trained.
        samples: Points and distances of the shapes.
        grids: Their voxels.
        batch: Points of a step, of a few shapes chosen at random.
    """

    def __init__(
        self,
        decoder: ImNet,
        encoder: ImNetEncoder,
        samples: Samples,
        grids: Float[Tensor, "s 1 r r r"],
        batch: int,
    ) -> None:
        self.decoder, self.encoder, self.samples, self.grids = decoder, encoder, samples, grids
        self._shapes = max(1, batch // POINTS_A_SHAPE)

    def modules(self) -> dict[str, nn.Module]:
        """Return the decoder and the encoder by their names."""
        return {"decoder": self.decoder, "encoder": self.encoder}

    def others(self) -> list[Tensor]:
        """Return the parameters of the encoder."""
        return list(self.encoder.parameters())

    def loss(self, generator: torch.Generator) -> Tensor:
        """Return the loss of a fresh batch."""
        chosen = torch.randperm(len(self.grids), generator=generator)[: self._shapes].to(self.grids.device)
        some = Samples(self.samples.points[chosen], self.samples.distances[chosen])
        points, distances = some.draw(POINTS_A_SHAPE, generator)
        codes = self.encoder(self.grids[chosen].to(points)).repeat_interleave(POINTS_A_SHAPE, dim=0)
        values = self.decoder(SCALE * points.flatten(0, 1), codes)
        return (values - (0.5 - distances.flatten() / RAMP).clamp(0, 1)).square().mean()

    def reported(self, loss: Tensor) -> float:
        """Return the loss as it is."""
        return float(loss)

    def latents(self) -> Float[Tensor, "s l"]:
        """Return the codes of the training shapes."""
        return encode(self.encoder, self.grids)


@torch.no_grad()
def encode(encoder: ImNetEncoder, grids: Float[Tensor, "s 1 r r r"]) -> Float[Tensor, "s l"]:
    """Return the codes of shapes given by their voxels."""
    dtype = next(encoder.parameters()).dtype
    return torch.cat([encoder(part.to(dtype)) for part in grids.split(32)])
