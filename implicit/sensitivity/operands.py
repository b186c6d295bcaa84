"""Operands of a function's steps beside the points: constants, entries of theta, and what is computed from these.

A weight under a norm, say, is computed from theta: W = g v / |v| a row. With J = dW/dtheta and G = df/dW,

    df/dtheta = J^T G;      of weight norm:   df/dg = q,   df/dv = s (G - q u),   u = v / |v|,  s = g / |v|,  q = G . u.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor
from torch.func import vjp, vmap
from torch.utils._pytree import tree_map

THETA, CONSTANT = -1, -2  # bases of operands; others are numbers of derived tensors


@dataclass(frozen=True, eq=False)
class Call:
    """One operator that a function called, with what it took and gave."""

    function: Any
    arguments: tuple[Any, ...]
    named: dict[str, Any]
    result: Any


@dataclass(frozen=True, eq=False)
class Operand:
    """A constant, or entries of theta or of a derived tensor, in a shape.

    Args:
        base: THETA, CONSTANT or the number of a derived tensor.
        index: Which entries (flat, of the base), in the shape of the operand.
        constant: The value of a constant.
    """

    base: int
    index: Tensor
    constant: Tensor | None = None
    # Offset and strides, where the entries lie evenly.
    strided: tuple[int, tuple[int, ...]] | None = field(init=False, default=None)
    repeats: bool = field(init=False, default=False)  # whether an entry comes twice

    def __post_init__(self) -> None:
        if self.base != CONSTANT:
            object.__setattr__(self, "strided", _strides(self.index))
            object.__setattr__(self, "repeats", len(self.index.unique()) < self.index.numel())

    def of(self, flat: Tensor) -> Tensor:
        """The entries of a flat tensor."""
        if self.strided is not None:
            offset, strides = self.strided
            return flat.as_strided(self.index.shape, strides, flat.storage_offset() + offset)
        return flat[self.index]


@dataclass(frozen=True, eq=False)
class WeightNorm:
    """W = g v / |v|, where g has one number for each set of entries of v that share a length."""

    v: Operand  # the entries of v in theta, in the order of W's
    g: Operand
    group: Tensor  # which g is that of an entry of W

    def parts(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """u = v / |v| (entries,), and s = g / |v| (groups,)."""
        v = self.v.of(theta)
        length = self.summed(v.square()).sqrt()
        return v / length[self.group], self.g.of(theta) / length

    def value(self, theta: Tensor) -> Tensor:
        """W, flat."""
        return self.parts(theta)[0] * self.g.of(theta)[self.group]

    def summed(self, x: Tensor) -> Tensor:
        """Sums over the entries of each group (*, groups), of numbers (*, entries)."""
        groups = self.g.index.numel()
        if torch.equal(self.group.view(groups, -1), self.group[:: len(self.group) // groups, None].expand(groups, -1)):
            return x.reshape(*x.shape[:-1], groups, -1).sum(dim=-1)
        return x.new_zeros(*x.shape[:-1], groups).index_add_(x.ndim - 1, self.group, x)


@dataclass(frozen=True, eq=False)
class Derived:
    """A tensor computed from theta alone.

    Args:
        evaluate: theta to the tensor, flat.
        support: The entries of theta that it depends on.
        norm: Set where it is a weight under weight norm.
        size: How many numbers it has.
    """

    evaluate: Callable[[Tensor], Tensor]
    support: Tensor
    norm: WeightNorm | None
    size: int

    def directional(self, theta: Tensor, d_theta: Tensor) -> Tensor:
        """J d_theta, flat."""
        if self.norm is not None:
            norm = self.norm
            u, s = norm.parts(theta)
            dv = norm.v.of(d_theta)
            along = norm.summed(u * dv)
            return u * norm.g.of(d_theta)[norm.group] + s[norm.group] * (dv - u * along[norm.group])
        # Some operators have no forward derivative. J^T w is linear in w, so the derivative of (J^T w) . d_theta by w
        # is J d_theta, whatever w.
        with torch.enable_grad():
            at = theta.detach().requires_grad_()
            value = self.evaluate(at)
            w = torch.zeros_like(value).requires_grad_()
            (back,) = torch.autograd.grad(value @ w, at, create_graph=True)
            return torch.autograd.grad(back @ d_theta, w)[0]

    def back(self, theta: Tensor, gradients: Tensor) -> Tensor:
        """J^T G over the support, (N, S), for gradients (N, entries)."""
        if self.norm is not None:
            norm = self.norm
            u, s = norm.parts(theta)
            q = norm.summed(gradients * u)
            dv = (gradients - q[:, norm.group] * u).mul_(s[norm.group])
            return torch.cat([dv, q], dim=1)  # the support in this order
        pull = vjp(self.evaluate, theta)[1]
        return torch.cat([vmap(pull)(part)[0][:, self.support] for part in gradients.split(64)])


@dataclass(eq=False)
class Operands:
    """All operands of a function; two that say the same are one."""

    derived: list[Derived] = field(default_factory=list)
    all: list[Operand] = field(default_factory=list)
    used: set[int] = field(default_factory=set)  # those that the output depends on
    device: torch.device | None = None
    _known: dict[Any, int] = field(default_factory=dict)

    def number(self, operand: Operand) -> int:
        """Return the operand's place in the list, which it joins if it is new."""
        if operand.base == CONSTANT:
            self.all.append(operand)
            return len(self.all) - 1
        key = (operand.base, tuple(operand.index.shape), operand.index.cpu().numpy().tobytes())
        if key not in self._known:
            self._known[key] = len(self.all)
            self.all.append(Operand(operand.base, operand.index.to(self.device)))
        return self._known[key]

    def values(self, theta: Tensor) -> list[Tensor | None]:
        """Their values at theta; None for those that are not used."""
        theta = theta.contiguous()
        return self._values(theta, {k: self.derived[k].evaluate(theta) for k in self._derived_used()})

    def directional(self, theta: Tensor, d_theta: Tensor) -> list[Tensor | None]:
        """Their derivatives along d_theta; None for those that are constant or not used."""
        d_theta = d_theta.contiguous()
        derived = {k: self.derived[k].directional(theta, d_theta) for k in self._derived_used()}
        return [None if self.all[k].base == CONSTANT else v for k, v in enumerate(self._values(d_theta, derived))]

    def _derived_used(self) -> list[int]:
        return sorted({self.all[k].base for k in self.used if self.all[k].base >= 0})

    def _values(self, theta: Tensor, derived: dict[int, Tensor]) -> list[Tensor | None]:
        values: list[Tensor | None] = []
        for k, operand in enumerate(self.all):
            if k not in self.used:
                values.append(None)
            elif operand.base == CONSTANT:
                values.append(operand.constant)
            else:
                values.append(operand.of(theta if operand.base == THETA else derived[operand.base]))
        return values

    def support(self, operand: int) -> Tensor:
        """The entries of theta that an operand depends on; those of a derived tensor in the order of Derived.back."""
        one = self.all[operand]
        return one.index.flatten() if one.base == THETA else self.derived[one.base].support


