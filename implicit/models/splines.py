"""Uniform B-splines of degree 1, 2 or 3 on a box, as nodes and weights: each point sees a few nodes near it.

    f(x) = sum_k w_k(u) c[k],    u = cells (x - lower) / (upper - lower),    w(u) = prod_axes B_p(u_axis - k_axis)

Along an axis of m cells a spline of degree p has m + p coefficients; coefficient k has its peak at u = k - (p - 1) / 2.
Polynomials of degree p are reproduced exactly. Outside the box each border cell's polynomial goes on. The weights are
polynomials of the points and the nodes are looked up by index, so that everything is differentiable as often as the
spline is, forward and backward, and under vmap. (torch's own grid_sample has no second derivative.)

Source: de Boor, "A Practical Guide to Splines", 1978, chapter IX, on uniform knots.
"""

from __future__ import annotations

from itertools import product

import torch
from jaxtyping import Float, Int
from torch import Tensor


def stencil(u: Float[Tensor, "n d"], cells: int, degree: int) -> tuple[Int[Tensor, "n k d"], Float[Tensor, "n k"]]:
    """Return the nodes that act at each point, one number an axis, and their weights, K = (degree + 1)^D of them.

    Args:
        u: Points in units of a cell, 0 to `cells` within the box.
        cells: Cells along each axis.
        degree: Of the spline, 1, 2 or 3.
    """
    first = u.detach().floor().clamp(0, cells - 1)
    along = _weights(u - first, degree)
    offsets = torch.tensor(list(product(range(degree + 1), repeat=u.shape[1])), device=u.device)
    weights = torch.ones_like(u[:, :1])
    for axis in range(u.shape[1]):
        weights = weights * along[:, axis][:, offsets[:, axis]]
    return first.long()[:, None, :] + offsets, weights


def _weights(t: Float[Tensor, "n d"], degree: int) -> Float[Tensor, "n d p"]:
    """Return the weights of the degree + 1 nodes of a cell at the place t in it, 0 to 1."""
    s = 1 - t
    if degree == 1:
        parts = [s, t]
    elif degree == 2:
        parts = [s * s / 2, 0.5 + t * s, t * t / 2]
    else:
        parts = [s**3 / 6, (4 - 6 * t**2 + 3 * t**3) / 6, (4 - 6 * s**2 + 3 * s**3) / 6, t**3 / 6]
    return torch.stack(parts, dim=-1)


def peaks(cells: int, degree: int, dimension: int) -> Float[Tensor, "m d"]:
    """Return where each coefficient has its peak, in units of a cell, in the order of `flat_index` (M, D)."""
    along = torch.arange(cells + degree, dtype=torch.float64) - (degree - 1) / 2
    return torch.cartesian_prod(*[along] * dimension).reshape(-1, dimension)


def flat_index(nodes: Int[Tensor, "*n d"], side: int) -> Int[Tensor, "*n"]:
    """Return the place of nodes in a table of side^D of them, the last axis fastest."""
    index = nodes[..., 0]
    for axis in range(1, nodes.shape[-1]):
        index = index * side + nodes[..., axis]
    return index
