"""Rows of df/dtheta of fields in which few parameters act at a point: features on grids, read near the point alone.

    df/dtheta = sum over the nodes of x of (df/d value) e_node,  and the decoder's part, which is dense

A module that says which parameters act where (`local_parameters`, as the grids of implicit.models do) is differentiated
by the few values of each point: that costs as much as there are nodes, not as there are parameters. Of any other module
the rows are made by blocks and their zeros dropped: the memory stays small, and the solve is sparse all the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array, vstack
from torch import Tensor
from torch.func import grad, vmap

from implicit.field.evaluator import OfModule, Parameter
from implicit.field.field import Field
from implicit.field.forms import Form
from implicit.sensitivity.boundary_sensitivity import parameter_gradient
from implicit.sensitivity.closed_form import has_closed_form

# Numbers in a block of rows that is made before its zeros are dropped, 128 MB in float64.
BLOCK = 16_000_000

# Fewest parameters of which it is worth to look for zeros, the points looked at, and the share that may act at one.
LEAST_PARAMETERS, PROBES, ACTING = 4000, 16, 1 / 8


@runtime_checkable
class LocalModule(Protocol):
    """A module that says which of its parameters act at which points."""

    def local_parameters(self, points: Float[Tensor, "n d"]) -> dict[str, Int[Tensor, "n k"]]:
        """Return places in the flattened parameter of each name that act at each point; all others do not.

        Parameters that are not named may act anywhere.
        """

    def forward(self, points: Float[Tensor, "n d"], local: Mapping[str, Float[Tensor, "n k"]] | None = None) -> Tensor:
        """Return the values at the points, with these values of local parameters in place of its own."""


def has_sparse_rows(field: Field, points: Float[Tensor, "n d"]) -> bool:
    """Return whether few of the parameters act at a point: as the module says, or as some of the points show.

    Args:
        field: The field.
        points: Points (N, D) anywhere, in any order.
    """
    if field.takes_code or has_closed_form(field) or len(points) == 0:
        return False
    if (module := _local_module(field)) is not None:
        return _local_blocks(field, module)[0] != []
    if len(field.theta) < LEAST_PARAMETERS:
        return False
    probes = points[torch.linspace(0, len(points) - 1, min(PROBES, len(points))).long()]
    return _by_blocks(field, probes).nnz <= ACTING * len(probes) * len(field.theta)


def sparse_parameter_gradient(field: Field, points: Float[Tensor, "n d"]) -> csr_array:
    """Return df/dtheta at each point as a sparse matrix (N, P) in float64, on the CPU.

    Args:
        field: The field.
        points: Points (N, D) anywhere in the bounds.
    """
    size = len(points), len(field.theta)
    if len(points) == 0:
        return csr_array(size)
    if (module := _local_module(field)) is not None and _local_blocks(field, module)[0]:
        return _by_local_values(field, module, points)
    return _by_blocks(field, points)


def _local_module(field: Field) -> LocalModule | None:
    """Return the module as it is evaluated, where it says which parameters act and takes points as they are."""
    evaluator = field._evaluator
    module = evaluator.module
    return module if isinstance(module, LocalModule) and evaluator.form == Form() else None


def _by_blocks(field: Field, points: Tensor) -> csr_array:
    """Return the rows of any module, made in blocks whose zeros are dropped."""
    step = max(1, BLOCK // len(field.theta))
    blocks = [csr_array(parameter_gradient(field, part).double().cpu().numpy()) for part in points.split(step)]
    return vstack(blocks, format="csr")


def _by_local_values(field: Field, module: LocalModule, points: Tensor) -> csr_array:
    """Return the rows of a module that says which parameters act where."""
    evaluator = field._evaluator
    assert isinstance(evaluator, OfModule)
    local_blocks, other_blocks = _local_blocks(field, module)
    others = {block.name: field.theta[block.where].view(block.shape) for block in other_blocks}
    theta = {block.name: field.theta[block.where] for block in local_blocks}
    fixed = {block.name: field.theta[block.where].view(block.shape) for block in local_blocks}

    def value(local: dict[str, Tensor], other: dict[str, Tensor], point: Tensor) -> Tensor:
        rows = {name: values[None] for name, values in local.items()}
        f = evaluator.with_values({**fixed, **other}, point[None], rows)
        return f.reshape(()) * field.sign

    gradient = vmap(grad(value, argnums=(0, 1)), in_dims=(0, None, 0))
    blocks = []
    for part in points.split(_points_at_once(module, points, others)):
        with torch.no_grad():
            named = module.local_parameters(part)
        named = {block.name: named[block.name] for block in local_blocks}
        of_local, of_others = gradient({name: theta[name][index] for name, index in named.items()}, others, part)
        columns = [named[block.name] + block.where.start for block in local_blocks]
        values = [of_local[block.name] for block in local_blocks]
        for block in other_blocks:
            place = torch.arange(block.where.start, block.where.stop, device=part.device)
            columns.append(place.expand(len(part), -1))
            values.append(of_others[block.name].flatten(1))
        blocks.append(_csr(torch.cat(columns, dim=1), torch.cat(values, dim=1), len(field.theta)))
    return vstack(blocks, format="csr")


def _points_at_once(module: LocalModule, points: Tensor, others: dict[str, Tensor]) -> int:
    named = module.local_parameters(points[:1])
    width = sum(index.shape[1] for index in named.values()) + sum(values.numel() for values in others.values())
    return max(1, BLOCK // (4 * max(width, 1)))  # the pass keeps a few such blocks


def _csr(columns: Tensor, values: Tensor, size: int) -> csr_array:
    """Return rows of equally many entries as a sparse matrix; entries of the same place add up."""
    count, width = columns.shape
    ends = np.arange(0, count * width + 1, width)
    matrix = csr_array(
        (values.double().flatten().cpu().numpy(), columns.flatten().cpu().numpy(), ends), shape=(count, size)
    )
    matrix.sum_duplicates()
    return matrix


def _local_blocks(field: Field, module: LocalModule) -> tuple[list[Parameter], list[Parameter]]:
    """Return the edited parameters that act at few points each, and the others."""
    with torch.no_grad():
        named = module.local_parameters(field.bounds[:1])
    local = [block for block in field.layout if block.name in named]
    return local, [block for block in field.layout if block.name not in named]
