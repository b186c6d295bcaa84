"""Tri-planes: features of a point are read on three planes, at its projections along the axes.

    F(x, y, z) = F_yz(y, z) + F_xz(x, z) + F_xy(x, y),    or the three side by side, or their product

Source: Chan et al., "Efficient geometry-aware 3D generative adversarial networks", CVPR 2022, arXiv:2112.07945, 4.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.arguments import require_choice
from implicit.models.grid_field import GridField, require_grid
from implicit.models.registry import register
from implicit.models.splines import flat_index, stencil

PLANES = ((1, 2), (0, 2), (0, 1))


class TriPlane(GridField):
    """Field of features on three planes, decoded by a small perceptron.

    Args:
        resolution: Nodes along each axis of a plane; there are `resolution - degree` cells.
        features: Numbers at each node.
        degree: Of the splines: 1 is bilinear, 2 and 3 have normals and curvatures without jumps.
        combine: How a point's features on the planes come together: "sum" as published, "concatenate" or "product".
        width, depth: Of the decoder's hidden layers; depth 0 is no decoder.
        bounds: Corners of the box; None is from -1 to 1.
        generator: Source of the initial values; None starts one with seed 0.
    """

    def __init__(
        self,
        resolution: int = 32,
        features: int = 8,
        *,
        degree: int = 2,
        combine: Literal["sum", "concatenate", "product"] = "sum",
        width: int = 32,
        depth: int = 2,
        bounds: Sequence[Sequence[float]] | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        require_grid(dimension=3, features=features, degree=degree, width=width, depth=depth, resolution=resolution)
        require_choice("combine", combine, ("sum", "concatenate", "product"))
        super().__init__(
            3 * resolution**2,
            features,
            3 * features if combine == "concatenate" else features,
            dimension=3,
            degree=degree,
            width=width,
            depth=depth,
            bounds=bounds,
            spread=1.0 if combine == "product" else 0.1,
            generator=generator,
        )
        self.resolution, self.combine = resolution, combine

    def stencils(self, unit: Float[Tensor, "n d"]) -> tuple[Int[Tensor, "n g k"], Float[Tensor, "n g k"]]:
        """Return the rows of `values` that act at each point, and their weights, on each plane."""
        cells, side = self.resolution - self.degree, self.resolution
        rows, weights = [], []
        for plane, axes in enumerate(PLANES):
            nodes, w = stencil(unit[:, axes] * cells, cells, self.degree)
            rows.append(plane * side**2 + flat_index(nodes, side))
            weights.append(w)
        return torch.stack(rows, dim=1), torch.stack(weights, dim=1)

    def merge(self, features: Float[Tensor, "n g c"]) -> Float[Tensor, "n f"]:
        """Return the features of a point as the decoder sees them."""
        if self.combine == "concatenate":
            return features.flatten(1)
        return features.sum(dim=1) if self.combine == "sum" else features[:, 0] * features[:, 1] * features[:, 2]

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this grid again."""
        return self.described("tri-plane", resolution=self.resolution, combine=self.combine)


register("tri-plane", TriPlane)
