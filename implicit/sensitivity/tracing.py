"""The steps of a function f(theta, points), read from the operators that it calls at a few points.

Whatever the module, its operators pass through torch's dispatcher, where they are recorded. What is computed from
theta alone becomes an operand; what depends on the points becomes a step of implicit.sensitivity.nodes. Operators that
only move numbers about (views, slices, transposes) are applied to the numbers' addresses, which says where each went.

A function is not read where the value at one point depends on another point, where numbers decide which operators are
called, or where an operator is none of those known here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from implicit.sensitivity.nodes import (
    Affine,
    Chosen,
    Elementwise,
    Gathered,
    Joined,
    Linear,
    Product,
    Scaled,
    Spread,
    Step,
    Sum,
)
from implicit.sensitivity.operands import (
    CONSTANT,
    THETA,
    Call,
    Derived,
    Operand,
    Operands,
    replayed,
    weight_norm,
)

# Numbers of points to record with: one that is no size of the module's own, so that the axis of the points shows.
COUNTS = (5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61)

# Operators that only move numbers about.
MOVES = (
    "_reshape_alias", "_to_copy", "_unsafe_view", "alias", "cat", "clone", "contiguous", "detach", "expand", "flip",
    "index", "index_select", "narrow", "permute", "repeat", "reshape", "roll", "select", "slice", "split",
    "split_with_sizes", "squeeze", "stack", "t", "transpose", "unbind", "unsafe_split", "unsqueeze", "view",
)  # fmt: skip


class UnreadableError(Exception):
    """The function's structure could not be found."""


@dataclass(frozen=True, eq=False)
class Steps:
    """A function of points as steps.

    Args:
        nodes: The steps by number, each after its sources; 0 is the points themselves.
        output: The last step.
        operands: What they take beside the points.
    """

    nodes: dict[int, Step]
    output: int
    operands: Operands


def steps_of(function: Callable[[Tensor, Tensor], Tensor], theta: Tensor, lower: Tensor, upper: Tensor) -> Steps:
    """Return the steps of function(theta, points), values (N,) or (N, 1).

    Args:
        function: Of theta (P,) and points (N, D).
        theta: Parameters to record it at.
        lower, upper: Corners (D,) of a box that the points are drawn from.

    Raises:
        UnreadableError: The structure could not be found.
    """
    _, _, calls, _ = _recorded(function, theta, lower, upper, COUNTS[0])
    sizes = {size for call in calls for t in _tensors((call.arguments, call.result)) for size in t.shape}
    count = next((n for n in COUNTS if n not in sizes), None)
    if count is None:
        raise UnreadableError("the sizes of its tensors leave no number of points to tell from them")
    theta, points, calls, result = _recorded(function, theta, lower, upper, count)
    return _Reader(theta, points, calls).read(result)


def _recorded(
    function: Callable[[Tensor, Tensor], Tensor], theta: Tensor, lower: Tensor, upper: Tensor, count: int
) -> tuple[Tensor, Tensor, list[Call], Tensor]:
    """The calls at so many points, with the tensors that they start from and end in."""
    generator = torch.Generator().manual_seed(count)
    draw = torch.rand(count, len(lower), generator=generator, dtype=torch.float64).to(theta)
    points = lower + draw * (upper - lower)
    theta = theta.detach().clone()
    recorder = _Recorder()
    with torch.no_grad(), recorder:
        result = function(theta, points)
    return theta, points, recorder.calls, result


class _Recorder(TorchDispatchMode):
    """Keeps what is called."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[Call] = []

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """Spare the import of torch's compiler, a second and more, for it only guards against compiling the mode."""
        return False

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        self.calls.append(Call(func, args, kwargs or {}, result))
        return result


@dataclass(frozen=True, eq=False)
class _OfPoints:
    """A tensor that depends on the points: which node, which axis is that of the points, and the other sizes."""

    node: int
    axis: int
    shape: tuple[int, ...]  # with the points

    @property
    def width(self) -> int:
        return prod(self.shape[: self.axis] + self.shape[self.axis + 1 :])

    def addresses(self, count: int) -> tuple[Tensor, Tensor]:
        """Column and row of the node's value for each entry."""
        rest = self.shape[: self.axis] + self.shape[self.axis + 1 :]
        columns = torch.arange(prod(rest)).view(rest).unsqueeze(self.axis).expand(self.shape)
        rows = torch.arange(count).view([-1 if k == self.axis else 1 for k in range(len(self.shape))])
        return columns.contiguous(), rows.expand(self.shape).contiguous()


