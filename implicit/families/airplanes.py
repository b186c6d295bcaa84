"""Airplanes: a fuselage with its nose at +z, swept wings, a tailplane and a fin."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from implicit.families.family import Family
from implicit.families.solids import Length, capsule, length, polygon, product, slab, union

THICKNESS = 0.1  # of wings, tailplane and fin
EDGE = 0.02  # radius of their edges
TAIL_CHORD = 0.2


def _airplane(p: Mapping[str, Tensor], x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    nose = p["fuselage_length"] / 2
    body = capsule(length(x, y), z, -nose, nose, p["fuselage_radius"])
    wing = _blade(
        x.abs(), z, y, span=p["wing_span"] / 2, chord=p["wing_chord"], sweep=p["wing_sweep"], front=p["wing_front"]
    )
    stern = TAIL_CHORD - nose
    tail = _blade(x.abs(), z, y, span=p["tail_span"] / 2, chord=TAIL_CHORD, sweep=0.3 * p["wing_sweep"], front=stern)
    fin = _blade(y, z, x, span=p["fin_height"], chord=TAIL_CHORD, sweep=0.3 * p["wing_sweep"], front=stern)
    return union(body, wing, tail, fin)


def _blade(
    out: Tensor, along: Tensor, across: Tensor, *, span: Tensor, chord: Tensor | float, sweep: Tensor, front: Tensor
) -> Tensor:
    """A slab over a parallelogram: from the middle of the fuselage out to the span, its tip swept back."""
    rear = front - chord
    tip = span - EDGE
    corners: list[tuple[Length, Length]] = [
        (0.0, rear + EDGE),
        (tip, rear - sweep + EDGE),
        (tip, front - sweep - EDGE),
        (0.0, front - EDGE),
    ]
    half = THICKNESS / 2 - EDGE
    return product(polygon(out, along, corners), slab(across, -half, half)) - EDGE


AIRPLANES = Family(
    "airplanes",
    {
        "fuselage_length": (1.1, 1.6),
        "fuselage_radius": (0.1, 0.17),
        "wing_span": (0.9, 1.6),
        "wing_chord": (0.22, 0.42),
        "wing_sweep": (0.0, 0.3),
        "wing_front": (0.1, 0.3),
        "tail_span": (0.45, 0.8),
        "fin_height": (0.25, 0.5),
    },
    _airplane,
)
