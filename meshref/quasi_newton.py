"""Quasi-Newton directions: a preconditioner that learns from the steps taken.

With g the gradient, P a positive definite matrix that is easy to solve with, and s, y the last steps and what they
changed in g, the inverse of the Hessian is estimated by P^-1 corrected so that it takes each y to its s (limited-memory
BFGS, by the two loops of Nocedal 1980). The first direction is -P^-1 g. Every direction goes downhill, for only steps
with s . y > 0 are learned from.
Sources: Nocedal and Wright, Numerical Optimization, 2006, section 7.2; Liu, Bouaziz, Kavan 2017 (P a Laplacian).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from meshref.topology import FloatArray

# Least cosine between a step and its change of gradient that is learned from.
LEAST_CURVATURE = 1e-12


class _Lesson(NamedTuple):
    step: FloatArray
    change: FloatArray  # of the gradient
    preconditioned: FloatArray  # P^-1 change
    curvature: float  # step . change


class QuasiNewton:
    """The last steps of one minimisation."""

    def __init__(self, window: int) -> None:
        """Begin with none.

        Args:
            window: Most steps to learn from, at least 1.
        """
        self._window = window
        self._lessons: list[_Lesson] = []

    def forget(self) -> None:
        """Begin anew."""
        self._lessons = []

    def learn(self, step: FloatArray, change: FloatArray, preconditioned: FloatArray) -> None:
        """Learn from a step.

        Args:
            step: s, of any shape.
            change: y, of the gradient along it.
            preconditioned: P^-1 y.
        """
        curvature = float(np.vdot(step, change))
        if curvature > LEAST_CURVATURE * np.linalg.norm(step) * np.linalg.norm(change):
            self._lessons = [*self._lessons, _Lesson(step, change, preconditioned, curvature)][-self._window :]

    def direction(self, gradient: FloatArray, preconditioned: FloatArray) -> FloatArray:
        """Return the direction to go.

        Args:
            gradient: g, of any shape.
            preconditioned: P^-1 g.
        """
        left, result, parts = gradient, preconditioned, []
        for lesson in reversed(self._lessons):
            part = float(np.vdot(lesson.step, left)) / lesson.curvature
            left = left - part * lesson.change
            result = result - part * lesson.preconditioned  # P^-1 of what is left
            parts.append(part)
        for lesson, part in zip(self._lessons, reversed(parts), strict=True):
            result = result + (part - float(np.vdot(lesson.change, result)) / lesson.curvature) * lesson.step
        return -result
