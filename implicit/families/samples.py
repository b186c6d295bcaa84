"""Points of space with their signed distances, for shapes of a family: what the decoders learn from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import counted, kind_of
from implicit.families.family import Family

# Standard deviations of the points about the surface, in the family's units: a third each, with a third in the whole
# cube. The near ones decide where the surface lies, the wide ones keep the rest free of it.
SPREADS = (0.005, 0.03)


@dataclass(frozen=True, eq=False)
class Samples:
    """Points and their signed distances, for each shape of a table of parameters."""

    points: Float[Tensor, "s n 3"]
    distances: Float[Tensor, "s n"]

    def __repr__(self) -> str:
        shapes, points = self.distances.shape
        return f"Samples: {counted(points, 'point')} for each of {counted(shapes, 'shape')} ({kind_of(self.points)})"

    def draw(self, count: int, generator: torch.Generator) -> tuple[Float[Tensor, "s k 3"], Float[Tensor, "s k"]]:
        """Return so many of each shape's points at random, with repetition."""
        shapes, n = self.distances.shape
        pick = torch.randint(n, (shapes, count), generator=generator).to(self.points.device)
        row = torch.arange(shapes, device=self.points.device)[:, None]
        return self.points[row, pick], self.distances[row, pick]

    def to(self, device: torch.device | str) -> Samples:
        """Return the same samples on another device."""
        return Samples(self.points.to(device), self.distances.to(device))


def draw_samples(family: Family, parameters: Float[Tensor, "s p"], count: int, seed: int = 0) -> Samples:
    """Return points about each shape's surface and in all of [-1, 1]^3, with their distances, float32.

    Args:
        family: The family of the shapes.
        parameters: Row for each shape.
        count: Points of each shape.
        seed: Seed of the points.
    """
    generator = torch.Generator().manual_seed(seed)
    points, distances = [], []
    for part in parameters.split(32):
        uniform = 2 * torch.rand(len(part), count, 3, generator=generator) - 1
        spread = torch.zeros(count)
        third = count // 3
        for k, s in enumerate(SPREADS):
            spread[k * third : (k + 1) * third] = s
        noise = spread[:, None] * torch.randn(len(part), count, 3, generator=generator)
        near = (spread > 0)[:, None]
        x = torch.where(near, _on_surface(family, part, uniform) + noise, uniform)
        points.append(x)
        distances.append(family.distance(part, x))
    return Samples(torch.cat(points), torch.cat(distances))


def _on_surface(family: Family, parameters: Tensor, points: Tensor) -> Tensor:
    """Return points moved along the gradient of the distance by the distance; a few times, for where two parts meet."""
    for _ in range(3):
        x = points.detach().requires_grad_()
        distance = family.distance(parameters, x)
        (gradient,) = torch.autograd.grad(distance.sum(), x)
        points = points - distance.detach()[..., None] * gradient
    return points
