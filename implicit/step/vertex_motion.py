"""Displacements of the vertices of a mesh of the surface: normal by the parameters, along the surface free at each.

    D_i = (b_i . d_theta) n_i + t_i1 e_i1 + t_i2 e_i2

The unknowns are d_theta and two numbers a vertex, so that the energy of a mesh holds each of the latter with its
neighbours alone (implicit.step.vertex_equations). Elsewhere, with b_k the barycentric coordinates of the nearest point
q of the mesh, x_k its corners and J_k the slopes of D about them,

    D(x) = sum b_k (D_k + J_k (q - x_k) / 2) + sum b_k J_k (x - q),

which is exact for displacements that are quadratic along a plane, and for rigid ones everywhere; of it the part along
the normal is then the field's own.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import normal_displacement
from implicit.sensitivity.frame import axes_of, normal_component
from implicit.sensitivity.weak_curvature import FloatArray, IntArray, WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.surface_map import SurfaceMap


class VertexMotion(DeformationSpace):
    """Displacements of the vertices of a mesh, linear in (d_theta, t).

    Args:
        field: Field whose parameters span the normal part.
        points: The vertices, on its surface (V, 3).
        faces: Triangles, outward (m, 3).
    """

    def __init__(self, field: Field, points: Float[Tensor, "v 3"], faces: IntArray) -> None:
        super().__init__(field)
        self.points = points
        self.surface = WeakSurface(points.detach().double().cpu().numpy(), faces)
        self.size = self.parameters + 2 * len(points)

    @cached_property
    def _gradients(self) -> Float[Tensor, "v 3"]:
        return self.field.gradient(self.points)

    @cached_property
    def gradient_lengths(self) -> Float[Tensor, " v"]:
        """|df/dx| at the vertices, in units of the field a length."""
        return self.field.gradient_length(self._gradients)

    @cached_property
    def axes(self) -> Float[Tensor, "v 3 3"]:
        """Rows: an orthonormal basis of the tangent plane at each vertex, then the field's normal."""
        return axes_of(self._gradients / self.gradient_lengths[:, None])

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.surface.vertices)

    def vertices_at(self, points: Float[Tensor, "n 3"]) -> IntArray:
        """Return the numbers of the vertices that some points are (N,).

        Raises:
            ValueError: One is no vertex.
        """
        distance, which = self._tree.query(points.detach().double().cpu().numpy())
        apart = np.count_nonzero(distance)
        if apart:
            raise ValueError(
                f"The points of an energy must be vertices of the mesh, but {apart} of "
                f"{len(points)} are not. Take some of its {len(self.points)} vertices."
            )
        return np.asarray(which, dtype=np.int64)

    def split(self, x: Float[Tensor, " s"]) -> tuple[Float[Tensor, " p"], Float[Tensor, "v 2"]]:
        """Return the unknowns as d_theta and the motion of each vertex along its two tangents."""
        return x[: self.parameters], x[self.parameters :].view(len(self.points), 2)

    def displacement(self, points: Float[Tensor, "n 3"], x: Float[Tensor, " s"]) -> Float[Tensor, "n 3"]:
        """Return D at surface points, a length; those that begin with all vertices are known to be these."""
        d_theta, along = self.split(x)
        count = len(self.points)
        own = len(points) >= count and torch.equal(points[:count], self.points)
        others = points[count:] if own else points
        at_vertices = torch.einsum("va,vax->vx", along, self.axes[:, :-1])
        if len(others) == 0:
            return at_vertices + self._normal_part(points, self.axes[:, -1], d_theta)
        whole = at_vertices + self._normal_part(self.points, self.axes[:, -1], d_theta)
        n = self.field.normal(others)
        between = torch.from_numpy(self._between(others, whole)).to(others)
        there = between - normal_component(between, n) + self._normal_part(others, n, d_theta)
        return torch.cat([whole, there]) if own else there

    def _normal_part(self, points: Tensor, normals: Tensor, d_theta: Tensor) -> Tensor:
        return normals * normal_displacement(self.field, points, d_theta)[:, None]

    def _between(self, points: Float[Tensor, "n 3"], displacement: Float[Tensor, "v 3"]) -> FloatArray:
        """Return the displacement at points near the mesh (N, 3) from that of its vertices; see the top of the file."""
        D = displacement.detach().double().cpu().numpy()
        F, still = self.surface.faces, np.zeros((len(D), 3, 3))
        foot = SurfaceMap(self.surface, D, still).foot(points.detach().double().cpu().numpy())
        corners, shares = F[foot.faces], foot.shares
        at = np.einsum("nk,nkx->nx", shares, self.surface.vertices[corners])
        slopes = self._slopes(D)[corners]
        ways = at[:, None] - self.surface.vertices[corners]
        near = D[corners] + np.einsum("nkxy,nky->nkx", slopes, ways) / 2
        beyond = np.einsum("nk,nkxy,ny->nx", shares, slopes, foot.points - at)
        return np.asarray(np.einsum("nk,nkx->nx", shares, near) + beyond)

    def _slopes(self, D: FloatArray) -> FloatArray:
        """Return the slopes of D about each vertex (V, 3, 3), the mean of its faces'; across the surface it turns."""
        surface, F = self.surface, self.surface.faces
        on_faces = np.einsum("mkx,mtk,mty->mxy", D[F], surface.hat_slopes, surface.tangents)
        n = surface.cell_normals
        across = np.einsum("myx,my->mx", on_faces, n)  # of n . D along the surface, by which the normal turns back
        on_faces = on_faces - across[:, :, None] * n[:, None, :]
        weights = np.repeat(surface.contents, 3)
        total = np.bincount(F.ravel(), weights, len(D))
        sums = [np.bincount(F.ravel(), weights * np.repeat(entry, 3), len(D)) for entry in on_faces.reshape(-1, 9).T]
        return (np.stack(sums, axis=1) / np.maximum(total, 1e-300)[:, None]).reshape(-1, 3, 3)

    def __repr__(self) -> str:
        return f"VertexMotion({self.parameters} parameters, {len(self.points)} vertices)"
