"""Energies of a displacement given at the vertices of a mesh of the surface, for fields without second derivatives.

    int w (u - target)^2 + int v |grad_surface u - slope|^2         u = N . D, along the mesh's normals N

The rows of implicit.step.energies take the slopes of the sensitivities in space; of a network with jumps in its
gradient these are zero almost everywhere. Here u is linear on each cell between its vertices instead, so that the
jumps count. A surface that moves by b along the field's normal n moves by b / (N . n) along the mesh's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.sensitivity.boundary_sensitivity import row_blocks
from implicit.sensitivity.weak_curvature import LEAST_COSINE, FloatArray, WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import Rows


def mesh_speed_rows(space: DeformationSpace, surface: WeakSurface) -> Float[Tensor, "v p"]:
    """Return the motion of a mesh's vertices along its normals as rows over the unknowns of the normal part (V, P)."""
    points, normals = (torch.from_numpy(part).to(space.field.theta) for part in (surface.vertices, surface.normals))
    cosines = (normals * space.field.normal(points)).sum(dim=1).clamp(min=LEAST_COSINE)
    rows = torch.cat([matrix for _, matrix in space.normal_rows(points)])
    return rows.div_(cosines[:, None])


@dataclass(frozen=True, eq=False)
class MeshNormalMotion:
    """int w (u - target)^2 + int v |grad_surface u - slope|^2 of the motion u along the normals of a mesh.

    Attributes:
        surface: The mesh.
        target: Wanted motion of each vertex (V,), a length.
        weights: Of the vertices (V,), areas.
        stiffness: Factor v of each cell (m,), a squared length; None is no such term.
        slope: Wanted slope on each cell along its tangents (m, D - 1); None is zero.
    """

    surface: WeakSurface
    target: FloatArray
    weights: FloatArray
    stiffness: FloatArray | None = None
    slope: FloatArray | None = None

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        """Yield the weighted equations, the vertices' and then the cells'."""
        theta = space.field.theta
        speed = mesh_speed_rows(space, self.surface)
        target, weights = (torch.from_numpy(part).to(theta) for part in (self.target, self.weights))
        yield Rows(speed, target, weights)
        if self.stiffness is None:
            return
        areas, t = self.surface.gradient[1], self.surface.dimension - 1
        factors = torch.from_numpy(areas).to(theta) * torch.from_numpy(self.stiffness).to(theta).repeat_interleave(t)
        slope = torch.zeros_like(factors) if self.slope is None else torch.from_numpy(self.slope).to(theta).flatten()
        corners = torch.from_numpy(self.surface.faces).to(theta.device).repeat_interleave(t, dim=0)
        hats = torch.from_numpy(self.surface.hat_slopes).to(theta).flatten(0, 1)
        for part in row_blocks(torch.arange(len(corners), device=theta.device), 4 * speed.shape[1]):
            matrix = hats[part, 0, None] * speed[corners[part, 0]]
            for k in range(1, hats.shape[1]):
                matrix += hats[part, k, None] * speed[corners[part, k]]
            yield Rows(matrix, slope[part], factors[part])
