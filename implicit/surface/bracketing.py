"""Zeros of a field between two points of different sign, where Newton's method has nothing to go by.

A continuous f with f(a) < 0 <= f(b) is zero somewhere between a and b, whether it has a gradient there or not. The
bracket is narrowed by Chandrupatla's method [Advances in Engineering Software 28, 1997]: inverse quadratic
interpolation where three values allow it, bisection elsewhere, so that it converges superlinearly on smooth fields and
at least halves the bracket every few steps on any. A bracket across which f keeps its difference while its width goes
to nothing holds a jump instead of a zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from implicit.field.field import Field

# Most evaluations: bisection alone takes 40 from a cell to 1e-12 of it; the method can need twice as many.
MOST_EVALUATIONS = 100

# Share of the difference of f over the first bracket that is left over the last where f jumps, and by how much the
# bracket must have been narrowed to tell: a field as steep as this says is a jump in the precision at hand.
JUMP = 0.1
NARROWED = 100.0

# Of so few brackets one look at the ends of so many parts costs no more than one at a single place.
FEW = 64
PARTS = 16


@dataclass(frozen=True, eq=False)
class Zeros:
    """Changes of the sign of f, one on each of some segments.

    Attributes:
        points: The end of the last bracket with the smaller |f|, (N, D).
        jumps: True where f jumps over zero there instead of passing through it.
    """

    points: Float[Tensor, "n d"]
    jumps: Bool[Tensor, " n"]


def bracketed_zeros(
    field: Field,
    start: Float[Tensor, "n d"],
    end: Float[Tensor, "n d"],
    at_start: Float[Tensor, " n"],
    at_end: Float[Tensor, " n"],
    tolerance: float,
) -> Zeros:
    """Return a zero of f on each segment.

    Args:
        field: The field.
        start: First ends of the segments (N, D).
        end: Their other ends.
        at_start: f at the first ends, (N,).
        at_end: f at the other ends, of the other sign: one below zero, the other not.
        tolerance: Width at which a bracket has been narrowed enough, a length.
    """
    along = end - start
    length = along.norm(dim=1)
    share = tolerance / length.clamp(min=tolerance)
    eps = torch.finfo(start.dtype).eps
    # a is the newest place on the segment, b the other end of the bracket, c the one left before; from 0 to 1.
    a, b = torch.zeros_like(length), torch.ones_like(length)
    fa, fb = at_start.clone(), at_end.clone()
    if 0 < len(start) <= FEW:
        a, b, fa, fb = _cut(field, start, along, fa, fb)
    c, fc = a.clone(), fa.clone()
    first = (at_end - at_start).abs()
    # The secant first: piecewise linear fields have their zero there more often than not.
    t = (fa / (fa - fb)).nan_to_num(nan=0.5).clamp(0.05, 0.95)
    going = torch.arange(len(start), device=start.device)
    for _ in range(MOST_EVALUATIONS):
        going = going[~_narrow(a, b, fa, fb, share, eps, going)]
        if len(going) == 0:
            break
        ga, gb, ha, hb = a[going], b[going], fa[going], fb[going]
        x = ga + t[going] * (gb - ga)
        f = field.value(start[going] + x[:, None] * along[going])
        same = (f < 0) == (ha < 0)
        c[going], fc[going] = torch.where(same, ga, gb), torch.where(same, ha, hb)
        b[going], fb[going] = torch.where(same, gb, ga), torch.where(same, hb, ha)
        a[going], fa[going] = x, f
        t[going] = _next(a[going], b[going], c[going], fa[going], fb[going], fc[going], share[going] / 2 + eps)
    at = torch.where(fb.abs() < fa.abs(), b, a)
    left = torch.where(torch.minimum(fa.abs(), fb.abs()) == 0, torch.zeros_like(first), (fa - fb).abs())
    told = (b - a).abs() * NARROWED <= 1
    return Zeros(start + at[:, None] * along, told & (left > JUMP * first))


def _cut(
    field: Field, start: Float[Tensor, "n d"], along: Float[Tensor, "n d"], at_start: Tensor, at_end: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the ends of the first of some parts of each segment over which f changes its sign, and f there."""
    shares = torch.linspace(0, 1, PARTS + 1, dtype=start.dtype, device=start.device)
    inner = start[:, None] + shares[1:-1, None] * along[:, None]
    found = field.value(inner.flatten(0, 1)).view(len(start), -1)
    values = torch.cat([at_start[:, None], found, at_end[:, None]], dim=1)
    other = (values < 0) != (at_start < 0)[:, None]
    last = other.int().argmax(dim=1)
    at_both = values.gather(1, torch.stack([last - 1, last], dim=1))
    return shares[last - 1], shares[last], at_both[:, 0], at_both[:, 1]


def _narrow(
    a: Tensor, b: Tensor, fa: Tensor, fb: Tensor, share: Tensor, eps: float, going: Tensor
) -> Bool[Tensor, " g"]:
    """Return True for each bracket that need not be narrowed further."""
    a, b, fa, fb, share = (x[going] for x in (a, b, fa, fb, share))
    return ((b - a).abs() <= share + 2 * eps) | (torch.minimum(fa.abs(), fb.abs()) == 0)


def _next(a: Tensor, b: Tensor, c: Tensor, fa: Tensor, fb: Tensor, fc: Tensor, least: Tensor) -> Float[Tensor, " g"]:
    """Return where in the bracket, from a (0) to b (1), to look next."""
    xi = (a - b) / (c - b)
    phi = (fa - fb) / (fc - fb)
    # Inverse quadratic interpolation stays within the bracket under Chandrupatla's two conditions.
    interpolable = (phi * phi < xi) & ((1 - phi) ** 2 < 1 - xi)
    inverse = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
    t = torch.where(interpolable & torch.isfinite(inverse), inverse, torch.full_like(a, 0.5))
    margin = (least / (b - a).abs()).clamp(max=0.5)
    return torch.minimum(torch.maximum(t, margin), 1 - margin)
