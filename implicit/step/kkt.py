"""Linear constraints by their multipliers: the KKT system, with the unknowns eliminated first.

[ H   C^T ] [  x ]   [ 0 ]
[ C    0  ] [ -m ] = [ r ]     so     (C H^-1 C^T) m = r,    x = H^-1 C^T m
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.step.factors import Factor

# Smallest eigenvalue of C H^-1 C^T that counts, relative to its largest: below it constraints say the same.
SMALLEST = 1e-13


def least_change(factor: Factor, C: Float[Tensor, "m n"], r: Float[Tensor, " m"]) -> tuple[Float[Tensor, " n"], bool]:
    """Return the x with C x = r that is shortest in the metric H of the factor, and whether C was rank deficient.

    Redundant or contradictory constraints are met in the least-squares sense. All is in float64.
    """
    if len(r) == 0:
        return C.new_zeros(C.shape[1]), False
    # Scaling each constraint to unit length makes the test for rank independent of its units.
    length = C.norm(dim=1)
    live = length > 0
    if not bool(live.any()):
        return C.new_zeros(C.shape[1]), True
    unit, target = C[live] / length[live, None], r[live] / length[live]
    lifted = factor.inverse(unit.T)
    schur = unit @ lifted
    values, vectors = torch.linalg.eigh((schur + schur.T) / 2)
    keep = values > SMALLEST * values.max()

    def met(gap: Tensor) -> Tensor:
        return lifted @ (vectors[:, keep] @ ((vectors[:, keep].T @ gap) / values[keep]))

    x = met(target)
    # One refinement takes out the rounding of the first solve.
    x = x + met(target - unit @ x)
    return x, not bool(keep.all() and live.all())
