"""How far a linear step is to be trusted: its damping grows until the surface goes where the step says.

The damping is relative to the trace of the normal matrix and adapted as by Levenberg and Marquardt. What decides is the
miss, achieved minus predicted motion of a set of points.
"""

from __future__ import annotations

import torch
from torch import Tensor

# Part of the points left out of the miss, those with the largest: where two sheets come close, or a piece vanishes,
# the achieved motion of a few points means nothing, and no damping mends that.
OUTLIERS = 0.02


class Trust:
    """The damping, from one step to the next."""

    tries = 16

    def __init__(self, dtype: torch.dtype) -> None:
        # Rounding in the normal matrix itself is about the precision times its trace.
        self._least = 1e-13 if dtype == torch.float64 else 1e-7
        self.damping: float | None = None

    def begin(self, damping: float) -> float:
        """The damping to try first: the last step's, or where the operation begins."""
        self.damping = max(damping if self.damping is None else self.damping, self._least)
        return self.damping

    def raise_damping(self) -> float:
        """After a try whose nonlinear part was too large."""
        assert self.damping is not None
        self.damping *= 10**0.5
        return self.damping

    def after(self, ratio: float, least: float) -> None:
        """After a good try, with the ratio of its nonlinear part to what is allowed."""
        assert self.damping is not None
        if ratio < 0.3:
            self.damping = max(self.damping / 10**0.5, self._least, least)


def miss(way: Tensor, achieved: Tensor, arrived: Tensor) -> tuple[float, float]:
    """Root mean squares of achieved minus predicted motion, less the outliers, and of the predicted one."""
    if not bool(arrived.any()):
        return float("inf"), 0.0
    squares = (achieved - way)[arrived].square().sum(dim=1).sort().values
    kept = squares[: max(1, round(len(squares) * (1 - OUTLIERS)))]
    return float(kept.mean().sqrt()), float(way[arrived].square().sum(dim=1).mean().sqrt())
