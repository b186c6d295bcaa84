"""Subjects that a fit trains, in coordinates u of [-1, 1]^D: a new network of ours, or a field that someone brings.

    x = middle + half u,     f(x) = half g(u)

A new network is g itself, and the map is folded into its first and last layer at the end. A field that is brought is f,
whatever its module: theta is trained in tensors of its own, linear layers by SOAP and all else by Adam, and the module
is only read.
"""

from __future__ import annotations

import hashlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.field.field import CUBE, Bounds, Field, Units
from implicit.models.linear import unset_linear
from implicit.models.mlp import Mlp
from implicit.models.siren import Siren


class NewNetwork:
    """A Siren or an Mlp from its first weights on."""

    def __init__(self, network: Siren | Mlp, middle: Tensor, half: float, units: Units | None) -> None:
        self._network, self._middle, self._half, self._units = network, middle, half, units

    def modules(self) -> dict[str, nn.Module]:
        """Return the networks by name; their linear layers are moved by SOAP."""
        return {"module": self._network}

    def others(self) -> list[Tensor]:
        """Return all else that is trained."""
        return []

    def describe(self) -> Any:
        """Return what tells this start from others, as plain data."""
        return self._network.describe()

    def value(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return g, differentiable in the points and the parameters."""
        return self._network(u)

    def value_and_gradient(self, u: Float[Tensor, "n d"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n d"]]:
        """Return g and dg/du without a graph."""
        # A network of ours needs no examination, and one that has diverged would not pass it.
        return Field(self._network, bounds=unit_box(u.shape[1]), check=False).value_and_gradient(u)

    def field(self, box: Float[Tensor, "2 d"]) -> Field:
        """Return the field in the user's coordinates; the network is spent by it."""
        _fold(self._network, self._middle, self._half)
        return Field(self._network, bounds=(box[0].tolist(), box[1].tolist()), units=self._units, check=False)


class StartedField:
    """A field from the theta that it has.

    Attributes:
        own: The field to start from.
    """

    def __init__(self, own: Field, middle: Tensor, half: float) -> None:
        self.own = own
        self._middle, self._half = middle.to(own.theta), half
        self._blocks = {
            block.name: nn.Parameter(own.theta[block.where].view(block.shape).clone()) for block in own.layout
        }
        self._layers = nn.ModuleList()
        rest = dict(self._blocks)
        for name in self._blocks:
            layer, _, kind = name.rpartition(".")
            weight, bias = self._blocks.get(f"{layer}.weight"), self._blocks.get(f"{layer}.bias")
            if kind == "weight" and weight is not None and bias is not None and _is_linear(own, layer):
                shell = unset_linear(weight.shape[1], weight.shape[0])
                shell.weight, shell.bias = weight, bias
                self._layers.append(shell)
                del rest[f"{layer}.weight"], rest[f"{layer}.bias"]
        self._others: list[Tensor] = list(rest.values())

    def modules(self) -> dict[str, nn.Module]:
        """Return the linear layers, which are moved by SOAP."""
        return {"layers": self._layers}

    def others(self) -> list[Tensor]:
        """Return all other blocks of theta, which are moved by Adam."""
        return self._others

    def describe(self) -> Any:
        """Return what tells this start from others, as plain data."""
        own = self.own
        shapes = [[block.name, list(block.shape)] for block in own.layout]
        theta = hashlib.sha256(own.theta.cpu().numpy().tobytes()).hexdigest()
        return [type(own.module).__name__, shapes, theta, own.level, own.inside]

    def value(self, u: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Return g, differentiable in the points and the parameters."""
        return self.own.function(self._theta(), self._middle + self._half * u) / self._half

    def value_and_gradient(self, u: Float[Tensor, "n d"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n d"]]:
        """Return g and dg/du without a graph."""
        values, gradients = self._trained().value_and_gradient(self._middle + self._half * u)
        return values / self._half, gradients

    def field(self, box: Float[Tensor, "2 d"]) -> Field:
        """Return the field as it is now; its write_back reaches what the start was made from."""
        return self._trained()

    def require_derivatives(self, u: Float[Tensor, "n d"]) -> None:
        """Refuse a field that cannot be trained on its values and normals, at a few points.

        Raises:
            ValueError: Its value or gradient cannot be differentiated in its parameters, or does not depend on them.
        """
        kind = "function" if self.own.module is None else type(self.own.module).__name__
        remedy = "Its forward must take any number of points and be differentiable twice, without detach or no_grad."
        x = u.detach().clone().requires_grad_()
        try:
            values = self.value(x)
            (gradient,) = torch.autograd.grad(values.sum(), x, create_graph=True)
            blocks = list(self._blocks.values())
            found = torch.autograd.grad(values.square().mean() + gradient.square().mean(), blocks, allow_unused=True)
        except RuntimeError as error:
            raise ValueError(
                f"module cannot be trained on values and normals: at {len(u)} points, the value of the {kind} or its "
                f"gradient has no derivative in its parameters ({str(error).splitlines()[0]}). {remedy}"
            ) from error
        # What is differentiable once gives a gradient without a history, which is right only where it is constant.
        if not gradient.requires_grad and not torch.allclose(gradient, gradient[:1].expand_as(gradient)):
            raise ValueError(
                f"module cannot be trained on normals: the gradient of the {kind} changes from point to point, but has "
                f"no derivative. {remedy}"
            )
        if not any(part is not None and bool(part.any()) for part in found):
            raise ValueError(
                f"module cannot be trained: at {len(u)} points the values of the {kind} do not depend on any of its "
                "parameters. Let its forward use them, or start from other weights."
            )

    def _theta(self) -> Float[Tensor, " p"]:
        return torch.cat([block.reshape(-1) for block in self._blocks.values()])

    def _trained(self) -> Field:
        return self.own.with_theta(self._theta().detach())


def starting_field(
    module: nn.Module | None,
    start: Field | None,
    *,
    dimension: int,
    bounds: Bounds | None = None,
    units: Units | None = None,
    dtype: torch.dtype | None = None,
) -> Field:
    """Return the field that a training starts from: a module's parameters that require gradients, or a field's own.

    Raises:
        TypeError: The module is none, or does not map points to values; or the start is no field.
        ValueError: Both are given, the module has nothing to train, or the dimension or the bounds differ.
    """
    if start is not None:
        if module is not None:
            raise ValueError("Give module or start, but not both: a start brings its own module.")
        if not isinstance(start, Field):
            raise TypeError(
                f"start must be a Field to go on from, but is a {type(start).__name__}. For a module use module=..."
            )
        if bounds is not None:
            raise ValueError("bounds are those of the start: leave them out, or make the Field with others.")
        if start.dimension != dimension:
            raise ValueError(f"start must have {dimension} coordinates like the points, but has {start.dimension}.")
        field = start.to(dtype) if dtype is not None else start.with_theta(start.theta)
        if units is not None:
            field.units = units
        return field
    if not isinstance(module, nn.Module):
        raise TypeError(
            f"module must be a torch module to train, but is {module!r}. Make it first, or leave it out for a Siren."
        )
    named = dict(module.named_parameters())
    trained = [name for name, parameter in named.items() if parameter.requires_grad]
    if named and not trained:
        raise ValueError(
            f"module has nothing to train: all parameters of the {type(module).__name__} are frozen. Thaw those that "
            "are to be trained by requires_grad_(True)."
        )
    box = unit_box(dimension) if bounds is None else bounds
    names = trained if len(trained) < len(named) else None
    field = Field(module, parameters=names, bounds=box, units=units)
    return field if dtype is None else field.to(dtype)


def _is_linear(field: Field, name: str) -> bool:
    try:
        return type(field.module.get_submodule(name)) is nn.Linear if field.module is not None else False
    except AttributeError:
        return False


def unit_box(dimension: int) -> Bounds:
    """Return the corners of [-1, 1]^D."""
    return CUBE[0][:dimension], CUBE[1][:dimension]


@torch.no_grad()
def _fold(module: Siren | Mlp, middle: Tensor, half: float) -> None:
    """Make module(x) what half * module((x - middle) / half) was."""
    if half == 1 and not bool(middle.any()):
        return
    first, last = module.layers[0], module.layers[-1]
    assert isinstance(first, nn.Linear)
    assert isinstance(last, nn.Linear)
    first.weight.div_(half)
    first.bias.sub_(first.weight @ middle.to(first.weight))
    last.weight.mul_(half)
    last.bias.mul_(half)
