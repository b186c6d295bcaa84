"""Trust in a linear step: its damping grows until the surface goes where the step says.

The damping is relative to the trace of the normal matrix and adapted as by Levenberg and Marquardt:

    error = rms(achieved - predicted motion) / allowed      > 1: damping * sqrt(10), and another try
                                                            < 0.3: damping / sqrt(10) for the next step
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

# Part of the points left out of the error, those with the largest: where two sheets come close, or a piece vanishes,
# the achieved motion of a few points means nothing, and no damping mends that.
OUTLIERS = 0.02

# Tries of one step: the last has 10^7.5 times the damping of the first.
TRIES = 16

FACTOR = 10**0.5
EASY = 0.3


@dataclass(frozen=True)
class AdaptiveDamping:
    """The damping, from one try and one step to the next (Levenberg-Marquardt).

    Attributes:
        floor: Least damping that the precision of the normal matrix carries.
        value: Damping to try next; None before the first step.
    """

    floor: float = 1e-13
    value: float | None = None

    @classmethod
    def of_precision(cls, dtype: torch.dtype) -> AdaptiveDamping:
        """Return the start of an edit. Rounding in the normal matrix is about the precision times its trace."""
        return cls(1e-13 if dtype == torch.float64 else 1e-7)

    def start(self, first: float, floor: float | None = None) -> AdaptiveDamping:
        """Return the damping of a step's first try: the last step's, or in the first step `first`.

        Args:
            first: Where it begins.
            floor: Least damping from here on; None leaves what it was.
        """
        floor = self.floor if floor is None else floor
        return replace(self, floor=floor, value=max(first if self.value is None else self.value, floor))

    def increase(self) -> AdaptiveDamping:
        """Return the damping after a try that missed its prediction by too much."""
        return replace(self, value=self.current * FACTOR)

    def accept(self, error: float, least: float) -> AdaptiveDamping:
        """Return the damping after an accepted try.

        Args:
            error: Linearisation error of the try over what is allowed.
            least: What the damping may fall to.
        """
        return replace(self, value=max(self.current / FACTOR, self.floor, least)) if error < EASY else self

    @property
    def current(self) -> float:
        """Damping to try next.

        Raises:
            ValueError: There is none before the first `start`.
        """
        if self.value is None:
            raise ValueError("The damping has no value before start(first).")
        return self.value


@dataclass(frozen=True)
class LinearisationError:
    """Distance by which points missed their predicted motion.

    Attributes:
        missed: Root mean square of achieved minus predicted motion, less the outliers, a length; infinite if no point
            arrived.
        size: Root mean square of the predicted motion, a length.
    """

    missed: float
    size: float

    @property
    def relative(self) -> float:
        """Missed over predicted motion."""
        return self.missed / max(self.size, 1e-300)


def linearisation_error(
    predicted: Float[Tensor, "n d"], achieved: Float[Tensor, "n d"], arrived: Tensor
) -> LinearisationError:
    """Return how far points missed their predicted motion.

    Args:
        predicted, achieved: Motions, lengths.
        arrived: Which points reached the moved surface (N,) bool; the others do not count.
    """
    if not bool(arrived.any()):
        return LinearisationError(float("inf"), 0.0)
    squares = (achieved - predicted)[arrived].square().sum(dim=1).sort().values
    kept = squares[: max(1, round(len(squares) * (1 - OUTLIERS)))]
    return LinearisationError(float(kept.mean().sqrt()), float(predicted[arrived].square().sum(dim=1).mean().sqrt()))
