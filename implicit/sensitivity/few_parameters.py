"""Parameter derivatives of fields of few parameters: second derivatives in place of vectorised first ones.

A latent code or an analytic shape has a dozen parameters, and points by the thousand. The backward pass is linear in
its weights w at the points, so the derivative of B^T w by w has the columns of B. torch's function transforms, which
serve fields of more parameters, load a compiler at their first call: two seconds of a processor.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.field.torch_errors import first_line, is_memory

MOST = 16


def columns_of_few(
    field: Field, points: Float[Tensor, "n d"], *, slopes: bool = False
) -> Float[Tensor, "n e p"] | None:
    """Return df/dtheta at each point, (N, 1, P), and after it d(df/dtheta)/dx where slopes are asked, (N, 1 + D, P).

    None where there are many parameters, or where the module has no such derivatives, or wrong ones: what comes is
    held against a product with the transpose. A module that refused is not asked again.
    """
    if len(field.theta) > MOST or not len(points) or "no columns" in field.findings:
        return None
    try:
        return _columns(field, points, slopes)
    except Exception as error:
        if is_memory(error):
            raise
        field.findings["no columns"] = first_line(error)
        return None


@torch.enable_grad()
def _columns(field: Field, points: Tensor, slopes: bool) -> Tensor:
    theta = field.theta.detach().requires_grad_()
    x = points.detach().requires_grad_(slopes)
    values = field.function(theta, x)
    functions = [values]
    if slopes:
        functions += torch.autograd.grad(values.sum(), x, create_graph=True)[0].unbind(dim=1)
    return torch.stack([_columns_of(function, theta) for function in functions], dim=1).detach()


def _columns_of(function: Float[Tensor, " n"], theta: Float[Tensor, " p"]) -> Float[Tensor, "n p"]:
    """Return d function / dtheta.

    Raises:
        ArithmeticError: A product with its transpose says otherwise.
    """
    rows = function.new_zeros(len(function), len(theta))
    if not function.requires_grad:
        return rows
    w = torch.zeros_like(function).requires_grad_()
    (back,) = torch.autograd.grad(function @ w, theta, create_graph=True, allow_unused=True)
    if back is None:
        return rows
    each = torch.eye(len(theta), dtype=back.dtype, device=back.device)
    (columns,) = torch.autograd.grad(back, w, each, retain_graph=True, is_grads_batched=True, allow_unused=True)
    if columns is not None:
        rows = columns.T.contiguous()
    signs = torch.linspace(-1, 1, len(function)).to(function) + 0.25
    (expected,) = torch.autograd.grad(function @ signs, theta, retain_graph=True)
    gap = (signs @ rows - expected).abs()
    if (gap > torch.finfo(rows.dtype).eps ** 0.5 * (signs.abs() @ rows.abs() + expected.abs())).any():
        raise ArithmeticError("the second derivatives of the module do not fit the first")
    return rows
