"""The trace of an operator from its products: Hutchinson's estimate, the mean of z^T M z over random signs z."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

EXACT = 256  # unknowns up to which the whole operator costs little


def random_signs(n: int, count: int, seed: int) -> Float[Tensor, "n count"]:
    """Return so many columns of n random signs."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 2, (n, count), generator=generator).double() * 2 - 1


def estimated_trace(n: int, apply: Callable[[Tensor], Tensor], like: Tensor, seed: int) -> float:
    """Return the trace of an operator on n numbers: exactly up to EXACT of them, else to a few times its root.

    Args:
        apply: Product of the operator with columns (n, m).
        like: A tensor whose dtype and device they have.
        seed: Seed of the random signs.
    """
    if n <= EXACT:
        return float(apply(torch.eye(n).to(like)).diagonal().sum())
    z = random_signs(n, 8, seed).to(like)
    return float((z * apply(z)).sum() / z.shape[1])
