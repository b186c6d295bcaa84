"""Chairs: a seat whose top is at y = 0, four equal legs flush with its corners, and a back along its rear edge.

The front is at +z. The seat stays where it is when the legs or the back change, so that a change of one is seen alone.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from implicit.families.family import Family
from implicit.families.solids import box, union

EDGE = 0.02  # radius of all edges


def _chair(p: Mapping[str, Tensor], x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    half, front = p["seat_width"] / 2, p["seat_depth"] / 2
    under = -p["seat_thickness"]
    seat = box(x, y, z, (-half, under, -front), (half, 0.0, front), EDGE)
    # One leg and its mirror images. It runs up into the seat, so that no edge is rounded where they meet.
    foot = under - p["leg_length"]
    thick = p["leg_thickness"]
    leg = box(x.abs(), y, z.abs(), (half - thick, foot, front - thick), (half, under / 2, front), EDGE)
    back = box(x, y, z, (-half, under, -front), (half, p["back_height"], p["back_thickness"] - front), EDGE)
    return union(seat, leg, back)


CHAIRS = Family(
    "chairs",
    {
        "seat_width": (0.7, 1.2),
        "seat_depth": (0.7, 1.1),
        "seat_thickness": (0.1, 0.2),
        "leg_length": (0.25, 0.6),
        "leg_thickness": (0.12, 0.22),
        "back_height": (0.3, 0.75),
        "back_thickness": (0.1, 0.2),
    },
    _chair,
)
