"""Symmetric matrices of which the lower triangle alone is made and read: half the work of full products."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import blas
from torch import Tensor


def add_gram(total: Float[Tensor, "n n"], rows: Float[Tensor, "k n"]) -> None:
    """Add the lower triangle of rows^T rows to the total, in place.

    On the CPU by the symmetric rank-k product of BLAS, half the work of a full one.
    """
    if total.device.type != "cpu" or total.dtype not in (torch.float32, torch.float64):
        total.addmm_(rows.T, rows)
        return
    product = blas.dsyrk if total.dtype == torch.float64 else blas.ssyrk
    # The transposes are Fortran-ordered views; the upper triangle there is the lower one here.
    out = total.numpy().T
    result = product(1.0, rows.contiguous().numpy().T, beta=1.0, c=out, overwrite_c=1)
    if result is not out and not np.shares_memory(result, out):
        out[...] = result


def gram(rows: Float[Tensor, "k n"]) -> Float[Tensor, "k k"]:
    """Return the lower triangle of rows rows^T."""
    total = rows.new_zeros(len(rows), len(rows))
    add_gram(total, rows.T)
    return total


def times(lower: Float[Tensor, "n n"], x: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Return the symmetric matrix with this lower triangle times x."""
    if x.device.type == "cpu" and x.dtype in (torch.float32, torch.float64) and len(x) > 0:
        product = blas.dsymv if x.dtype == torch.float64 else blas.ssymv
        return torch.from_numpy(product(1.0, lower.numpy().T, x.numpy(), lower=0))
    half = lower.tril()
    return half @ x + half.T @ x - lower.diagonal() * x
