"""A dense grid: values of the field, or features of it, at every node of a regular lattice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.models.grid_field import GridField, require_grid
from implicit.models.registry import register
from implicit.models.splines import flat_index, peaks, stencil


class DenseGrid(GridField):
    """Field on a dense grid of resolution^D nodes.

    Args:
        dimension: D, 2 or 3.
        resolution: Nodes along each axis; there are `resolution - degree` cells.
        features: Numbers at each node; 1 without a decoder makes them coefficients of the field itself.
        degree: Of the splines: 1 is linear in each cell, so that the normal jumps from cell to cell and the curvature
            is hardly right anywhere; 2 has normals without jumps, 3 a curvature without jumps.
        width, depth: Of the decoder's hidden layers; depth 0 is no decoder.
        bounds: Corners of the box; None is from -1 to 1.
        generator: Source of the initial values; None starts one with seed 0.
    """

    def __init__(
        self,
        dimension: int = 3,
        resolution: int = 64,
        features: int = 1,
        *,
        degree: int = 2,
        width: int = 32,
        depth: int = 0,
        bounds: Sequence[Sequence[float]] | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        require_grid(
            dimension=dimension, features=features, degree=degree, width=width, depth=depth, resolution=resolution
        )
        super().__init__(
            resolution**dimension,
            features,
            features,
            dimension=dimension,
            degree=degree,
            width=width,
            depth=depth,
            bounds=bounds,
            spread=0.1,
            generator=generator,
        )
        self.resolution = resolution
        if depth == 0:  # begin with a ball, which has a surface
            centre = torch.tensor(self.bounds, dtype=torch.float64).mean(dim=0)
            radius = min(b - a for a, b in zip(*self.bounds, strict=True)) / 4
            self.set_values(lambda x: ((x - centre).norm(dim=1) - radius)[:, None].expand(-1, features) / features)

    def stencils(self, unit: Float[Tensor, "n d"]) -> tuple[Int[Tensor, "n g k"], Float[Tensor, "n g k"]]:
        """Return the rows of `values` that act at each point, and their weights, on the one grid."""
        cells = self.resolution - self.degree
        nodes, weights = stencil(unit * cells, cells, self.degree)
        return flat_index(nodes, self.resolution)[:, None], weights[:, None]

    def set_values(self, function: Callable[[Tensor], Tensor]) -> None:
        """Set the numbers at each node to a function of the node's place.

        A grid of degree 1 then interpolates the function; those of degree 2 and 3 smooth it a little, and are exact
        where it is linear.

        Args:
            function: From points (M, D) in float64 to (M,) or (M, features).
        """
        cells = self.resolution - self.degree
        lower, upper = torch.tensor(self.bounds, dtype=torch.float64)
        places = lower + peaks(cells, self.degree, self.dimension) / cells * (upper - lower)
        with torch.no_grad():
            self.values.copy_(function(places).reshape(len(places), -1))

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this grid again."""
        return self.described("dense-grid", dimension=self.dimension, resolution=self.resolution)


register("dense-grid", DenseGrid)
