"""Parameters of a field moved as a whole: f'(x) = f(R^T (x - t)), exactly, where the points enter affine maps alone.

Of a layer z = W^T a + b whose inputs a hold L x + c (the points, scaled and shifted, perhaps beside other values), with
M those rows of W and A = L^T M,

    A' = R A,    M' = M + L (L^T L)^-1 (A' - A),    b' = b + c^T (M - M') - t^T A'.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.closed_form import closed_form_of
from implicit.sensitivity.nodes import Affine, Chosen, Joined, Linear, Step
from implicit.sensitivity.operands import CONSTANT, THETA
from implicit.sensitivity.row_factors import Columns
from implicit.sensitivity.tracing import Steps


@dataclass(frozen=True, eq=False)
class _Entry:
    """Columns of a value: which are affine in the points, with what coefficients (w, D) and constants (w,)."""

    mask: Tensor
    linear: Tensor
    constant: Tensor


@dataclass(frozen=True, eq=False)
class _Gate:
    """A layer that takes the points: its inputs that hold them, and where its weights and biases are in theta."""

    entry: _Entry
    weight: Tensor  # (in, out)
    bias: Tensor  # (out,)
    scale: Tensor  # (out,), of the weights to what theta holds


def moved_as_a_whole(
    field: Field, rotation: Float[Tensor, "d d"], translation: Float[Tensor, " d"]
) -> Float[Tensor, " p"] | None:
    """Return the parameters at which the field is the same but for a rigid motion x -> R x + t; None if it cannot be.

    Args:
        field: Any field.
        rotation: R.
        translation: t.
    """
    form = closed_form_of(field)
    gates = None if form is None else _gates(form.steps, form.columns, field)
    if form is None or gates is None:
        return None
    theta = field.theta.clone()
    for gate in gates:
        linear, constant = gate.entry.linear[gate.entry.mask], gate.entry.constant[gate.entry.mask]
        where = gate.weight[gate.entry.mask]
        part = field.theta[where]
        square = linear.T @ linear
        if not bool(torch.linalg.matrix_rank(square) == len(square)):
            return None
        back = torch.linalg.solve(square, linear.T).T
        now = linear.T @ part
        turned = rotation @ now
        new = (part - back @ now) + back @ turned
        theta[where] = new
        theta[gate.bias] += gate.scale * (constant @ (part - new) - translation @ turned)
    # Weights under a norm keep it where the points are scaled alike in all directions, which this finds out.
    points = field.bounds[0] + (field.bounds[1] - field.bounds[0]) * _LATTICE[:, : field.dimension].to(field.theta)
    with torch.no_grad():
        expected = form.value(field.theta, points)
        found = form.value(theta, points @ rotation.T + translation)
    tolerance = 1e-9 if field.dtype == torch.float64 else 1e-4
    return theta if bool((found - expected).abs().max() <= tolerance * expected.abs().max()) else None


_LATTICE = torch.tensor(
    [[0.2, 0.3, 0.6], [0.7, 0.2, 0.4], [0.5, 0.8, 0.3], [0.9, 0.6, 0.8], [0.1, 0.9, 0.1]], dtype=torch.float64
)


def _gates(steps: Steps, columns: Columns, field: Field) -> list[_Gate] | None:
    """The layers that the points enter by; None where they enter otherwise."""
    eye = torch.eye(field.dimension).to(field.theta)
    points = _Entry(torch.ones_like(eye[0], dtype=torch.bool), eye, torch.zeros_like(eye[0]))
    entries: dict[int, _Entry | None] = {0: points}  # None: a value that holds no points as they are
    gates = []
    for k, node in steps.nodes.items():
        sources = [entries[source] for source in node.sources]
        if all(source is None for source in sources):
            entries[k] = None
        elif isinstance(node, Affine):
            gate = _gate(node, sources[0], columns, field.theta)
            if gate is None:
                return None
            gates.append(gate)
            entries[k] = None
        else:
            entry = _carried(node, sources, steps, field)
            if entry is None:
                return None
            entries[k] = entry
    return gates if entries[steps.output] is None else None


def _gate(node: Affine, entry: _Entry | None, columns: Columns, theta: Tensor) -> _Gate | None:
    """The layer, if its weights (under a norm, their directions) and biases are edited and stand for nothing else."""
    if entry is None or node.bias is None or not {node.weight, node.bias} <= columns.alone:
        return None
    weight, bias = (columns.operands.all[k] for k in (node.weight, node.bias))
    if bias.base != THETA or bias.repeats or weight.repeats:
        return None
    if weight.base == THETA:
        return _Gate(entry, weight.index, bias.index, torch.ones_like(theta[bias.index]))
    norm = columns.operands.derived[weight.base].norm
    if norm is None:
        return None
    group = norm.group[weight.index]
    if not torch.equal(group[:1].expand(group.shape), group):
        return None
    return _Gate(entry, norm.v.index[weight.index], bias.index, norm.parts(theta)[1][group[0]])


def _carried(node: Step, sources: list[_Entry | None], steps: Steps, field: Field) -> _Entry | None:
    """Return what becomes of points in a step that only scales, shifts, joins or picks columns."""
    if isinstance(node, Joined):
        parts = []
        for source, width in zip(sources, node.widths, strict=True):
            empty = field.theta.new_zeros(width)
            nothing = _Entry(empty.bool(), empty[:, None].expand(-1, field.dimension), empty)
            parts.append(nothing if source is None else source)
        return _Entry(
            torch.cat([part.mask for part in parts]),
            torch.cat([part.linear for part in parts]),
            torch.cat([part.constant for part in parts]),
        )
    source = sources[0]
    if source is None or len(sources) > 1:
        return None
    if isinstance(node, Chosen):
        return _Entry(source.mask[node.index], source.linear[node.index], source.constant[node.index])
    if not isinstance(node, Linear):
        return None
    factor = torch.as_tensor(node.factor, dtype=field.dtype, device=field.device).expand(len(source.mask))
    constant = source.constant * factor
    if node.shift is not None:
        shift = steps.operands.all[node.shift]
        if shift.base != CONSTANT or shift.constant is None:
            return None
        constant = constant + node.share * shift.constant
    return _Entry(source.mask, source.linear * factor[:, None], constant)
