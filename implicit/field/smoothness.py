"""Smoothness of a field, measured on its gradients and never guessed from its class.

Two questions are kept apart. Are the second derivatives those of the gradient? A ReLU network's are: zero, as its
gradient is constant between kinks. An operation that is differentiable once gives none, or wrong ones, and nothing says
so. And is the gradient smooth at a distance h, so that curvature by second derivatives means anything there?

    g(y) - g(x) = (H(x) + H(y)) / 2 (y - x) + O(h^3),     h = |y - x|

on a smooth field, by the trapezoidal rule along the segment. The share of the change that the Hessians leave is 0 on a
plane, O(h^2) on a sphere, and 1 on a piecewise linear field, whose whole change is in its kinks.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive
from implicit.field.differentiable import Differentiable

# Points at which second derivatives are held against differences, and the steps over the size of the bounds.
LOOKED_AT = 8
STEPS = {torch.float64: (1e-3, 1e-4, 1e-5, 1e-6), torch.float32: (1e-2, 3e-3, 1e-3)}

# Part of the change of the gradient by which H v may miss the best of its differences. Those of smooth fields miss by
# 1e-6 in float64; in float32 they are too coarse to see a small part missing.
TOLERANCES = {torch.float64: 1e-3, torch.float32: 0.05}


@dataclass(frozen=True, eq=False)
class GradientJumps:
    """The change of the gradient between near points of a surface, and what of it the Hessian does not explain.

    Attributes:
        share: Unexplained part of all changes, 0 to about 1: near 0 where the field is smooth at this spacing, near 1
            where the gradient jumps; 0 where it does not change at all.
        changes: Length of g(y) - g(x) summed over the directions, a point a number (N,).
        unexplained: The same of what the Hessians leave of it (N,).
        spacing: |y - x|, a length.
    """

    share: float
    changes: Float[Tensor, " n"]
    unexplained: Float[Tensor, " n"]
    spacing: float

    def __float__(self) -> float:
        return self.share


def gradient_jumps(
    field: Differentiable, points: Float[Tensor, "n d"], spacing: float, *, seed: int = 0
) -> GradientJumps:
    """Return the share of the change of the gradient between near points that the Hessian does not explain.

    From each point one step is taken along each of D - 1 directions of the tangent plane, drawn at random and at right
    angles to each other. Where second derivatives are missing they explain nothing.

    Args:
        field: Any field.
        points: Points (N, D), on the surface for what is to be said of it.
        spacing: Length of the steps, such as the distance between the points of an edit.
        seed: Seed of the directions.

    Raises:
        ValueError: The spacing is not positive, or the gradient vanishes at a point.
    """
    require_positive("spacing", spacing, "length")
    points = field.require_points(points)
    gradients, hessians = _gradient_and_hessian(field, points)
    normals = gradients / field.gradient_length(gradients)[:, None]
    changes, left = torch.zeros_like(points[:, 0]), torch.zeros_like(points[:, 0])
    for way in _tangents(normals, seed):
        step = spacing * way
        other, bend = _gradient_and_hessian(field, points + step)
        change = other - gradients
        explained = torch.einsum("nij,nj->ni", (hessians + bend) / 2, step)
        changes += change.norm(dim=1)
        left += (change - explained).norm(dim=1)
    total = float(changes.sum())
    # Differences of gradients round at a few units of the gradient itself.
    rounding = 100 * torch.finfo(field.dtype).eps * float(gradients.norm(dim=1).sum())
    share = float(left.sum()) / total if total > rounding else 0.0
    return GradientJumps(share, changes, left, float(spacing))


def second_derivatives_missing(field: Differentiable, points: Float[Tensor, "n d"]) -> str:
    """Return why the second derivatives at the points are not those of the gradient; "" where they are.

    H v along random directions v is held against central differences of the gradient, in float64 where the module can,
    at several steps: a point speaks against the module only if none agrees, so kinks do not. More than a third of the
    points at which the gradient changes must speak against it.

    Args:
        field: Any field.
        points: Points (N, D); a few of them are taken.
    """
    if len(points) == 0:
        return ""
    chosen = points[torch.linspace(0, len(points) - 1, min(LOOKED_AT, len(points))).long().to(points.device)]
    for precise in (True, False):
        try:
            looked_at = field.to(torch.float64) if precise else field
            x = chosen.to(looked_at.dtype)
            ahead = _differences(looked_at, x)
            break
        except (TypeError, RuntimeError, ValueError):
            if not precise:
                raise
    differences, directions, length = ahead
    try:
        _, hessians = looked_at.raw_gradient_and_hessian(x)
    except (TypeError, RuntimeError) as error:
        return str(error)
    along = torch.einsum("nij,nj->ni", hessians, directions)
    gap = (differences - along).norm(dim=2)
    size = torch.maximum(differences.norm(dim=2), along.norm(dim=1))
    # A change of the gradient over the whole box that is this small against the gradient is rounding, or nothing.
    least = (1e-6 if looked_at.dtype == torch.float64 else 1e-2) * length / field.size
    speaking = (differences.norm(dim=2) > least).all(dim=0)
    agrees = ((gap <= TOLERANCES.get(x.dtype, 0.05) * size) | (gap <= least)).any(dim=0)
    against = speaking & ~agrees & torch.isfinite(gap).all(dim=0)
    if int(against.sum()) * 3 <= int(speaking.sum()):
        return ""
    return (
        f"at {int(against.sum())} of {len(x)} points the second derivatives are not the differences of the gradient: "
        "an operation in the module is differentiable once alone"
    )


def _differences(field: Differentiable, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return central differences of the gradient (S, N, D), their directions (N, D) and the gradient's lengths (N,)."""
    generator = torch.Generator().manual_seed(11)
    draw = torch.randn(x.shape, generator=generator, dtype=torch.float64).to(x)
    directions = torch.nn.functional.normalize(draw, dim=1)
    steps = torch.tensor(STEPS.get(x.dtype, STEPS[torch.float32]), dtype=torch.float64).to(x) * field.size
    way = steps[:, None, None] * directions
    ends = torch.cat([x + way, x - way]).reshape(-1, x.shape[1])
    ahead, behind = field.value_and_gradient(ends, validate=False)[1].view(2, len(steps), len(x), -1)
    length = field.value_and_gradient(x, validate=False)[1].norm(dim=1)
    return (ahead - behind) / (2 * steps[:, None, None]), directions, length


def _gradient_and_hessian(field: Differentiable, points: Tensor) -> tuple[Tensor, Tensor]:
    """Return gradients and Hessians, zero where the module has none."""
    try:
        return field.raw_gradient_and_hessian(points)
    except TypeError:
        gradients = field.gradient(points)
        return gradients, gradients.new_zeros(*gradients.shape, gradients.shape[1])


def _tangents(normals: Tensor, seed: int) -> list[Tensor]:
    """Return D - 1 unit directions at right angles to the normals and to each other."""
    if normals.shape[1] == 2:
        return [torch.stack([-normals[:, 1], normals[:, 0]], dim=1)]
    generator = torch.Generator().manual_seed(seed)
    turn = 2 * torch.pi * torch.rand(len(normals), 1, generator=generator, dtype=torch.float64).to(normals)
    # A direction drawn in space would be lost where it happens to be the normal: one of the plane is turned instead.
    least = torch.nn.functional.one_hot(normals.abs().argmin(dim=1), 3).to(normals)
    first = torch.nn.functional.normalize(torch.linalg.cross(normals, least), dim=1)
    second = torch.linalg.cross(normals, first)
    return [turn.cos() * first + turn.sin() * second, turn.cos() * second - turn.sin() * first]