def replayed(calls: Sequence[Call], theta_then: Tensor, result: Tensor) -> Callable[[Tensor], Tensor]:
    """Return what computed the result from theta_then, as a function of theta, flat."""
    needed = _leading_to(calls, result)

    def evaluate(theta: Tensor) -> Tensor:
        now: dict[int, Any] = {id(theta_then): theta}

        def renewed(value: Any) -> Any:
            return now.get(id(value), value) if isinstance(value, Tensor) else value

        for call in needed:
            arguments, named = tree_map(renewed, call.arguments), tree_map(renewed, call.named)
            new = _WRITTEN_OUT.get(call.function, call.function)(*arguments, **named)
            old, new = (call.result, new) if isinstance(call.result, (tuple, list)) else ((call.result,), (new,))
            now.update((id(before), after) for before, after in zip(old, new, strict=True))
        return now[id(result)].reshape(-1)  # type: ignore[no-any-return]

    return evaluate


def _weight_norm(v: Tensor, g: Tensor, dim: int = 0) -> tuple[Tensor, Tensor]:
    length = torch.norm_except_dim(v, 2, dim)
    return v * (g / length), length


# Operators whose derivatives torch cannot make for many rows at once.
_WRITTEN_OUT = {torch.ops.aten._weight_norm_interface.default: _weight_norm}


def weight_norm(evaluate: Callable[[Tensor], Tensor], leaves: Sequence[Tensor], theta: Tensor) -> WeightNorm | None:
    """Return the weight norm that a derived tensor is, tried in numbers and so however it is written, or None.

    Args:
        evaluate: theta to the tensor, flat.
        leaves: The entries of theta that enter it, each in its shape.
        theta: Parameters to try it at.
    """
    if len(leaves) != 2:
        return None
    g, v = sorted(leaves, key=Tensor.numel)
    if v.ndim < 2 or g.ndim not in (0, v.ndim) or any(a not in (1, b) for a, b in zip(g.shape, v.shape, strict=False)):
        return None
    group = torch.arange(g.numel()).view(g.shape).expand(v.shape).flatten()
    device = theta.device
    norm = WeightNorm(Operand(THETA, v.flatten().to(device)), Operand(THETA, g.flatten().to(device)), group.to(device))
    generator = torch.Generator().manual_seed(0)
    tolerance = max(100 * torch.finfo(theta.dtype).eps, rounding_of_norms(theta))
    for _ in range(2):
        trial = torch.randn(theta.shape, generator=generator, dtype=torch.float64).to(theta)
        with torch.no_grad():
            found = evaluate(trial)
            if found.shape != group.shape:
                return None
            expected = norm.value(trial)
        if not torch.allclose(found, expected, rtol=tolerance, atol=tolerance * float(expected.abs().max())):
            return None
    return norm


def rounding_of_norms(theta: Tensor) -> float:
    """Return how far torch's weight norm is from exact: on a graphics card it takes norms in single precision."""
    return 1e-6 if theta.is_cuda else 0.0


def _leading_to(calls: Sequence[Call], result: Tensor) -> list[Call]:
    """The calls that the result comes from."""
    wanted, needed = {id(result)}, []
    for call in reversed(calls):
        results = call.result if isinstance(call.result, (tuple, list)) else (call.result,)
        if wanted.isdisjoint(id(value) for value in results):
            continue
        needed.append(call)
        tree_map(lambda value: wanted.add(id(value)) if isinstance(value, Tensor) else None, call.arguments)
        tree_map(lambda value: wanted.add(id(value)) if isinstance(value, Tensor) else None, call.named)
    return needed[::-1]


def _strides(index: Tensor) -> tuple[int, tuple[int, ...]] | None:
    """Offset and strides of entries that lie evenly, else None."""
    if index.numel() == 0:
        return None
    first = index.flatten()[0]
    even, strides = first.expand(index.shape), []
    for axis, size in enumerate(index.shape):
        step = 0
        if size > 1:
            step = int(index.movedim(axis, 0).flatten(1)[1, 0] - first) if index.ndim > 1 else int(index[1] - first)
        shape = [1] * index.ndim
        shape[axis] = size
        even = even + step * torch.arange(size, device=index.device).view(shape)
        strides.append(step)
    if min(strides, default=0) < 0 or not torch.equal(even, index):
        return None
    return int(first), tuple(strides)
