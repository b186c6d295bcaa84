"""Products of two sets of rows over the parameters with each other, from their factors alone.

Over a layer, rows that are sums of outer products e x^T and e' x'^T have the product (e . e') (x . x'), so a product of
P numbers costs those of a layer's inputs and outputs. The two sets may be of one network at two parameters, as where a
basis found before a step is used after it. A weight under weight norm, W = g v / |v| a row, then has with G = df/dW and

    u = v / |v|,   s = g / |v|,   q = G . u,     the row     df/dg = q,   df/dv = s (G - q u)

    q q' + s s' (G . G' - q (u . G') - q' (G . u') + q q' (u . u'))

for the product of two, with each set's own u and s.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.sensitivity.operands import THETA
from implicit.sensitivity.row_factors import BLOCK, GRAM_ROWS, Part, RowFactors, Term, sliced

# A matrix product A B^T with a sign.
Signed = tuple[float, Tensor, Tensor]


def row_products(rows: RowFactors, others: RowFactors) -> Float[Tensor, "r k"]:
    """Return rows[i] . others[j], in float64.

    Args:
        rows: R rows.
        others: K rows over the same parameters, in the same columns; theta may be another.
    """
    columns = rows.columns
    total = torch.zeros(rows.count, others.count, dtype=torch.float64, device=rows.theta.device)
    ours, theirs = ({part.operand: part for part in side.parts} for side in (rows, others))
    explicit: list[list[int]] = [list(cluster) for cluster in columns.clusters]
    for k in ours.keys() & theirs.keys() & columns.alone:
        operand = columns.operands.all[k]
        if operand.repeats:
            explicit.append([k])
        elif ours[k].terms[0][1] is None and operand.base == THETA:
            _add_flat(total, [(1.0, _sum_of_terms(ours[k]), _sum_of_terms(theirs[k]))])
        elif operand.base == THETA:
            _add_outer(total, ours[k].terms, theirs[k].terms)
        elif not _add_normed(total, rows, others, ours[k], theirs[k]):
            explicit.append([k])
    for cluster in explicit:
        _add_explicit(
            total, rows, others, [ours[k] for k in cluster if k in ours], [theirs[k] for k in cluster if k in theirs]
        )
    return total


def _sum_of_terms(part: Part) -> Tensor:
    first, *others = (e for e, _ in part.terms)
    for e in others:
        first = first + e
    return first


def _add_flat(total: Tensor, products: list[Signed]) -> None:
    for sign, a, b in products:
        total.addmm_(a.double(), b.double().T, alpha=sign)


def _add_outer(total: Tensor, terms: list[Term], others: list[Term]) -> None:
    """Add the products of sums of outer products, in blocks that keep two factors in the cache."""
    known: dict[int, Tensor] = {}

    def exact(t: Tensor) -> Tensor:
        return known.setdefault(id(t), t.double())

    room = total.new_empty(2, GRAM_ROWS * total.shape[1])
    for start in range(0, len(total), GRAM_ROWS):
        end = min(len(total), start + GRAM_ROWS)
        a, b = (part[: (end - start) * total.shape[1]].view(end - start, -1) for part in room)
        for e, x in terms:
            for other_e, other_x in others:
                assert x is not None
                assert other_x is not None
                torch.mm(exact(e)[start:end], exact(other_e).T, out=a)
                torch.mm(exact(x)[start:end], exact(other_x).T, out=b)
                total[start:end].addcmul_(a, b)


def _add_normed(total: Tensor, rows: RowFactors, others: RowFactors, ours: Part, theirs: Part) -> bool:
    """Add the products over a weight under weight norm, or return False where it is none, or not by outputs."""
    operand = rows.columns.operands.all[ours.operand]
    norm = rows.columns.operands.derived[operand.base].norm
    if norm is None or ours.terms[0][1] is None:
        return False
    group = norm.group[operand.index]
    if not torch.equal(group[:1].expand(group.shape), group):
        return False
    (u, s), (other_u, other_s) = (norm.parts(side.theta) for side in (rows, others))
    u, s, other_u, other_s = u[operand.index], s[group[0]], other_u[operand.index], other_s[group[0]]
    q, mixed = (_along(ours.terms, unit) for unit in (u, other_u))
    other_mixed, other_q = (_along(theirs.terms, unit) for unit in (u, other_u))
    scaled, other_scaled = ([(e * by, x) for e, x in part.terms] for part, by in ((ours, s), (theirs, other_s)))
    _add_outer(total, scaled, other_scaled)
    cosines = (u * other_u).sum(dim=0)
    _add_flat(
        total,
        [
            (1.0, q, other_q),
            (-1.0, q * s, other_mixed * other_s),
            (-1.0, mixed * s, other_q * other_s),
            (1.0, q * s * cosines, other_q * other_s),
        ],
    )
    return True


def _along(terms: list[Term], units: Tensor) -> Tensor:
    """Return G . u of each output (R, out), of G = sum e x^T."""
    total = torch.zeros_like(terms[0][0])
    for e, x in terms:
        assert x is not None
        total = total + e * (x @ units)
    return total


def _add_explicit(total: Tensor, rows: RowFactors, others: RowFactors, ours: list[Part], theirs: list[Part]) -> None:
    """Add the products of what rows have over some operands, made in blocks."""
    if not ours or not theirs:
        return
    support = rows.columns.support(part.operand for part in [*ours, *theirs])
    step = max(1, BLOCK // rows.columns.parameters)
    for start in range(0, rows.count, step):
        here = _columns(rows, ours, slice(start, start + step), support)
        for other_start in range(0, others.count, step):
            place = slice(other_start, other_start + step)
            total[start : start + step, place].addmm_(here, _columns(others, theirs, place, support).T)


def _columns(rows: RowFactors, parts: list[Part], piece: slice, support: Tensor) -> Tensor:
    """Return a piece of the rows over the support, of some operands."""
    some = [Part(part.operand, [sliced(term, piece) for term in part.terms]) for part in parts]
    made = rows.theta.new_empty(len(some[0].terms[0][0]), rows.columns.parameters)
    rows.columns.write(made, some, rows.theta)
    return made[:, support].double()
