"""One column of the boundary sensitivity: the motion of the surface that one parameter spans.

    b_k(x) = -(df/dtheta_k) / |df/dx|                                                    [paper, eq. 3 and fig. 3]

Weights of the first layer move the surface in waves as long as the network's lowest frequencies, deeper ones in
products of them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_whole
from implicit.field.evaluator import Parameter
from implicit.field.field import Field, require_field
from implicit.sensitivity.boundary_sensitivity import normal_displacement


@dataclass(frozen=True, eq=False)
class BasisFunction:
    """A function on the surface: outward speed per unit of one parameter.

    Attributes:
        field: The field whose parameter it is.
        name: Name of the parameter's block and its place in it, such as "layers.1.weight[3, 7]".
        index: Place of the parameter in theta.
    """

    field: Field
    name: str
    index: int

    def __repr__(self) -> str:
        return f"BasisFunction: {self.name}, theta[{self.index}] of P = {len(self.field.theta):,}"

    def __call__(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return the length per unit of the parameter at surface points (N, D), without making the other columns."""
        unit = torch.zeros_like(self.field.theta)
        unit[self.index] = 1.0
        return normal_displacement(self.field, points, unit)


def basis_function(field: Field, parameter: int | str) -> BasisFunction:
    """Return the basis function of one parameter.

    Args:
        field: The field.
        parameter: Place in theta, or name as in "layers.1.weight[3, 7]"; a block of one number needs no
            brackets.

    Raises:
        ValueError: There is no such parameter.
    """
    require_field(field)
    if isinstance(parameter, str):
        return BasisFunction(field, parameter, _index(field, parameter))
    require_whole("parameter", parameter, 0, "", len(field.theta) - 1)
    return BasisFunction(field, _name(field, parameter), parameter)


def one_weight_per_layer(field: Field, seed: int = 0) -> list[BasisFunction]:
    """Return the basis function of a random weight of each layer, in the order in which the module holds its layers.

    Args:
        field: The field; its blocks of one dimension, the biases, are left out.
        seed: Seed of the random choice.
    """
    require_field(field)
    generator = torch.Generator().manual_seed(seed)
    chosen = []
    for block in field.layout:
        if len(block.shape) >= 2:  # the others are biases
            offset = int(torch.randint(0, block.shape.numel(), (1,), generator=generator))
            chosen.append(basis_function(field, block.where.start + offset))
    return chosen


def _name(field: Field, index: int) -> str:
    block = next(block for block in field.layout if block.where.start <= index < block.where.stop)
    place = torch.unravel_index(torch.tensor(index - block.where.start), block.shape)
    return f"{block.name}[{', '.join(str(int(k)) for k in place)}]" if len(block.shape) else block.name


def _index(field: Field, name: str) -> int:
    match = re.fullmatch(r"(?P<block>[^\[\]]+)(\[(?P<place>[\d,\s]+)\])?", name.strip())
    block = None if match is None else next((b for b in field.layout if b.name == match["block"]), None)
    if match is None or block is None:
        raise ValueError(
            f"There is no parameter {name!r}. Blocks are {', '.join(b.name for b in field.layout)}; a weight is named "
            f'as in "{field.layout[0].name}{_first_place(field.layout[0])}".'
        )
    place = [int(k) for k in match["place"].split(",")] if match["place"] else []
    if not place and block.shape.numel() == 1:
        return block.where.start
    if len(place) != len(block.shape) or not all(k < side for k, side in zip(place, block.shape, strict=True)):
        raise ValueError(
            f"The place in {name!r} must fit the shape {tuple(block.shape)} of {block.name}, counted from 0, but is "
            f"{place}."
        )
    offset = 0
    for k, side in zip(place, block.shape, strict=True):
        offset = offset * side + k
    return block.where.start + offset


def _first_place(block: Parameter) -> str:
    return f"[{', '.join('0' for _ in block.shape)}]" if len(block.shape) else ""
