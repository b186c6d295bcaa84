"""Motions of a shape by its parameters: orthonormal ones on the surface, and the symmetry of each.

Column k of B (implicit.sensitivity.boundary_sensitivity) is the outward motion of every surface point per unit of
parameter k; a direction d of the parameters moves the surface by u = B d. Among all directions, those of the singular
value decomposition of W^1/2 B, with W the quadrature weights, move it by functions that are orthonormal on the surface,
that of the largest singular value first.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import counted, kind_of, require_tensor, require_whole
from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import basis
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample, require_sample


@dataclass(frozen=True, eq=False)
class SurfaceModes:
    """Orthonormal motions of a surface.

    Attributes:
        directions: Unit changes of the parameters (P, K), orthonormal, that of the largest singular value first.
        strengths: Singular value of each, the root of the integral of its squared motion, a length squared per unit of
            parameter.
        motions: Outward motion of each sample point, divided by the strength (N, K).
    """

    directions: Float[Tensor, "p k"]
    strengths: Float[Tensor, " k"]
    motions: Float[Tensor, "n k"]

    def __repr__(self) -> str:
        largest = ", ".join(f"{float(strength):.3g}" for strength in self.strengths[:3])
        return (
            f"SurfaceModes: {counted(len(self.strengths), 'direction')} of P = {len(self.directions):,} on "
            f"{counted(len(self.motions), 'point')}, strengths {largest}{', ...' if len(self.strengths) > 3 else ''} "
            f"({kind_of(self.directions)})"
        )


def surface_modes(field: Field, sample: SurfaceSample, count: int = 8) -> SurfaceModes:
    """Return the directions of the parameters that move the surface most.

    Args:
        field: A field of few parameters, such as a code: B is made whole.
        sample: Points and weights on the surface.
        count: K, at most the number of parameters.
    """
    require_sample(field, sample)
    require_whole("count", count, 1, "", len(field.theta))
    B = basis(field, sample.points).double()
    root = sample.weights.double().sqrt()
    _, strengths, directions = torch.linalg.svd(root[:, None] * B, full_matrices=False)
    directions, strengths = directions[:count].T, strengths[:count]
    return SurfaceModes(directions.to(B), strengths, B @ directions / strengths)


def mirror_symmetry(
    field: Field, sample: SurfaceSample, directions: Float[Tensor, "p k"], *, axis: int = 0
) -> Float[Tensor, " k"]:
    """Return the mirror symmetry of the motion of each direction: 1 symmetric, -1 antisymmetric, 0 neither.

    It is the correlation over the surface of u(x) with u at the mirror image of x,

        int u(x) u(mx) / sqrt(int u(x)^2 int u(mx)^2)

    Args:
        field: A field of few parameters, such as a code: B is made whole.
        sample: Points and weights on the surface.
        directions: Changes of the parameters, a column each.
        axis: Normal of the mirror plane through the origin: 0, 1, 2 for x, y, z.

    Returns:
        NaN for a direction that does not move the surface.

    Raises:
        ValueError: The surface itself is not symmetric: less than nine tenths of the mirrored points lie on it, to a
            hundredth of the field's size.
    """
    require_sample(field, sample)
    require_whole("axis", axis, 0, "", field.dimension - 1)
    columns = directions.shape[1:] if isinstance(directions, Tensor) else (1,)
    require_tensor("directions", directions, (len(field.theta), *columns[:1]), field.device)
    mirror = torch.ones(field.dimension, dtype=field.dtype, device=field.device)
    mirror[axis] = -1
    images, arrived = newton_to_surface(field, sample.points * mirror, reach=0.01 * field.size)
    share = float((sample.weights * arrived).sum() / sample.weights.sum())
    if share < 0.9:
        raise ValueError(
            f"Only {100 * share:.0f} % of the surface has its mirror image about axis {axis} on the surface. Choose "
            "another axis, or a symmetric shape."
        )
    weights, here, there = sample.weights[arrived], sample.points[arrived], images[arrived]
    u, v = (basis(field, points) @ directions.to(field.theta) for points in (here, there))
    both, own, other = (weights @ products for products in (u * v, u * u, v * v))
    return both / (own * other).sqrt()
