"""A mesh of a network's surface: all nodes of the grid and scikit-image, or ours."""

from __future__ import annotations

import numpy as np
import torch
from rows.table import best, row
from skimage.measure import marching_cubes

import implicit
import meshref
from implicit import shapes


def extraction(resolution: int = 256) -> None:
    """A mesh of 256 cells a side: dense evaluation and scikit-image, and ours."""
    field = shapes.bundled("spot")

    def dense() -> tuple[np.ndarray, np.ndarray]:
        axis = torch.linspace(-1, 1, resolution + 1)
        slab = torch.cartesian_prod(axis, axis)
        values = torch.stack(
            [field.value(torch.cat([x.expand(len(slab), 1), slab], dim=1)).view(len(axis), len(axis)) for x in axis]
        )
        V, F, _, _ = marching_cubes(values.numpy(), 0.0)
        return V * (2 / resolution) - 1, F

    (theirs_s, theirs), (ours_s, mine) = best(dense, lambda: implicit.extract_mesh(field, resolution))
    V, F = theirs
    distance = meshref.hausdorff(*mine, V.astype(float), F.astype(np.int64)) / (2 / resolution)
    row(
        f"mesh at {resolution}^3: dense evaluation and scikit-image",
        theirs_s,
        ours_s,
        f"two-sided Hausdorff {distance:.3f} cells",
        distance < 0.1,
    )
