"""Features on grids and what decodes them: the part that dense, hash and tri-plane grids have in common.

    f(x) = decoder(x, F(x)),    F_g(x) = sum_k w_gk(x) values[node_gk(x)]      g: the grids, levels or planes

At a point only the few values of its own nodes act. A grid says which: `local_parameters` gives their places, and
`forward` takes their values in place of the table, so that derivatives by the values cost as much as there are nodes of
a point, not as there are parameters (implicit.sensitivity.sparse_rows).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from implicit.arguments import require_numbers, require_whole
from implicit.models.linear import unset_linear


class FeatureDecoder(nn.Module):
    """Perceptron with SiLU from a point and its features to a value.

    Args:
        inputs: Numbers it takes: coordinates and features.
        width: Units in each hidden layer.
        depth: Hidden layers, at least 1.
        generator: Source of the initial weights.
    """

    def __init__(self, inputs: int, width: int, depth: int, generator: torch.Generator) -> None:
        super().__init__()
        widths = [inputs] + [width] * depth + [1]
        layers = [unset_linear(a, b) for a, b in pairwise(widths)]
        self.layers = nn.ModuleList(layers)
        with torch.no_grad():
            for layer in layers:
                reach = layer.in_features**-0.5
                layer.weight.uniform_(-reach, reach, generator=generator)
                layer.bias.uniform_(-reach, reach, generator=generator)

    def forward(self, inputs: Float[Tensor, "n k"]) -> Float[Tensor, " n"]:
        """Return the values."""
        for layer in self.layers[:-1]:
            inputs = nn.functional.silu(layer(inputs))
        return self.layers[-1](inputs).squeeze(-1)


class GridField(nn.Module, ABC):
    """Field of features on grids, from points (N, D) to values (N,).

    Args:
        rows: Nodes of all grids together.
        features: Numbers at each node.
        merged: Features of a point that the decoder sees.
        dimension: D, 2 or 3.
        degree: Of the splines: 1 is linear in each cell, 2 and 3 have a curvature.
        width, depth: Of the decoder's hidden layers; depth 0 is no decoder, and the features of a point are added up.
        bounds: Corners of the box that the grids fill.
        spread: Initial values are uniform within so much about 0.
        generator: Source of the initial values; None starts one with seed 0.
    """

    def __init__(
        self,
        rows: int,
        features: int,
        merged: int,
        *,
        dimension: int,
        degree: int,
        width: int,
        depth: int,
        bounds: Sequence[Sequence[float]] | None,
        spread: float,
        generator: torch.Generator | None,
    ) -> None:
        super().__init__()
        box = [[-1.0] * dimension, [1.0] * dimension] if bounds is None else bounds
        corners = require_numbers("bounds", box, "a lower and an upper corner")
        if corners.shape != (2, dimension) or not bool((corners[0] < corners[1]).all()):
            raise ValueError(
                f"bounds must be a lower and an upper corner in {dimension} dimensions, the lower one smaller in each "
                f"coordinate, but is {bounds}."
            )
        generator = torch.Generator().manual_seed(0) if generator is None else generator
        self.dimension, self.degree, self.features = dimension, degree, features
        self.bounds = tuple(tuple(float(x) for x in corner) for corner in corners.tolist())
        values = (torch.rand(rows, features, generator=generator) * 2 - 1) * spread
        self.values = nn.Parameter(values)
        self.decoder = FeatureDecoder(dimension + merged, width, depth, generator) if depth else None

    @abstractmethod
    def stencils(self, unit: Float[Tensor, "n d"]) -> tuple[Int[Tensor, "n g k"], Float[Tensor, "n g k"]]:
        """Return the rows of `values` that act at each point, and their weights, on each of G grids.

        Args:
            unit: Points in the box from 0 to 1.
        """

    def merge(self, features: Float[Tensor, "n g c"]) -> Float[Tensor, "n f"]:
        """Return the features of a point as the decoder sees them: those of one grid after the other."""
        return features.flatten(1)

    def forward(
        self, points: Float[Tensor, "n d"], local: Mapping[str, Float[Tensor, "n k"]] | None = None
    ) -> Float[Tensor, " n"]:
        """Return the values at the points.

        Args:
            points: Points (N, D).
            local: Values of the parameters that act at each point, in the order of `local_parameters`; without them
                the grid's own.
        """
        rows, weights = self.stencils(self._unit(points))
        values = (
            self.values[rows]
            if local is None or "values" not in local
            else local["values"].view(*rows.shape, self.features)
        )
        features = self.merge((weights[..., None] * values).sum(dim=2))
        if self.decoder is None:
            return features.sum(dim=1)
        return self.decoder(torch.cat([points, features], dim=1))

    def local_parameters(self, points: Float[Tensor, "n d"]) -> dict[str, Int[Tensor, "n k"]]:
        """Return which numbers of `values`, flattened, act at each point; one may stand several times."""
        rows, _ = self.stencils(self._unit(points))
        channels = torch.arange(self.features, device=points.device)
        return {"values": (rows[..., None] * self.features + channels).flatten(1)}

    def _unit(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
        lower, upper = torch.tensor(self.bounds, dtype=points.dtype, device=points.device)
        return (points - lower) / (upper - lower)

    def described(self, name: str, **arguments: Any) -> dict[str, Any]:
        """Return a description with the arguments that all grids take."""
        first = None if self.decoder is None else self.decoder.layers[0]
        return {
            "name": name,
            "arguments": {
                "features": self.features,
                "degree": self.degree,
                "width": 1 if first is None else first.out_features,
                "depth": 0 if self.decoder is None else len(self.decoder.layers) - 1,
                "bounds": [list(corner) for corner in self.bounds],
                **arguments,
            },
        }


def require_grid(
    *, dimension: int, features: int, degree: int, width: int, depth: int, resolution: int | None = None, **sizes: int
) -> None:
    """Refuse sizes of a grid that are none.

    Args:
        dimension, features, degree, width, depth: Of every grid.
        resolution: Nodes along an axis, where those are given: more than the degree, for one cell at least.
        sizes: Further whole numbers of at least 1.
    """
    require_whole("dimension", dimension, 2, "", 3)
    require_whole("features", features)
    require_whole("degree", degree, 1, "", 3)
    require_whole("width", width)
    require_whole("depth", depth, 0)
    for name, size in sizes.items():
        require_whole(name, size)
    if resolution is not None:
        require_whole("resolution", resolution)
        if resolution <= degree:
            raise ValueError(
                f"resolution must be above the degree {degree}, for one cell at least, but is {resolution}."
            )
