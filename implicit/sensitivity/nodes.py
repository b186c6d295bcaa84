"""The steps of a function of points, each with what it does to derivatives.

A value of N points is (N, w), whatever shape the module gave it: a row a point. Its derivatives in space are
(N, D, w), or None where they are zero. A step takes x to y, and derivatives

    forwards,   y' = (dy/dx) x'                                     `push`
    backwards,  d  = (dy/dx)^T e,   d' = (dy/dx)^T e' + (dy/dx)'^T e    `pull`

with e = df/dy and d = df/dx, and dots for derivatives in space. Of the parameters in a step, df/dW of a matrix is the
outer product of x and e, kept as its two factors; df/db of everything else is kept as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from implicit.sensitivity.elementwise import derivatives

Moved = Tensor | None
Adjoint = tuple[Tensor, Moved]  # df/dy (N, w), and its derivatives in space (N, D, w)


@dataclass(frozen=True, eq=False)
class Use:
    """The derivative of f by one of its operands: e, or the outer product of x and e, with derivatives in space."""

    operand: int
    e: Tensor
    e_moved: Moved
    x: Tensor | None = None  # None: the operand's derivative is e itself
    x_moved: Moved = None
    bias: int | None = None  # an operand whose derivative is e, of the same step


def added(a: Moved, b: Moved) -> Moved:
    """a + b, where None is zero."""
    return b if a is None else a if b is None else a + b


def scaled(a: Moved, factor: Tensor) -> Moved:
    """Derivatives in space (N, D, w) times a factor (N, w) or (w,), where None is zero."""
    return None if a is None else a * (factor[:, None] if factor.ndim == 2 else factor)


@dataclass(eq=False)
class Here:
    """The values a step is given at some points."""

    count: int  # of the points
    xs: list[Tensor]  # values of the sources
    operands: Sequence[Tensor]  # values of all operands
    moved: list[Moved]  # derivatives of the sources in space
    uses: list[Use]  # where derivatives by operands are put
    kept: Any = None  # what the way forwards leaves for the way back


class Step(Protocol):
    """One step of a function."""

    @property
    def sources(self) -> tuple[int, ...]:
        """Numbers of the values it takes: 0 is the points, k what step k gives."""

    @property
    def operands(self) -> tuple[int, ...]:
        """Operands that it takes beside them."""

    def forward(self, here: Here) -> Tensor:
        """y (N, w)."""

    def push(self, here: Here) -> Moved:
        """y', after `forward`."""

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        """d and d' of each source, after `forward` (and `push`, for d')."""


@dataclass(frozen=True, eq=False)
class Spread:
    """The same numbers at every point: an operand, such as a latent code."""

    operand: int
    sources: tuple[int, ...] = ()

    @property
    def operands(self) -> tuple[int, ...]:
        return (self.operand,)

    def forward(self, here: Here) -> Tensor:
        return here.operands[self.operand].expand(here.count, -1)

    def push(self, here: Here) -> Moved:
        return None

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        here.uses.append(Use(self.operand, *e))
        return []


@dataclass(frozen=True, eq=False)
class Affine:
    """y = x W + b, with W (in, out)."""

    source: int
    weight: int
    bias: int | None

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    @property
    def operands(self) -> tuple[int, ...]:
        return (self.weight,) if self.bias is None else (self.weight, self.bias)

    def forward(self, here: Here) -> Tensor:
        if self.bias is None:
            return here.xs[0] @ here.operands[self.weight]
        return torch.addmm(here.operands[self.bias], here.xs[0], here.operands[self.weight])

    def push(self, here: Here) -> Moved:
        return None if here.moved[0] is None else here.moved[0] @ here.operands[self.weight]

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        here.uses.append(Use(self.weight, *e, here.xs[0], here.moved[0], self.bias))
        back = here.operands[self.weight].T
        return [(e[0] @ back, None if e[1] is None else e[1] @ back)]


@dataclass(frozen=True, eq=False)
class Elementwise:
    """y = s(x)."""

    source: int
    function: Any
    arguments: tuple[Any, ...]
    named: dict[str, Any]
    scale: float = 1.0  # of x, before the function
    operands: tuple[int, ...] = ()

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    def forward(self, here: Here) -> Tensor:
        if self.scale == 1:
            y, *here.kept = derivatives(self.function, here.xs[0], self.arguments, self.named)
            return y
        y, first, second = derivatives(self.function, self.scale * here.xs[0], self.arguments, self.named)
        here.kept = [
            None if first is None else first * self.scale,
            None if second is None else second * self.scale**2,
        ]
        return y

    def push(self, here: Here) -> Moved:
        return None if here.kept[0] is None else scaled(here.moved[0], here.kept[0])

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        first, second = here.kept
        if first is None:
            return [(torch.zeros_like(here.xs[0]), None)]
        d_moved = scaled(e[1], first)
        if second is not None and here.moved[0] is not None:
            d_moved = added(d_moved, scaled(here.moved[0], second * e[0]))
        return [(first * e[0], d_moved)]


