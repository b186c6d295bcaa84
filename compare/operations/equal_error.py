"""Handles of a mesh held by springs, as stiff as leaves them as far from their targets as another editor's are.

A field cannot place its handles exactly, and a handle that lags costs less energy, so that energies are to be compared
at equal error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.subject import Subject
from compare.operations.operation import Target

T = TypeVar("T")

# How near the two errors are brought, relative; how often a stiffness is tried; and the softest and stiffest springs,
# per squared length and area of the surface.
SAME = 0.01
TRIES = 20
SPRINGS = (1e0, 1e9)


def handle_miss(subject: Subject, target: Target, displacement: Float[ndarray, "n 3"]) -> float:
    """Return the rms over the area of the distances of the handles from their targets, over the largest displacement.

    Args:
        subject: The common mesh.
        target: What the handles say.
        displacement: Of the vertices.
    """
    import meshref

    at, weights = target.at, meshref.vertex_areas(subject.V, subject.F)
    missed = ((displacement - target.displacement)[at] ** 2).sum(axis=1)
    return float(np.sqrt(np.average(missed, weights=weights[at]))) / target.largest


def at_equal_error(solve: Callable[[float], T], missed: Callable[[T], float], wanted: float) -> tuple[T, float] | None:
    """Return the result of the stiffness that leaves the handles as far off as wanted, and the stiffness.

    Args:
        solve: From the stiffness of the springs to a result.
        missed: From a result to the error of its handles, which falls as the stiffness rises.
        wanted: The error.

    Returns:
        None where no stiffness between the softest and the stiffest leaves that error.
    """
    if not wanted > 0:
        return None
    softest, stiffest = np.log(SPRINGS)
    at = np.log(1e5)
    for _ in range(TRIES):
        result = solve(float(np.exp(at)))
        gap = float(np.log(missed(result) / wanted))
        if abs(gap) <= SAME:
            return result, float(np.exp(at))
        # Too far off is too soft; the error is one over the stiffness where that is high, and changes less elsewhere.
        softest, stiffest = (at, stiffest) if gap > 0 else (softest, at)
        step = at + gap
        at = step if softest < step < stiffest else (softest + stiffest) / 2
        if stiffest - softest < 1e-3:
            return None
    return None
