"""The cases that are run where none are named: a bump, smoothing and a pull."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import OPERATIONS, Case, HandleSpec, Operation

# Settings of default_cases. Three rigid steps: on spot and cactus, five leave 11 and 15 % more energy for 1.6 times the
# time, as each adds its own ripples, and bring the handles from 0.6 % of the pull to 0.5 %.
FULL: dict[Operation, dict[str, Any]] = {
    "geometric": {},
    "smooth": {"steps": 8, "step_size": 1e-3, "implicit": {"points": 2000}},
    "rigid": {"implicit": {"steps": 3, "points": 2000}},
}
QUICK: dict[Operation, dict[str, Any]] = {
    "geometric": {"implicit": {"parts": 4, "points": 1000}},
    "smooth": {"steps": 4, "step_size": 1e-3, "implicit": {"points": 1000, "resolution": 32}},
    "rigid": {"implicit": {"steps": 3, "points": 1000}},
}
QUICK_SIZE = {"vertices": 1200, "resolution": 48}
QUICK_FIT = {"steps": 600}  # for a shape given as a mesh


def default_cases(
    shape: str,
    V: Float[ndarray, "n 3"],
    N: Float[ndarray, "n 3"],
    *,
    operations: Sequence[Operation] = OPERATIONS,
    quick: bool = False,
    fit: Mapping[str, Any] | None = None,
    **settings: Any,
) -> list[Case]:
    """The operations on any shape, with handles found from its surface.

    - geometric: a smooth bump, 6 % of the longest side high, in the middle of a flank; the rest is to stay.
    - smooth: mean-curvature flow that keeps the volume.
    - rigid: along the longest side, the lowest 12 % are held and the uppermost 12 % moved sideways by 15 %.

    Args:
        shape: As for Case.
        V: Points on its surface in the field's coordinates, evenly spread.
        N: Outward unit normals there.
        operations: Which of them, in this order.
        quick: Whether to spend little: fewer points and steps, for a first look and not for figures.
        fit: Options of the fit, for a shape given as a mesh.
        settings: Further arguments of Case: vertices, resolution, seed.
    """
    for name, array in (("V", V), ("N", N)):
        if not isinstance(array, ndarray) or array.dtype.kind != "f" or array.shape != (len(V), 3) or len(V) == 0:
            raise TypeError(f"{name} must be an array (n, 3) of real numbers, a row a point, but is {array!r:.200}.")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, but holds NaN or infinite numbers. Take out those points.")
    if not isinstance(operations, list | tuple) or not set(operations) <= set(OPERATIONS):
        raise ValueError(f"operations must be a list of {', '.join(OPERATIONS)}, but are {operations!r}.")
    lower, upper = V.min(axis=0), V.max(axis=0)
    sides = upper - lower
    up = int(np.argmax(sides))
    across = int(np.argmin(sides))
    size = float(sides[up])

    def case(operation: Operation, *handles: HandleSpec) -> Case:
        parameters = {**(QUICK if quick else FULL)[operation], **({"fit": dict(fit)} if fit else {})}
        return Case(shape, operation, handles, parameters, **settings)

    def bump() -> Case:
        center = _rounded(V[_flank(V, N, across)])
        region = {"kind": "ball", "center": center, "radius": round(0.04 * size, 6), "falloff": round(0.24 * size, 6)}
        return case("geometric", HandleSpec(region, {"kind": "along", "distance": round(0.06 * size, 6)}))

    def flow() -> Case:
        return case("smooth")

    def pull() -> Case:
        end = np.zeros(3)
        end[up] = 1.0
        low, high = lower.copy(), upper.copy()
        low[up] += 0.12 * size
        high[up] -= 0.12 * size
        shift = np.zeros(3)
        shift[across] = 0.15 * size
        held = HandleSpec(
            {"kind": "halfspace", "point": _rounded(low), "normal": _rounded(-end)},
            {"kind": "vector", "vector": [0.0, 0.0, 0.0]},
        )
        moved = HandleSpec(
            {"kind": "halfspace", "point": _rounded(high), "normal": _rounded(end)},
            {"kind": "vector", "vector": _rounded(shift)},
        )
        return case("rigid", held, moved)

    make = {"geometric": bump, "smooth": flow, "rigid": pull}
    return [make[operation]() for operation in operations]


def _flank(V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"], across: int) -> int:
    """The vertex nearest the middle of the side that faces along the thinnest axis."""
    facing = np.flatnonzero(N[:, across] > 0.8)
    if facing.size == 0:  # no part of the surface faces that way, e.g. a coarse mesh of a knife's edge
        return int(np.argmax(V[:, across]))
    offset = V[facing] - V.mean(axis=0)
    offset[:, across] *= 0.1  # the middle as seen from that side; between sheets, the outer one is not favoured
    return int(facing[np.argmin((offset**2).sum(axis=1))])


def _rounded(point: ndarray) -> list[float]:
    return [round(float(x), 6) + 0.0 for x in point]
