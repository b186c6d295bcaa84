"""Lamps: a round foot, a pole and a conical shade, all about the y axis."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from implicit.families.family import Family
from implicit.families.solids import cylinder, length, polygon, union

FLOOR = -0.8
FOOT_HEIGHT = 0.12
EDGE = 0.02


def _lamp(p: Mapping[str, Tensor], x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    across = length(x, z)
    top = FLOOR + p["height"]
    rim = top - p["shade_height"]
    foot = cylinder(across, y, FLOOR, FLOOR + FOOT_HEIGHT, p["foot_radius"], EDGE)
    pole = cylinder(across, y, FLOOR + FOOT_HEIGHT / 2, rim + p["shade_height"] / 2, p["pole_radius"], EDGE)
    # A solid shade: the profile turned about the axis, mirrored so that the axis is no edge of it.
    lower, upper = p["shade_radius"] - EDGE, p["shade_top"] - EDGE
    profile = [(-lower, rim + EDGE), (lower, rim + EDGE), (upper, top - EDGE), (-upper, top - EDGE)]
    shade = polygon(across, y, profile) - EDGE
    return union(foot, pole, shade)


LAMPS = Family(
    "lamps",
    {
        "height": (1.1, 1.6),
        "foot_radius": (0.25, 0.5),
        "pole_radius": (0.06, 0.12),
        "shade_radius": (0.3, 0.6),
        "shade_top": (0.15, 0.3),
        "shade_height": (0.3, 0.6),
    },
    _lamp,
)
