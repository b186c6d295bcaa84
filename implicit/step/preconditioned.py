"""Directions of descent that learn from the steps taken, beside a linear system that is nearly the Hessian.

With g the gradient, P a positive definite matrix with a factor at hand, and s, y the last steps and what each changed
in g, the inverse of the Hessian is taken for P^-1 corrected so that it takes each y to its s: BFGS of limited memory,
by the two loops of Nocedal 1980 [Nocedal and Wright, Numerical Optimization, 2006, algorithm 7.4; with a Laplacian for
P, Liu, Bouaziz, Kavan 2017]. P^-1 is linear, so the caller gives P^-1 g and P^-1 y, and no system is solved here.

Only steps along which the slope rises, s . y > 0, are learned from, so that every direction goes downhill.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from implicit.sensitivity.weak_curvature import FloatArray

# Least cosine of the angle between a step and its change of the gradient.
LEAST_COSINE = 1e-12


@dataclass(frozen=True, eq=False)
class _Pair:
    """A step s, the change y of the gradient along it, and P^-1 y."""

    step: FloatArray
    change: FloatArray
    solved: FloatArray
    product: float  # s . y


class Descent:
    """Memory of one minimisation.

    Args:
        window: How many of the last steps are kept.
    """

    def __init__(self, window: int) -> None:
        self._pairs: deque[_Pair] = deque(maxlen=window)

    def forget(self) -> None:
        """Begin anew, with P alone."""
        self._pairs.clear()

    def learn(self, step: FloatArray, change: FloatArray, solved: FloatArray) -> None:
        """Take in a step, what it changed in the gradient, and P^-1 of that; all of one shape."""
        product = float(np.vdot(step, change))
        if product > LEAST_COSINE * float(np.linalg.norm(step) * np.linalg.norm(change)):
            self._pairs.append(_Pair(step, change, solved, product))

    def direction(self, gradient: FloatArray, solved: FloatArray) -> FloatArray:
        """Return the way to go, of a gradient g and P^-1 g."""
        shares: list[float] = []
        for pair in reversed(self._pairs):
            share = float(np.vdot(pair.step, gradient)) / pair.product
            gradient, solved = gradient - share * pair.change, solved - share * pair.solved
            shares.append(share)
        for pair, share in zip(self._pairs, reversed(shares), strict=True):
            solved = solved + (share - float(np.vdot(pair.change, solved)) / pair.product) * pair.step
        return -solved
