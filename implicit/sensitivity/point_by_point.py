"""Parameter derivatives of modules that torch cannot vectorise: point by point, slowly, to the same digits.

Data-dependent branches, in-place operations, autograd.Functions of the old style, checkpointed activations and scripted
modules refuse torch.func. Each point then takes a forward and a backward pass of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.field.torch_errors import first_line, in_our_words, is_memory

T = TypeVar("T")


def vectorised(field: Field, what: str, compute: Callable[[], T]) -> T | None:
    """Return what torch.func computes of a field, or None where it refuses the module, which is asked once.

    Args:
        field: The field, whose module's refusal is remembered.
        what: Name of what is computed.
        compute: Computes it.
    """
    refused = field.findings.setdefault("not vectorised", {})
    if what in refused:
        return None
    try:
        # Parameters that no copy reached may still ask for a graph; what comes from here has none.
        with torch.no_grad():
            return compute()
    except Exception as error:
        if is_memory(error):
            raise
        refused[what] = first_line(error.__cause__ or error)
        return None


def rows_point_by_point(field: Field, points: Float[Tensor, "n d"], *, slopes: bool = False) -> Float[Tensor, "n e p"]:
    """Return df/dtheta at each point, (N, 1, P), and after it d(df/dtheta)/dx where slopes are asked, (N, 1 + D, P).

    Warns:
        RuntimeWarning: Always: that it is slow, and why torch could not do better.

    Raises:
        TypeError: The module cannot be differentiated this way either.
    """
    reasons = list(field.findings.get("not vectorised", {}).values())
    warnings.warn(
        f"The module cannot be vectorised over points ({reasons[0] if reasons else 'not tried'}), so they are "
        "differentiated one by one, which is slow. In-place operations, data-dependent branches and autograd.Functions "
        "of the old style are the usual cause.",
        RuntimeWarning,
        stacklevel=4,
    )
    theta = field.theta.detach().requires_grad_()
    rows = points.new_empty(len(points), 1 + (points.shape[1] if slopes else 0), len(theta))
    with torch.enable_grad(), in_our_words("be differentiated by its parameters"):
        for row, point in zip(rows, points, strict=True):
            x = point.detach()[None].requires_grad_(slopes)
            row[0] = _gradient(field.function(theta, x)[0], theta)
            if slopes:
                # A pass of its own: what is compiled or recomputed allows no second one through the same graph.
                (of_x,) = torch.autograd.grad(field.function(theta, x)[0], x, create_graph=True)
                for k, slope in enumerate(of_x[0]):
                    row[1 + k] = _gradient(slope, theta, keep=True) if slope.requires_grad else 0.0
    return rows


def product_by_backward_passes(
    field: Field, points: Float[Tensor, "n d"], d_theta: Float[Tensor, " p"]
) -> Float[Tensor, " n"] | None:
    """Return df/dtheta . d_theta at each point without a forward derivative, or None where the module allows it not.

    The backward pass is linear in its weights w, so the derivative of (B^T w) . d_theta by w is B d_theta, whatever w.
    An operation whose backward has no derivative, or drops it, gives nothing or something else: what comes is held
    against the product with one w.
    """
    theta = field.theta.detach().requires_grad_()
    try:
        with torch.enable_grad():
            w = torch.zeros_like(points[:, 0]).requires_grad_()
            (back,) = torch.autograd.grad(field.function(theta, points) @ w, theta, create_graph=True)
            found = torch.autograd.grad(back @ d_theta, w)[0]
            signs = torch.linspace(-1, 1, len(points)).to(points) + 0.25
            (expected,) = torch.autograd.grad(field.function(theta, points) @ signs, theta)
    except Exception as error:
        if is_memory(error):
            raise
        return None
    gap = float((signs @ found - expected @ d_theta).abs())
    size = float((signs * found).abs().sum() + (expected * d_theta).abs().sum())
    return found if gap <= torch.finfo(points.dtype).eps ** 0.5 * size else None


def _gradient(value: Tensor, theta: Tensor, *, keep: bool = False) -> Tensor:
    """Return the gradient by theta, zero where the value has none."""
    if not value.requires_grad:
        return torch.zeros_like(theta)
    found = torch.autograd.grad(value, theta, retain_graph=keep, allow_unused=True)[0]
    return torch.zeros_like(theta) if found is None else found