@dataclass(frozen=True, eq=False)
class _OfTheta:
    """A tensor computed from theta alone: entries of a base."""

    base: int
    index: Tensor


_Entry = _OfPoints | _OfTheta
_STALE = object()  # what an in-place operator has changed behind a tensor


@dataclass(eq=False)
class _Reader:
    """Reads recorded calls, in their order."""

    theta: Tensor
    points: Tensor
    calls: list[Call]
    nodes: list[Step | None] = field(default_factory=lambda: [None])  # the points, and steps
    operands: Operands = field(default_factory=Operands)
    entries: dict[int, Any] = field(default_factory=dict)
    shared: dict[int, set[int]] = field(default_factory=dict)  # tensors by the memory they look at
    ends: dict[int, list[Tensor]] = field(default_factory=dict)  # the entries of theta that enter a derived tensor
    count: int = 0  # of points

    def read(self, result: Any) -> Steps:
        self.count = len(self.points)
        self.operands.device = self.theta.device
        self._enter(self.theta, _OfTheta(THETA, torch.arange(len(self.theta))))
        self._enter(self.points, _OfPoints(0, 0, tuple(self.points.shape)))
        for k, call in enumerate(self.calls):
            self._read(call, self.calls[:k])
        entry = self._look(result)
        if not isinstance(entry, _OfPoints) or entry.width != 1:
            raise UnreadableError("its result is not one value a point")
        return self._pruned(entry.node)

    # Tensors and what is known of them

    def _enter(self, tensor: Tensor, entry: _Entry) -> None:
        if isinstance(entry, _OfPoints) and tensor.dtype != self.theta.dtype:
            raise UnreadableError(f"it computes in {tensor.dtype}")
        self.entries[id(tensor)] = entry
        self.shared.setdefault(tensor.untyped_storage().data_ptr(), set()).add(id(tensor))

    def _look(self, value: Any) -> Any:
        """The entry of a tensor, a constant tensor, or a number."""
        if not isinstance(value, Tensor):
            return value
        entry = self.entries.get(id(value), value)
        if entry is _STALE:
            raise UnreadableError("a tensor is used after an in-place operator has changed it")
        return entry

    def _add(self, node: Step, tensor: Tensor, axis: int) -> None:
        self.nodes.append(node)
        self._enter(tensor, _OfPoints(len(self.nodes) - 1, axis, tuple(tensor.shape)))

    # One call

    def _read(self, call: Call, before: Sequence[Call]) -> None:
        tensors = _tensors((call.arguments, call.named))
        entries = [self._look(tensor) for tensor in tensors]
        known = [entry for entry in entries if isinstance(entry, (_OfPoints, _OfTheta))]
        name = call.function.overloadpacket._qualified_op_name.removeprefix("aten::")
        if call.function._schema.is_mutable:
            if self._is_change_of_a_constant(call, name, known, before):
                return
            name = name.removesuffix("_")
        if not known:
            if torch.Tag.nondeterministic_seeded in call.function.tags:
                raise UnreadableError(f"{name} is a matter of chance")
            return
        of_theta = [entry for entry in known if isinstance(entry, _OfTheta)]
        if len(of_theta) == len(known):
            self._of_theta(call, name, of_theta, before)
            return
        reader = getattr(self, f"_read_{name}", None)
        if name in MOVES:
            self._moved(call)
        elif reader is not None:
            reader(call)
        elif torch.Tag.pointwise in call.function.tags and len(tensors) == 1:
            self._elementwise(call, name)
        else:
            raise UnreadableError(f"it calls {name}")

    def _is_change_of_a_constant(
        self, call: Call, name: str, known: Sequence[_OfPoints | _OfTheta], before: Sequence[Call]
    ) -> bool:
        """Return whether an in-place operator changes a constant made on the way, which is taken as it is in the end.

        Where it changes a value at points, the other views of its memory become stale.

        Raises:
            UnreadableError: It writes into anything else.
        """
        target = call.arguments[0] if call.arguments else None
        if not (isinstance(target, Tensor) and call.result is target and name.endswith("_")):
            raise UnreadableError(f"{name} writes into a tensor")
        if not isinstance(self.entries.get(id(target)), _OfPoints):
            if not known and id(target) in {id(t) for c in before for t in _tensors((c.result,))}:
                return True
            raise UnreadableError(f"{name} writes into a tensor that is no value at points")
        for other in self.shared[target.untyped_storage().data_ptr()] - {id(target)}:
            self.entries[other] = _STALE
        return False

    def _of_theta(self, call: Call, name: str, known: Sequence[_OfTheta], before: Sequence[Call]) -> None:
        """A call of theta and constants alone."""
        results = call.result if isinstance(call.result, (tuple, list)) else (call.result,)
        if not all(isinstance(result, Tensor) for result in results):
            raise UnreadableError(f"{name} takes numbers out of tensors")
        if name in MOVES and len(_tensors(call.arguments)) == 1:
            addresses = self._called(call, lambda entry: entry.index)
            for result, index in zip(results, addresses, strict=True):
                if result.dtype != self.theta.dtype:
                    raise UnreadableError(f"it computes in {result.dtype}")
                # What is spread over the points becomes a value at points, though the same at each.
                axes = [k for k, size in enumerate(result.shape) if size == self.count]
                if len(axes) == 1 and self.count not in known[0].index.shape:
                    row = index.select(axes[0], 0).flatten()
                    operand = self.operands.number(Operand(known[0].base, row))
                    self._add(Spread(operand), result, axes[0])
                else:
                    self._enter(result, _OfTheta(known[0].base, index))
            return
        ends = _distinct([e for part in known for e in ([part.index] if part.base == THETA else self.ends[part.base])])
        for result in results:
            if result.dtype != self.theta.dtype:
                raise UnreadableError(f"it computes in {result.dtype}")
            evaluate = replayed([*before, call], self.theta, result)
            number = len(self.operands.derived)
            norm = weight_norm(evaluate, ends, self.theta)
            if norm is None:
                support = torch.cat([end.flatten() for end in ends]).unique().to(self.theta.device)
            else:
                support = torch.cat([norm.v.index.flatten(), norm.g.index.flatten()])
            self.operands.derived.append(Derived(evaluate, support, norm, result.numel()))
            self.ends[number] = ends
            self._enter(result, _OfTheta(number, torch.arange(result.numel()).view(result.shape)))

    def _called(self, call: Call, addresses: Callable[[Any], Tensor]) -> tuple[Tensor, ...]:
        """The call's results, of the addresses of its tensors."""

        def address(value: Any) -> Any:
            entry = self._look(value)
            if isinstance(entry, (_OfPoints, _OfTheta)):
                return addresses(entry)
            if isinstance(value, (list, tuple)):
                return type(value)(address(part) for part in value)
            return value

        named = {key: value for key, value in call.named.items() if key in ("dim", "implicit", "end", "start")}
        result = call.function(*(address(value) for value in call.arguments), **named)
        return tuple(result) if isinstance(result, (tuple, list)) else (result,)

    # Moves

    def _moved(self, call: Call) -> None:
        """A call that moves numbers: where each comes from says what it does."""
        tensors = call.arguments[0] if isinstance(call.arguments[0], (list, tuple)) else [call.arguments[0]]
        first_of_points = next((e for e in map(self._look, tensors) if isinstance(e, _OfPoints)), None)
        if first_of_points is None or any(id(t) in self.entries for t in _tensors(call.arguments[1:])):
            raise UnreadableError("what is computed says where numbers go")
        if not all(isinstance(t, Tensor) and t.ndim == len(first_of_points.shape) for t in tensors):
            raise UnreadableError("tensors of several ranks are joined")
        parts = [self._at_points(tensor, tuple(tensor.shape), first_of_points.axis) for tensor in tensors]
        widths = [part.width for part in parts]
        first = [sum(widths[:k]) for k in range(len(parts))]
        columns, rows = [], []
        for k, part in enumerate(parts):
            column, row = part.addresses(self.count)
            columns.append(column + first[k])
            rows.append(row)
        lists = isinstance(call.arguments[0], (list, tuple))
        named = {key: value for key, value in call.named.items() if key in ("dim", "implicit", "end", "start")}
        of_columns = call.function(columns if lists else columns[0], *call.arguments[1:], **named)
        of_rows = call.function(rows if lists else rows[0], *call.arguments[1:], **named)
        source = parts[0].node
        if lists and len(parts) > 1:
            self.nodes.append(Joined(tuple(part.node for part in parts), tuple(widths)))
            source = len(self.nodes) - 1
        results = call.result if isinstance(call.result, (tuple, list)) else (call.result,)
        several = isinstance(of_columns, (tuple, list))
        for result, column, row in zip(
            results, of_columns if several else (of_columns,), of_rows if several else (of_rows,), strict=True
        ):
            self._enter(result, self._picked(source, sum(widths), column, row))

    def _picked(self, source: int, width: int, columns: Tensor, rows: Tensor) -> _OfPoints:
        """The value of columns of a node, each entry given by its column and its row, which must be its point."""
        axis = self._axis(rows)
        index = columns.select(axis, 0)
        if not torch.equal(index.unsqueeze(axis).expand(columns.shape), columns):
            raise UnreadableError("the points are not all treated alike")
        return _OfPoints(self._columns(source, width, index.flatten()), axis, tuple(columns.shape))

    def _columns(self, source: int, width: int, index: Tensor) -> int:
        """The node that has these columns of another."""
        if torch.equal(index, torch.arange(width)):
            return source
        self.nodes.append(Chosen(source, index.to(self.points.device), width))
        return len(self.nodes) - 1

    def _axis(self, rows: Tensor) -> int:
        for axis, size in enumerate(rows.shape):
            expected = torch.arange(self.count).view([-1 if k == axis else 1 for k in range(rows.ndim)])
            if size == self.count and torch.equal(expected.expand(rows.shape), rows):
                return axis
        raise UnreadableError("the points are mixed with each other")

    # Operands beside values at points

    def _at_points(self, value: Any, shape: tuple[int, ...], axis: int) -> _OfPoints:
        """A tensor as a value at points of this shape."""
        entry = self._look(value)
        if isinstance(entry, _OfPoints):
            if entry.shape == shape and entry.axis == axis:
                return entry
            columns, rows = (part.expand(shape) for part in entry.addresses(self.count))
            picked = self._picked(entry.node, entry.width, columns, rows)
            if picked.axis != axis:
                raise UnreadableError("the points are mixed with each other")
            return picked
        operand = self._operand(value, shape, axis)
        self.nodes.append(Spread(operand))
        return _OfPoints(len(self.nodes) - 1, axis, shape)

    def _operand(self, value: Any, shape: tuple[int, ...], axis: int) -> int:
        """A tensor of theta or a constant, spread over a shape with points, as an operand of one row."""
        entry = self._look(value)
        if isinstance(entry, _OfTheta):
            index = entry.index.expand(shape)
            row = index.select(axis, 0)
            if not torch.equal(row.unsqueeze(axis).expand(shape), index):
                raise UnreadableError("parameters differ from point to point")
            return self.operands.number(Operand(entry.base, row.flatten()))
        whole = torch.as_tensor(entry, dtype=self.theta.dtype, device=self.theta.device).expand(shape)
        row = whole.select(axis, 0)
        if not torch.equal(row.unsqueeze(axis).expand(shape), whole):
            raise UnreadableError("a constant differs from point to point")
        return self.operands.number(_constant(row.flatten()))

    def _factor(self, value: Any, shape: tuple[int, ...], axis: int) -> float | Tensor:
        """A constant to multiply with."""
        if isinstance(value, (int, float)):
            return float(value)
        constant = self.operands.all[self._operand(value, shape, axis)].constant
        assert constant is not None
        return float(constant[0]) if bool((constant == constant[0]).all()) else constant

    # Matrices

    def _matrix(self, value: Any) -> int:
        """A matrix (in, out) of theta or a constant."""
        entry = self._look(value)
        if isinstance(entry, _OfPoints):
            raise UnreadableError("two values at points are multiplied as matrices")
        if isinstance(entry, _OfTheta):
            return self.operands.number(Operand(entry.base, entry.index))
        return self.operands.number(_constant(entry.to(self.theta)))

    def _flipped(self, value: Any) -> int:
        """The transpose of a matrix, as an operand."""
        entry = self._look(value)
        if isinstance(entry, _OfTheta):
            return self.operands.number(Operand(entry.base, entry.index.T))
        if isinstance(entry, _OfPoints):
            raise UnreadableError("two values at points are multiplied as matrices")
        return self.operands.number(_constant(entry.to(self.theta).T))

    def _affine(self, x: Any, matrix: Any, bias: Any, result: Tensor) -> None:
        """x W + b, or W x of columns of points."""
        entry = self._look(x)
        if isinstance(entry, _OfPoints) and entry.axis == 0:
            source, weight, axis = entry.node, self._matrix(matrix), 0
        else:
            entry = self._look(matrix)
            if not isinstance(entry, _OfPoints) or entry.axis != 1:
                raise UnreadableError("points are summed over")
            source, weight, axis = entry.node, self._flipped(x), 1
        shape = tuple(result.shape)
        if bias is not None and isinstance(self._look(bias), _OfPoints):
            other = self._at_points(bias, shape, axis).node
            self.nodes.append(Affine(source, weight, None))
            self._add(Sum((len(self.nodes) - 1, other)), result, axis)
            return
        self._add(Affine(source, weight, None if bias is None else self._operand(bias, shape, axis)), result, axis)

    def _read_mm(self, call: Call) -> None:
        x, matrix = call.arguments
        self._affine(x, matrix, None, call.result)

    def _read_addmm(self, call: Call) -> None:
        if any(value != 1 for value in call.named.values()):
            raise UnreadableError("addmm with factors")
        bias, x, matrix = call.arguments
        self._affine(x, matrix, bias, call.result)

    def _read_bmm(self, call: Call) -> None:
        """One matrix for all, with a leading axis of one."""
        x, matrix = (self._look(value) for value in call.arguments)
        if not isinstance(x, _OfPoints) or x.axis != 1 or x.shape[0] != 1 or isinstance(matrix, _OfPoints):
            raise UnreadableError("a product of stacks of matrices")
        if isinstance(matrix, _OfTheta):
            weight = self.operands.number(Operand(matrix.base, matrix.index[0]))
        else:
            weight = self.operands.number(_constant(matrix.to(self.theta)[0]))
        self._add(Affine(x.node, weight, None), call.result, 1)

    def _read_mv(self, call: Call) -> None:
        x, vector = (self._look(value) for value in call.arguments)
        if not isinstance(x, _OfPoints) or x.axis != 0 or isinstance(vector, _OfPoints):
            raise UnreadableError("points are summed over")
        if isinstance(vector, _OfTheta):
            weight = self.operands.number(Operand(vector.base, vector.index[:, None]))
        else:
            weight = self.operands.number(_constant(vector.to(self.theta)[:, None]))
        self._add(Affine(x.node, weight, None), call.result, 0)

    def _read_convolution(self, call: Call) -> None:
        """A convolution whose kernel is one point wide."""
        x, kernel, bias, stride, padding, _, transposed, _, groups = call.arguments
        entry = self._look(x)
        place = tuple(size for k, size in enumerate(entry.shape) if k >= 2) if isinstance(entry, _OfPoints) else ()
        if (
            not isinstance(entry, _OfPoints)
            or transposed
            or groups != 1
            or any(size != 1 for size in kernel.shape[2:])
            or any(step != 1 for step in stride)
            or any(padding)
            or prod(place) != (self.count if entry.axis >= 2 else 1)
            or (entry.axis >= 2 and entry.shape[0] != 1)
        ):
            raise UnreadableError("a convolution over several points")
        of_kernel = self._look(kernel)
        if isinstance(of_kernel, _OfTheta):
            weight = self.operands.number(Operand(of_kernel.base, of_kernel.index.flatten(1).T))
        else:
            weight = self.operands.number(_constant(of_kernel.to(self.theta).flatten(1).T))
        shape = tuple(call.result.shape)
        row = None
        if bias is not None:
            of_bias = self._look(bias)
            if isinstance(of_bias, _OfTheta):
                row = self.operands.number(Operand(of_bias.base, of_bias.index))
            else:
                row = self.operands.number(_constant(of_bias.to(self.theta)))
        self.nodes.append(Affine(entry.node, weight, row))
        self._enter(call.result, _OfPoints(len(self.nodes) - 1, entry.axis, shape))

    # Elementwise

    def _elementwise(self, call: Call, name: str) -> None:
        entry = self._look(call.arguments[0])
        if not isinstance(entry, _OfPoints):
            raise UnreadableError(f"it calls {name}")
        function = call.function
        if function._schema.is_mutable:
            function = getattr(getattr(torch.ops.aten, name), function._overloadname)
        source, scale = entry.node, 1.0
        before = self.nodes[source]
        # sin(30 z) and the like are one step.
        if isinstance(before, Linear) and before.shift is None and isinstance(before.factor, float):
            source, scale = before.source, before.factor
        node = Elementwise(source, function, tuple(call.arguments[1:]), dict(call.named), scale)
        self._add(node, call.result, entry.axis)

    def _pair(self, call: Call) -> tuple[Any, Any, tuple[int, ...], int]:
        """Two arguments, the shape of the result and its axis of points."""
        a, b = call.arguments[:2]
        shape = tuple(call.result.shape)
        entry = next(e for e in (self._look(a), self._look(b)) if isinstance(e, _OfPoints))
        return a, b, shape, entry.axis + len(shape) - len(entry.shape)

    def _read_add(self, call: Call) -> None:
        self._sum(call, 1.0, float(call.named.get("alpha", 1)))

    def _read_sub(self, call: Call) -> None:
        self._sum(call, 1.0, -float(call.named.get("alpha", 1)))

    def _read_rsub(self, call: Call) -> None:
        alpha = float(call.arguments[2] if len(call.arguments) > 2 else call.named.get("alpha", 1))
        self._sum(call, -alpha, 1.0)

    def _sum(self, call: Call, of_a: float, of_b: float) -> None:
        a, b, shape, axis = self._pair(call)
        if not isinstance(self._look(a), _OfPoints):
            a, b, of_a, of_b = b, a, of_b, of_a
        x = self._at_points(a, shape, axis)
        if isinstance(self._look(b), _OfPoints):
            y = self._at_points(b, shape, axis)
            node = x.node
            if of_a != 1:
                self.nodes.append(Linear(node, of_a))
                node = len(self.nodes) - 1
            self._add(Sum((node, y.node), of_b), call.result, axis)
            return
        if isinstance(b, (int, float)) and b * of_b == 0:
            self._add(Linear(x.node, of_a), call.result, axis)
            return
        self._add(Linear(x.node, of_a, self._operand(b, shape, axis), of_b), call.result, axis)

    def _read_mul(self, call: Call) -> None:
        a, b, shape, axis = self._pair(call)
        if not isinstance(self._look(a), _OfPoints):
            a, b = b, a
        x = self._at_points(a, shape, axis)
        other = self._look(b)
        if isinstance(other, _OfPoints):
            self._add(Product((x.node, self._at_points(b, shape, axis).node)), call.result, axis)
        elif isinstance(other, _OfTheta):
            self._add(Scaled(x.node, self._operand(b, shape, axis)), call.result, axis)
        else:
            self._add(Linear(x.node, self._factor(b, shape, axis)), call.result, axis)

    def _read_neg(self, call: Call) -> None:
        entry = self._look(call.arguments[0])
        self._add(Linear(entry.node, -1.0), call.result, entry.axis)

    def _read_div(self, call: Call) -> None:
        if call.named.get("rounding_mode") is not None:
            raise UnreadableError("a division that rounds")
        a, b, shape, axis = self._pair(call)
        other = self._look(b)
        if not isinstance(other, (_OfPoints, _OfTheta)):
            factor = self._factor(b, shape, axis)
            self._add(Linear(self._at_points(a, shape, axis).node, 1 / factor), call.result, axis)
            return
        y = self._at_points(b, shape, axis)
        self.nodes.append(Elementwise(y.node, torch.ops.aten.reciprocal.default, (), {}))
        inverse = len(self.nodes) - 1
        self._add(Product((self._at_points(a, shape, axis).node, inverse)), call.result, axis)

    # Sums within a point

    def _read_sum(self, call: Call) -> None:
        entry, node = self._summed(call)
        self._enter(call.result, _OfPoints(node, self._left(entry, call), tuple(call.result.shape)))

    def _read_mean(self, call: Call) -> None:
        entry, node = self._summed(call)
        self.nodes.append(Linear(node, call.result.numel() / prod(entry.shape)))
        self._enter(call.result, _OfPoints(len(self.nodes) - 1, self._left(entry, call), tuple(call.result.shape)))

    def _read_linalg_vector_norm(self, call: Call) -> None:
        if len(call.arguments) > 1 and call.arguments[1] != 2:
            raise UnreadableError("a norm that is not the Euclidean one")
        entry = self._look(call.arguments[0])
        self.nodes.append(Elementwise(entry.node, torch.ops.aten.pow.Tensor_Scalar, (2,), {}))
        squares = _OfPoints(len(self.nodes) - 1, entry.axis, entry.shape)
        _, node = self._summed(call, squares, 2)
        self.nodes.append(Elementwise(node, torch.ops.aten.sqrt.default, (), {}))
        place = self._left(entry, call, 2)
        self._enter(call.result, _OfPoints(len(self.nodes) - 1, place, tuple(call.result.shape)))

    def _dims(self, entry: _OfPoints, call: Call, at: int) -> list[int]:
        dims = call.arguments[at] if len(call.arguments) > at else call.named.get("dim")
        dims = list(range(len(entry.shape))) if dims in (None, []) else [dims] if isinstance(dims, int) else list(dims)
        dims = [dim % len(entry.shape) for dim in dims]
        if entry.axis in dims:
            raise UnreadableError("points are summed over")
        return dims

    def _summed(self, call: Call, entry: _OfPoints | None = None, at: int = 1) -> tuple[_OfPoints, int]:
        entry = self._look(call.arguments[0]) if entry is None else entry
        assert isinstance(entry, _OfPoints)
        dims = self._dims(entry, call, at)
        kept = [1 if k in dims else size for k, size in enumerate(entry.shape) if k != entry.axis]
        full = [size for k, size in enumerate(entry.shape) if k != entry.axis]
        index = torch.arange(prod(kept)).view(kept).expand(full).flatten()
        self.nodes.append(Gathered(entry.node, index.to(self.points.device), prod(kept)))
        return entry, len(self.nodes) - 1

    def _left(self, entry: _OfPoints, call: Call, at: int = 1) -> int:
        """The axis of points after a sum."""
        dims = self._dims(entry, call, at)
        keeps = len(call.result.shape) == len(entry.shape)
        return entry.axis if keeps else entry.axis - sum(dim < entry.axis for dim in dims)

    def _pruned(self, output: int) -> Steps:
        """The steps that lead to the output."""
        needed = {output}
        for k in range(len(self.nodes) - 1, 0, -1):
            step = self.nodes[k]
            if k in needed and step is not None:
                needed.update(step.sources)
        nodes = {k: step for k, step in enumerate(self.nodes) if k in needed and step is not None}
        if output not in nodes:
            raise UnreadableError("it does nothing")
        self.operands.used = {operand for step in nodes.values() for operand in step.operands}
        return Steps(nodes, output, self.operands)


def _constant(value: Tensor) -> Operand:
    return Operand(CONSTANT, torch.empty(0, dtype=torch.long), value.detach().clone())


def _distinct(indices: Sequence[Tensor]) -> list[Tensor]:
    return list({(i.cpu().numpy().tobytes(), i.numel()): i for i in indices}.values())


def _tensors(value: Any) -> list[Tensor]:
    """All tensors in nested lists, tuples and dicts."""
    if isinstance(value, Tensor):
        return [value]
    if isinstance(value, dict):
        return [t for part in value.values() for t in _tensors(part)]
    if isinstance(value, (list, tuple)):
        return [t for part in value for t in _tensors(part)]
    return []
