"""Shapes given by formulas, and networks fitted to shapes that come with the package."""

from __future__ import annotations

from implicit.shapes.analytic import (
    box,
    bracket,
    cactus,
    capsule,
    chair,
    circle,
    cylinder,
    dumbbell,
    ellipsoid,
    exact_area,
    exact_volume,
    rounded_box,
    smooth_difference,
    smooth_intersection,
    smooth_union,
    sphere,
    torus,
)
from implicit.shapes.bundled import BUNDLED, bundled as bundled

__all__ = [
    "BUNDLED",
    "box",
    "bracket",
    "bundled",
    "cactus",
    "capsule",
    "chair",
    "circle",
    "cylinder",
    "dumbbell",
    "ellipsoid",
    "exact_area",
    "exact_volume",
    "rounded_box",
    "smooth_difference",
    "smooth_intersection",
    "smooth_union",
    "sphere",
    "torus",
]