@dataclass(frozen=True, eq=False)
class Linear:
    """y = factor x + shift, of constants; shift may be an operand."""

    source: int
    factor: float | Tensor
    shift: int | None = None
    share: float = 1.0  # of the shift

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    @property
    def operands(self) -> tuple[int, ...]:
        return () if self.shift is None else (self.shift,)

    def _times(self, a: Tensor) -> Tensor:
        return a if isinstance(self.factor, float) and self.factor == 1 else a * self.factor

    def forward(self, here: Here) -> Tensor:
        y = self._times(here.xs[0])
        return y if self.shift is None else torch.add(y, here.operands[self.shift], alpha=self.share)

    def push(self, here: Here) -> Moved:
        return None if here.moved[0] is None else self._times(here.moved[0])

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        if self.shift is not None:
            same = self.share == 1
            rest = None if e[1] is None else e[1] * self.share
            here.uses.append(Use(self.shift, *e) if same else Use(self.shift, e[0] * self.share, rest))
        return [(self._times(e[0]), None if e[1] is None else self._times(e[1]))]


@dataclass(frozen=True, eq=False)
class Scaled:
    """y = p x, elementwise, with an operand p."""

    source: int
    operand: int

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    @property
    def operands(self) -> tuple[int, ...]:
        return (self.operand,)

    def forward(self, here: Here) -> Tensor:
        return here.xs[0] * here.operands[self.operand]

    def push(self, here: Here) -> Moved:
        return scaled(here.moved[0], here.operands[self.operand])

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        x, p = here.xs[0], here.operands[self.operand]
        here.uses.append(Use(self.operand, e[0] * x, added(scaled(e[1], x), scaled(here.moved[0], e[0]))))
        return [(e[0] * p, scaled(e[1], p))]


@dataclass(frozen=True, eq=False)
class Sum:
    """y = a + share b."""

    sources: tuple[int, int]
    share: float = 1.0
    operands: tuple[int, ...] = ()

    def forward(self, here: Here) -> Tensor:
        return torch.add(here.xs[0], here.xs[1], alpha=self.share)

    def push(self, here: Here) -> Moved:
        return added(here.moved[0], None if here.moved[1] is None else here.moved[1] * self.share)

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        return [e, (e[0] * self.share, None if e[1] is None else e[1] * self.share)]


@dataclass(frozen=True, eq=False)
class Product:
    """y = a b, elementwise."""

    sources: tuple[int, int]
    operands: tuple[int, ...] = ()

    def forward(self, here: Here) -> Tensor:
        return here.xs[0] * here.xs[1]

    def push(self, here: Here) -> Moved:
        return added(scaled(here.moved[0], here.xs[1]), scaled(here.moved[1], here.xs[0]))

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        return [
            (e[0] * other, added(scaled(e[1], other), scaled(moved, e[0])))
            for other, moved in zip(reversed(here.xs), reversed(here.moved), strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Joined:
    """y = (a, b, ...), side by side."""

    sources: tuple[int, ...]
    widths: tuple[int, ...]
    operands: tuple[int, ...] = ()

    def forward(self, here: Here) -> Tensor:
        return torch.cat(list(here.xs), dim=1)

    def push(self, here: Here) -> Moved:
        some = next((part for part in here.moved if part is not None), None)
        if some is None:
            return None
        return torch.cat(
            [
                some.new_zeros(*some.shape[:2], width) if part is None else part
                for part, width in zip(here.moved, self.widths, strict=True)
            ],
            dim=2,
        )

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        values = e[0].split(self.widths, dim=1)
        rest = [None] * len(values) if e[1] is None else e[1].split(self.widths, dim=2)
        return list(zip(values, rest, strict=True))


@dataclass(frozen=True, eq=False)
class Chosen:
    """y = x[:, index]: columns, in any order and as often as they are wanted."""

    source: int
    index: Tensor
    width: int  # of x
    operands: tuple[int, ...] = ()

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    def forward(self, here: Here) -> Tensor:
        return here.xs[0].index_select(1, self.index)

    def push(self, here: Here) -> Moved:
        return None if here.moved[0] is None else here.moved[0].index_select(2, self.index)

    def _back(self, e: Tensor) -> Tensor:
        return e.new_zeros(*e.shape[:-1], self.width).index_add_(e.ndim - 1, self.index, e)

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        return [(self._back(e[0]), None if e[1] is None else self._back(e[1]))]


@dataclass(frozen=True, eq=False)
class Gathered:
    """y_j = the sum of the x_k with index[k] = j."""

    source: int
    index: Tensor
    width: int  # of y
    operands: tuple[int, ...] = ()

    @property
    def sources(self) -> tuple[int, ...]:
        return (self.source,)

    def _sum(self, x: Tensor) -> Tensor:
        if self.width == 1:
            return x.sum(dim=-1, keepdim=True)
        return x.new_zeros(*x.shape[:-1], self.width).index_add_(x.ndim - 1, self.index, x)

    def forward(self, here: Here) -> Tensor:
        return self._sum(here.xs[0])

    def push(self, here: Here) -> Moved:
        return None if here.moved[0] is None else self._sum(here.moved[0])

    def pull(self, e: Adjoint, here: Here) -> list[Adjoint]:
        return [(e[0].index_select(1, self.index), None if e[1] is None else e[1].index_select(2, self.index))]
