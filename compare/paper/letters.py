"""Letters as a region of a surface: what no smooth field of a few thousand parameters can express."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.path import Path
from matplotlib.textpath import TextPath
from torch import Tensor

from implicit import Region


@dataclass(frozen=True)
class Letters(Region):
    """The part of a surface that a text covers when it is pressed on along a direction.

    Args:
        text: In matplotlib's own typeface, so that it is the same everywhere.
        center: Middle of the text, on the surface.
        right, up: Unit vectors along the line and along the letters.
        height: Of the capitals.
        depth: How far in front of and behind the plane of the text the surface is covered.
    """

    text: str
    center: Sequence[float]
    right: Sequence[float]
    up: Sequence[float]
    height: float
    depth: float

    def __call__(self, points: Tensor) -> Tensor:
        offset = points.detach().double().cpu().numpy() - np.asarray(self.center)
        right, up = np.asarray(self.right), np.asarray(self.up)
        flat = np.stack([offset @ right, offset @ up], axis=1)
        near = np.abs(offset @ np.cross(right, up)) <= self.depth
        # Holes of letters are outlines within outlines; matplotlib itself would fill them.
        rings = [ring.contains_points(flat) for ring in self._outlines()]
        covered = (np.sum(rings, axis=0) % 2 == 1) & near
        return torch.from_numpy(covered).to(points)

    def _outlines(self) -> list[Path]:
        path = TextPath((0, 0), self.text, size=100)
        box = path.get_extents()
        middle = np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2])
        return [Path((ring - middle) * (self.height / box.height)) for ring in path.to_polygons()]
