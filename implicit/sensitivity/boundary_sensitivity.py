"""Boundary sensitivity: the motion of the surface as the parameters of the field move.

Moving theta by d_theta moves each point of the surface f(x; theta) = 0 outward by

    d_n = b . d_theta,    b(x) = -(df/dtheta) / |df/dx|          [Berzins et al. 2023, eq. 3]

The matrix B with rows b(x_i) is never needed whole: `normal_displacement` is its product with a parameter
change, `adjoint` that of its transpose with weights at the points.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import grad, grad_and_value, jvp, vmap

from implicit.arguments import require_tensor
from implicit.field.field import CHUNK, Field, require_field
from implicit.field.torch_errors import in_our_words
from implicit.sensitivity import closed_form
from implicit.sensitivity.few_parameters import MOST, columns_of_few
from implicit.sensitivity.point_by_point import product_by_backward_passes, rows_point_by_point, vectorised

# Numbers in the largest block of B made at once, 256 MB in float64: enough rows for the symmetric product, whose
# every call reads and writes the whole normal matrix.
BLOCK = 32_000_000


def basis(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, "n p"]:
    """Return the outward speed of each surface point per unit of each parameter, B (paper, eq. 3).

    Row i is -(df/dtheta) / |df/dx| at points[i]. Multiplying f by a positive constant changes nothing.

    Args:
        field: A field with p parameters; it need not be a distance.
        points: Points (N, D) on the surface.

    Returns:
        Length per unit of parameter, (N, P). For large N times P use `normal_displacement` and `adjoint`.

    Raises:
        ValueError: The gradient vanishes at a point.
    """
    points = require_field(field).require_points(points)
    blocks = [basis_block(field, part) for part in row_blocks(points, len(field.theta))]
    return blocks[0] if len(blocks) == 1 else torch.cat(blocks)


def basis_block(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, "n p"]:
    """Return the matrix of `basis`, in one piece."""
    length = field.gradient_length(field.gradient(points))
    return parameter_gradient(field, points).div_(-length[:, None])


def parameter_gradient(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, "n p"]:
    """Return df/dtheta at each point."""
    if closed_form.has_closed_form(field):
        return closed_form.gradient(field, points)
    few = columns_of_few(field, points)
    if few is not None:
        return few[:, 0]
    gradient = vmap(grad(_at_one_point(field)), in_dims=(None, 0))
    rows = vectorised(field, "rows", lambda: gradient(field.theta, points))
    return rows_point_by_point(field, points)[:, 0] if rows is None else rows


def value_and_gradients(
    field: Field, points: Float[Tensor, "n d"]
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n d"], Float[Tensor, "n p"]]:
    """Return f, df/dx and df/dtheta at each point, by one forward and one backward pass where torch can."""
    if closed_form.has_closed_form(field):
        with torch.no_grad():
            return closed_form.value_and_gradients(field, points)
    if len(field.theta) > MOST:
        both = vmap(grad_and_value(_at_one_point(field), argnums=(0, 1)), in_dims=(None, 0))
        found = vectorised(field, "rows", lambda: both(field.theta, points))
        if found is not None:
            (of_theta, of_x), values = found
            return values, of_x, of_theta
    values, gradients = field.value_and_gradient(points)
    return values, gradients, parameter_gradient(field, points)


def normal_displacement(
    field: Field,
    points: Float[Tensor, "n d"],
    d_theta: Float[Tensor, " p"],
    lengths: Float[Tensor, " n"] | None = None,
) -> Float[Tensor, " n"]:
    """Return the outward motion B d_theta of surface points, a length, without making B.

    Args:
        field: The field.
        points: Points (N, D) on the surface.
        d_theta: Change of the parameters (P,).
        lengths: |df/dx| at the points, where the caller has it already.

    Raises:
        ValueError: The gradient vanishes at a point, or d_theta has another size than theta.
    """
    points = require_field(field).require_points(points)
    require_tensor("d_theta", d_theta, field.theta.shape, field.device)
    if lengths is None:
        lengths = field.gradient_length(field.gradient(points))
    require_tensor("lengths", lengths, points.shape[:1], field.device)
    change = [_directional(field, part, d_theta.to(field.theta)) for part in points.split(CHUNK)]
    return -torch.cat(change) / lengths if change else points.new_zeros(0)


def _directional(field: Field, points: Tensor, d_theta: Tensor) -> Tensor:
    """Return df/dtheta . d_theta at each point."""
    if closed_form.fits(field, len(points)):
        return closed_form.factors(field, points).times(d_theta)
    few = columns_of_few(field, points)
    if few is not None:
        return few[:, 0] @ d_theta

    def moved() -> Tensor:
        return jvp(lambda theta: field.function(theta, points), (field.theta,), (d_theta,))[1]

    change = vectorised(field, "product", moved)
    if change is None:  # some layers (weight norm) have no forward derivative
        change = product_by_backward_passes(field, points, d_theta)
    return parameter_gradient(field, points) @ d_theta if change is None else change


def adjoint(
    field: Field,
    points: Float[Tensor, "n d"],
    weights: Float[Tensor, " n"],
    lengths: Float[Tensor, " n"] | None = None,
) -> Float[Tensor, " p"]:
    """Return B^T weights: the sum of weights[i] b(points[i]), by one backward pass.

    Args:
        field: The field.
        points: Points (N, D) on the surface.
        weights: Number for each point (N,).
        lengths: |df/dx| at the points, where the caller has it already.

    Raises:
        ValueError: The gradient vanishes at a point, or the shapes do not fit.
    """
    points = require_field(field).require_points(points)
    require_tensor("weights", weights, points.shape[:1], field.device)
    if lengths is None:
        lengths = field.gradient_length(field.gradient(points))
    require_tensor("lengths", lengths, points.shape[:1], field.device)
    scaled = -weights / lengths
    total = torch.zeros_like(field.theta)
    theta = field.theta.detach().requires_grad_()
    with torch.enable_grad(), in_our_words("be differentiated by its parameters"):
        for part, share in zip(points.split(CHUNK), scaled.split(CHUNK), strict=True):
            (gradient,) = torch.autograd.grad(field.function(theta, part) @ share, theta)
            total += gradient
    return total


def parameter_gradient_and_slope(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, "n e p"]:
    """Return df/dtheta and, after it, its derivatives in space d(df/dtheta)/dx, (N, 1 + D, P)."""
    if closed_form.has_closed_form(field, in_space=True):
        return closed_form.gradient_and_slope(field, points)
    few = columns_of_few(field, points, slopes=True)
    if few is not None:
        return few
    gradient = grad(_at_one_point(field))

    def one(theta: Tensor, point: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        return jvp(lambda x: gradient(theta, x), (point,), (direction,))  # type: ignore[return-value]

    along = vmap(vmap(one, in_dims=(None, None, 0)), in_dims=(None, 0, None))
    directions = torch.eye(field.dimension, dtype=points.dtype, device=points.device)
    found = vectorised(field, "slopes", lambda: along(field.theta, points, directions))
    if found is None:
        return rows_point_by_point(field, points, slopes=True)
    values, slopes = found
    return torch.cat([values[:, :1], slopes], dim=1)


def row_blocks(points: Tensor, columns: int) -> Iterator[Tensor]:
    """Return the points in parts whose rows of so many columns stay within BLOCK numbers."""
    yield from points.split(max(1, BLOCK // max(columns, 1)))


def _at_one_point(field: Field):  # type: ignore[no-untyped-def]  # torch.func needs a plain function
    def value(theta: Tensor, point: Tensor) -> Tensor:
        return field.function(theta, point[None])[0]

    return value
