"""A multi-resolution hash grid: coarse levels hold every node, fine ones share a table by a hash of the node.

    hash(node) = (node_1 * 1  xor  node_2 * 2654435761  xor  node_3 * 805459861)  mod  size of the table

Source: Mueller, Evans, Schied, Keller, "Instant neural graphics primitives with a multiresolution hash encoding",
SIGGRAPH 2022, arXiv:2201.05989, section 3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.arguments import require_between
from implicit.models.grid_field import GridField, require_grid
from implicit.models.registry import register
from implicit.models.splines import flat_index, stencil

PRIMES = (1, 2654435761, 805459861)


class HashGrid(GridField):
    """Field of features on levels of grids, decoded by a small perceptron.

    Args:
        dimension: D, 2 or 3.
        levels: Grids, each `growth` times as fine as the one before.
        table: Most nodes that a level keeps; a finer level's nodes share that many.
        features: Numbers at each node.
        coarsest: Cells along an axis of the first level.
        growth: Cells of a level over those of the level before, 1 to 4.
        degree: Of the splines; 1 as published, 2 and 3 for normals and curvatures without jumps.
        width, depth: Of the decoder's hidden layers; depth 0 is no decoder.
        bounds: Corners of the box; None is from -1 to 1.
        generator: Source of the initial values; None starts one with seed 0.
    """

    def __init__(
        self,
        dimension: int = 3,
        levels: int = 8,
        table: int = 2**12,
        features: int = 2,
        *,
        coarsest: int = 4,
        growth: float = 1.5,
        degree: int = 1,
        width: int = 32,
        depth: int = 1,
        bounds: Sequence[Sequence[float]] | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        require_grid(
            dimension=dimension,
            features=features,
            degree=degree,
            width=width,
            depth=depth,
            levels=levels,
            table=table,
            coarsest=coarsest,
        )
        require_between("growth", growth, 1, 4)
        cells = [math.floor(coarsest * growth**level) for level in range(levels)]
        sizes = [min(table, (side + degree) ** dimension) for side in cells]
        super().__init__(
            sum(sizes),
            features,
            levels * features,
            dimension=dimension,
            degree=degree,
            width=width,
            depth=depth,
            bounds=bounds,
            spread=1e-2,
            generator=generator,
        )
        self.table, self.coarsest, self.growth = table, coarsest, float(growth)
        self.cells, self.sizes = tuple(cells), tuple(sizes)

    def stencils(self, unit: Float[Tensor, "n d"]) -> tuple[Int[Tensor, "n g k"], Float[Tensor, "n g k"]]:
        """Return the rows of `values` that act at each point, and their weights, on each level."""
        rows, weights = [], []
        start = 0
        for cells, size in zip(self.cells, self.sizes, strict=True):
            nodes, w = stencil(unit * cells, cells, self.degree)
            side = cells + self.degree
            index = flat_index(nodes, side) if side**self.dimension <= size else hashed(nodes, size)
            rows.append(start + index)
            weights.append(w)
            start += size
        return torch.stack(rows, dim=1), torch.stack(weights, dim=1)

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this grid again."""
        return self.described(
            "hash-grid",
            dimension=self.dimension,
            levels=len(self.cells),
            table=self.table,
            coarsest=self.coarsest,
            growth=self.growth,
        )


def hashed(nodes: Int[Tensor, "*n d"], size: int) -> Int[Tensor, "*n"]:
    """Return the place of nodes in a table that they share."""
    total = nodes[..., 0] * PRIMES[0]
    for axis in range(1, nodes.shape[-1]):
        total = torch.bitwise_xor(total, nodes[..., axis] * PRIMES[axis])
    return total % size


register("hash-grid", HashGrid)
