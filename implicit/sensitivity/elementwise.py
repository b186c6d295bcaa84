"""Elementwise functions s(z) of a network with their first and second derivatives.

The common activations have theirs written out; every other elementwise function of one argument is differentiated by
torch, twice. Where a function has a kink, its derivative there is the one that torch gives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

# Value, first and second derivative; None is zero everywhere.
Derivatives = tuple[Tensor, Tensor | None, Tensor | None]

ROOT_OF_TWO_PI = (2 * torch.pi) ** 0.5


def derivatives(function: Any, z: Tensor, arguments: tuple[Any, ...], named: dict[str, Any]) -> Derivatives:
    """Return s(z), s'(z) and s''(z) of an elementwise operator of torch.

    Args:
        function: The operator, such as torch.ops.aten.softplus.default.
        z: Its argument, of any shape.
        arguments, named: Its further arguments.
    """
    known = _KNOWN.get(function.overloadpacket._qualified_op_name.partition("::")[2])
    if known is not None and not named and not any(isinstance(value, Tensor) for value in arguments):
        result = known(z, *arguments)
        if result is not None:
            return result

    with torch.enable_grad():
        at = z.detach().requires_grad_()
        value = function(at, *arguments, **named)
        (slope,) = torch.autograd.grad(value.sum(), at, create_graph=True)
        bend = torch.autograd.grad(slope.sum(), at)[0] if slope.requires_grad else None
    return value.detach(), slope.detach(), bend


def _relu(z: Tensor) -> Derivatives:
    return torch.relu(z), (z > 0).to(z), None


def _leaky_relu(z: Tensor, slope: float = 0.01) -> Derivatives:
    # The value of torch's own, and a slope that is exact in single precision too.
    return torch.nn.functional.leaky_relu(z, slope), torch.full_like(z, slope).masked_fill_(z > 0, 1.0), None


def _softplus(z: Tensor, beta: float = 1.0, threshold: float = 20.0) -> Derivatives:
    rise = torch.sigmoid(beta * z).masked_fill_(beta * z > threshold, 1.0)  # linear beyond, as in torch
    return torch.nn.functional.softplus(z, beta, threshold), rise, (beta * rise).mul_(1 - rise)


def _elu(z: Tensor, alpha: float = 1.0, scale: float = 1.0, input_scale: float = 1.0) -> Derivatives:
    right = z > 0
    fall = torch.exp(input_scale * z.clamp(max=0)).mul_(alpha * scale * input_scale)
    value = torch.ops.aten.elu(z, alpha, scale, input_scale)
    return value, fall.masked_fill(right, scale), (input_scale * fall).masked_fill_(right, 0.0)


def _celu(z: Tensor, alpha: float = 1.0) -> Derivatives:
    return _elu(z, alpha, 1.0, 1.0 / alpha)


def _silu(z: Tensor) -> Derivatives:
    rise = torch.sigmoid(z)
    rest = rise * (1 - rise)
    return z * rise, rise + z * rest, rest * (2 + z * (1 - 2 * rise))


def _gelu(z: Tensor) -> Derivatives:
    density = torch.exp(-z.square() / 2).div_(ROOT_OF_TWO_PI)
    share = torch.special.ndtr(z)
    return torch.nn.functional.gelu(z), share + z * density, density * (2 - z.square())


def _tanh(z: Tensor) -> Derivatives:
    t = torch.tanh(z)
    rise = 1 - t.square()
    return t, rise, -2 * t * rise


def _sigmoid(z: Tensor) -> Derivatives:
    s = torch.sigmoid(z)
    rise = s * (1 - s)
    return s, rise, rise * (1 - 2 * s)


def _sin(z: Tensor) -> Derivatives:
    wave = torch.sin(z)
    return wave, torch.cos(z), -wave


def _cos(z: Tensor) -> Derivatives:
    wave = torch.cos(z)
    return wave, -torch.sin(z), -wave


def _exp(z: Tensor) -> Derivatives:
    e = torch.exp(z)
    return e, e, e


def _hardtanh(z: Tensor, lower: float = -1.0, upper: float = 1.0) -> Derivatives:
    return z.clamp(lower, upper), ((z > lower) & (z < upper)).to(z), None


def _clamp(z: Tensor, lower: float | None = None, upper: float | None = None) -> Derivatives:
    within = torch.ones_like(z, dtype=torch.bool)
    if lower is not None:
        within &= z >= lower
    if upper is not None:
        within &= z <= upper
    return z.clamp(lower, upper), within.to(z), None


def _abs(z: Tensor) -> Derivatives:
    return z.abs(), z.sign(), None


def _pow(z: Tensor, power: float) -> Derivatives | None:
    return (z.square(), 2 * z, torch.full_like(z, 2.0)) if power == 2 else None


_KNOWN: dict[str, Callable[..., Derivatives | None]] = {
    "relu": _relu,
    "leaky_relu": _leaky_relu,
    "softplus": _softplus,
    "elu": _elu,
    "celu": _celu,
    "silu": _silu,
    "gelu": _gelu,
    "tanh": _tanh,
    "sigmoid": _sigmoid,
    "sin": _sin,
    "cos": _cos,
    "exp": _exp,
    "hardtanh": _hardtanh,
    "clamp": _clamp,
    "abs": _abs,
    "pow": _pow,
}
