"""Rows over the parameters, r_i = sum_l vec(sum_t e_il,t x_il,t^T), kept as their factors.

At one point a row df/dtheta is one outer product a layer, and a derivative of it in space two, so that the products of
rows with each other need no P numbers a row:

    r_i . r_j = sum_l sum_t sum_s (e_il,t . e_jl,s) (x_il,t . x_jl,s)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.sensitivity.operands import CONSTANT, THETA, Operands

# Rows of a Gram matrix made at once.
GRAM_ROWS = 256

# Numbers of the rows of parameters that are no plain matrices, made at once for a Gram matrix.
BLOCK = 32_000_000

Term = tuple[Tensor, Tensor | None]  # e and x; None: the row is e itself


@dataclass(frozen=True, eq=False)
class Part:
    """The part of rows over one operand: the sum of its terms."""

    operand: int
    terms: list[Term]


class Columns:
    """Places of a function's operands in theta, and which of them share entries.

    Args:
        operands: Of the function.
        parameters: P.
    """

    def __init__(self, operands: Operands, parameters: int) -> None:
        self.operands, self.parameters = operands, parameters
        supports = {k: operands.support(k) for k in sorted(operands.used) if operands.all[k].base != CONSTANT}
        counts = torch.zeros(parameters, dtype=torch.long, device=operands.device)
        for support in supports.values():
            counts.index_add_(0, support, torch.ones_like(support))
        # Operands whose entries of theta nothing else has; the others stand together where they share entries.
        self.alone = {k for k, support in supports.items() if bool((counts[support] == 1).all())}
        self.clusters = _clusters({k: s for k, s in supports.items() if k not in self.alone}, parameters)
        self._supports = supports
        # Columns that are not written at once are cleared first, in runs.
        written = [supports[k] for k in self.alone if operands.all[k].base == THETA]
        left = torch.ones(parameters, dtype=torch.bool)
        for support in written:
            left[support.cpu()] = False
        ends = torch.nn.functional.pad(left.int(), (1, 1)).diff().nonzero()[:, 0].tolist()
        self._cleared = [slice(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True)]

    def support(self, operands: Iterable[int]) -> Tensor:
        """The entries of theta that the operands depend on, each once."""
        return torch.cat([self._supports[k] for k in operands]).unique()

    def write(self, rows: Float[Tensor, "n p"], parts: Iterable[Part], theta: Tensor) -> None:
        """Put rows into a matrix, whose memory may be part of a larger one."""
        for run in self._cleared:
            rows[:, run] = 0
        left = set(self.alone)
        for part in parts:
            self._write(rows, part, theta)
            left.discard(part.operand)
        for k in left:  # on the way, but without influence here
            if self.operands.all[k].base == THETA:
                rows[:, self._supports[k]] = 0

    def _write(self, rows: Tensor, part: Part, theta: Tensor) -> None:
        operand = self.operands.all[part.operand]
        n, index = len(rows), operand.index
        if part.operand in self.alone and operand.base == THETA and operand.strided is not None:
            offset, strides = operand.strided
            offset += int(rows.storage_offset())
            if part.terms[0][1] is None:
                _put(rows.as_strided((n, *index.shape), (rows.stride(0), *strides), offset), part.terms)
                return
            # In the order of the memory: (in, out), or (out, in).
            forth = strides[1] <= strides[0]
            place = (*index.shape, *strides) if forth else (*index.T.shape, *strides[::-1])
            block = rows.as_strided((n, *place[:2]), (rows.stride(0), *place[2:]), offset)
            _put(block, part.terms, first_is_x=forth)
            return
        block = rows.new_empty(n, *index.shape)
        _put(block, part.terms)
        if operand.base == THETA:
            rows.index_add_(1, index.flatten(), block.flatten(1))
            return
        derived = self.operands.derived[operand.base]
        whole = rows.new_zeros(n, derived.size).index_add_(1, index.flatten(), block.flatten(1))
        rows.index_add_(1, derived.support, derived.back(theta, whole))


def _put(block: Tensor, terms: Sequence[Term], first_is_x: bool = True) -> None:
    """The sum of the terms into a block (N, in, out), or (N, out, in)."""
    for k, (e, x) in enumerate(terms):
        if x is None:
            block.copy_(e.view(block.shape)) if k == 0 else block.add_(e.view(block.shape))
            continue
        a, b = (x, e) if first_is_x else (e, x)
        if k == 0:
            torch.mul(a[:, :, None], b[:, None, :], out=block)
        else:
            block.addcmul_(a[:, :, None], b[:, None, :])


@dataclass(frozen=True, eq=False)
class RowFactors:
    """R rows over the parameters, by their factors.

    Args:
        columns: Where the parameters are.
        theta: The parameters themselves, (P,).
        parts: By operand; what none has is zero.
        count: R.
    """

    columns: Columns
    theta: Tensor
    parts: list[Part]
    count: int

    def rows(self) -> Float[Tensor, "r p"]:
        """The rows themselves."""
        rows = self.theta.new_empty(self.count, self.columns.parameters)
        self.columns.write(rows, self.parts, self.theta)
        return rows

    def scaled(self, scale: Float[Tensor, " r"]) -> RowFactors:
        """Each row times a number."""
        known: dict[int, Tensor] = {}  # so that what was one tensor stays one, see _folded
        parts = [
            Part(part.operand, [(known.setdefault(id(e), e * scale[:, None]), x) for e, x in part.terms])
            for part in self.parts
        ]
        return RowFactors(self.columns, self.theta, parts, self.count)

    def plus(self, other: RowFactors) -> RowFactors:
        """Each row plus one of others of the same field."""
        terms = {part.operand: list(part.terms) for part in self.parts}
        for part in other.parts:
            terms.setdefault(part.operand, []).extend(part.terms)
        return RowFactors(self.columns, self.theta, [Part(k, t) for k, t in terms.items()], self.count)

    def times(self, d_theta: Float[Tensor, " p"]) -> Float[Tensor, " r"]:
        """The rows times a change of the parameters."""
        total = self.theta.new_zeros(self.count)
        along = self.columns.operands.directional(self.theta, d_theta)
        for part in self.parts:
            v = along[part.operand]
            assert v is not None
            for e, x in part.terms:
                total += e @ v if x is None else ((x @ v) * e).sum(dim=1)
        return total

    def transposed_times(self, weights: Float[Tensor, " r"]) -> Float[Tensor, " p"]:
        """The weighted sum of the rows."""
        total = torch.zeros_like(self.theta)
        operands = self.columns.operands
        for part in self.parts:
            operand = operands.all[part.operand]
            share = torch.zeros_like(operand.index, dtype=total.dtype)
            for e, x in part.terms:
                share += weights @ e if x is None else (x * weights[:, None]).T @ e
            if operand.base == THETA:
                if operand.strided is not None and not operand.repeats:
                    operand.of(total).add_(share)
                else:
                    total.index_add_(0, operand.index.flatten(), share.flatten())
                continue
            whole = total.new_zeros(operands.derived[operand.base].size)
            whole.index_add_(0, operand.index.flatten(), share.flatten())
            derived = operands.derived[operand.base]
            total.index_add_(0, derived.support, derived.back(self.theta, whole[None])[0])
        return total

    def gram(self, dtype: torch.dtype = torch.float64) -> Float[Tensor, "r r"]:
        """Lower triangle of the products of the rows with each other, in float64 or, where that will do, in float32.

        Matrices of parameters cost as many numbers a row as they have rows and columns, not as they have entries.
        """
        total = torch.zeros(self.count, self.count, dtype=dtype, device=self.theta.device)
        matrices, flat, rest = [], [], {}
        for part in _folded(self.parts, self.columns):
            kernel = self._kernel(part)
            if kernel is None:
                rest[part.operand] = part
            else:
                matrices += kernel[0]
                flat += kernel[1]
        _add_products(total, matrices, flat)
        for cluster in [*self.columns.clusters, *([k] for k in rest if k in self.columns.alone)]:
            self._add_rows(total, [rest[k] for k in cluster if k in rest])
        return total

    def _kernel(self, part: Part) -> tuple[list[list[Term]], list[tuple[float, Tensor]]] | None:
        """The products of a part as those of factors of matrices, and of numbers (R, m) with a sign; None: neither."""
        operand = self.columns.operands.all[part.operand]
        if part.operand not in self.columns.alone or operand.repeats:
            return None
        if operand.base == THETA:
            if part.terms[0][1] is None:
                return [], [(1.0, _sum(e for e, _ in part.terms))]
            return [part.terms], []
        norm = self.columns.operands.derived[operand.base].norm
        if norm is None or part.terms[0][1] is None:
            return None
        group = norm.group[operand.index]
        if not torch.equal(group[:1].expand(group.shape), group):
            return None
        # Of a row of W, with G = df/dW and q = G . u: (df/dg)^2 + |df/dv|^2 = q^2 + s^2 (|G|^2 - q^2).
        u, s = norm.parts(self.theta)
        u, s = u[operand.index], s[group[0]]
        q = _sum(e * (x @ u) for e, x in part.terms if x is not None)
        return [[(e * s, x) for e, x in part.terms]], [(1.0, q), (-1.0, q * s)]

    def _add_rows(self, total: Tensor, parts: list[Part]) -> None:
        """The products of what rows have over some operands, made in blocks."""
        if not parts:
            return
        support = self.columns.support(part.operand for part in parts)
        for columns in support.split(max(1, 4 * BLOCK // max(self.count, 1))):
            blocks = []
            step = max(1, BLOCK // self.columns.parameters)
            for start in range(0, self.count, step):
                piece = slice(start, start + step)
                some = [Part(part.operand, [sliced(term, piece) for term in part.terms]) for part in parts]
                rows = self.theta.new_empty(len(some[0].terms[0][0]), self.columns.parameters)
                self.columns.write(rows, some, self.theta)
                blocks.append(rows[:, columns].to(total.dtype))
            matrix = torch.cat(blocks)
            total.addmm_(matrix, matrix.T)


def sliced(term: Term, piece: slice) -> Term:
    """Return a term of some of the rows."""
    return term[0][piece], None if term[1] is None else term[1][piece]


def _sum(tensors: Iterable[Tensor]) -> Tensor:
    first, *others = tensors
    for other in others:
        first = first + other
    return first


def _folded(parts: Sequence[Part], columns: Columns) -> list[Part]:
    """The parts, those of biases as one more input, of ones, of their matrices."""

    def plain(part: Part) -> bool:
        operand = columns.operands.all[part.operand]
        return part.operand in columns.alone and operand.base == THETA and not operand.repeats

    flat = {part.operand: part for part in parts if part.terms[0][1] is None}
    result: list[Part] = []
    for part in parts:
        if part.terms[0][1] is None:
            continue
        terms = part.terms
        if plain(part):
            for k, bias in list(flat.items()):
                ids = {id(e) for e, _ in bias.terms}
                if plain(bias) and len(ids) == len(bias.terms) and ids <= {id(e) for e, _ in terms}:
                    terms = [(e, _padded(x, id(e) in ids)) for e, x in terms]
                    del flat[k]
                    break
        result.append(Part(part.operand, terms))
    return result + list(flat.values())


def _padded(x: Tensor | None, ones: bool) -> Tensor | None:
    """One more column, of ones or zeros."""
    return None if x is None else torch.nn.functional.pad(x, (0, 1), value=float(ones))


def _add_products(total: Tensor, matrices: Sequence[list[Term]], flat: Sequence[tuple[float, Tensor]]) -> None:
    """Add products of rows by their factors to the lower triangle, in blocks that keep two factors in the cache."""
    exact = [[(e.to(total.dtype), x.to(total.dtype)) for e, x in terms if x is not None] for terms in matrices]
    signed = [(sign, e.to(total.dtype)) for sign, e in flat]
    room = total.new_empty(2, GRAM_ROWS * len(total))
    for start in range(0, len(total), GRAM_ROWS):
        end = min(len(total), start + GRAM_ROWS)
        a, b = (part[: (end - start) * end].view(end - start, end) for part in room)
        for terms in exact:
            for e, x in terms:
                for other_e, other_x in terms:
                    torch.mm(e[start:end], other_e[:end].T, out=a)
                    torch.mm(x[start:end], other_x[:end].T, out=b)
                    total[start:end, :end].addcmul_(a, b)
        for sign, e in signed:
            total[start:end, :end].addmm_(e[start:end], e[:end].T, alpha=sign)


def _clusters(supports: dict[int, Tensor], parameters: int) -> list[list[int]]:
    """Operands in lots that have no entries of theta in common."""
    lots: list[tuple[Tensor, list[int]]] = []
    for k, support in supports.items():
        mask = torch.zeros(parameters, dtype=torch.bool, device=support.device)
        mask[support] = True
        names = [k]
        touching = [bool((lot[0] & mask).any()) for lot in lots]
        apart = [lot for lot, touches in zip(lots, touching, strict=True) if not touches]
        for other, others in (lot for lot, touches in zip(lots, touching, strict=True) if touches):
            mask = mask | other
            names = others + names
        lots = [*apart, (mask, names)]
    return [names for _, names in lots]
