"""Curvature in weak form, from a triangulation of the surface: what a field without second derivatives has.

The area of a mesh is a smooth function of its vertices, whatever the field they came from, and its first variation

    dA = sum_i (LX)_i . dx_i,      (LX)_i = sum over triangles at i of  1/2 n x (side opposite to i)

is the mean-curvature vector integrated about each vertex: L is the cotangent Laplacian, and in the plane, where the
content is the length, |(LX)_i| is twice the sine of half the turning angle of the polygon.

| of vertex i | in space | in the plane |
|---|---|---|
| mass M_i | mixed Voronoi area [Meyer, Desbrun, Schroeder, Barr 2003] | half the length of its segments |
| integrated curvature k_i = (LX)_i . N_i | as above | as above |
| integrated Gauss curvature | 2 pi - sum of the angles | 0 |

k_i / M_i does not tend to kappa vertex by vertex, on no irregular mesh: only integrals of it do. Where a density is
wanted, k is averaged over a few cells by a step of the heat equation, (M + w^2 L) kappa = k, and has what is left of
it then: all of the integral, and waves longer than w.

Conventions: normals point out, kappa = div n, L is positive semidefinite. All is computed in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.surface.extraction import marched_surface

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Width w of the averaging, in cells of the mesh (the root mean length of its sides).
AVERAGED_CELLS = 2.0

# Area that a triangle is taken to have at least in its Dirichlet energy, relative to its longest side squared: marching
# leaves needles along which the sensitivities of a network with jumps in its gradient differ by as much as elsewhere.
LEAST_HEIGHT = 0.02

# Least cosine between the normals of mesh and field: where facets of the field meet at a sharper angle, no single
# direction is normal to both.
LEAST_COSINE = 0.5

# Cells along the longest side of the bounds of a mesh that a functional makes for itself.
RESOLUTION = 48


@dataclass(frozen=True, eq=False)
class WeakSurface:
    """A closed mesh of a field's surface: triangles in space, segments in the plane.

    Attributes:
        vertices: Points on the surface (V, D).
        faces: Corners of the cells (m, D), wound as by extract_mesh.
    """

    vertices: FloatArray
    faces: IntArray

    @classmethod
    def of(cls, vertices: Float[Tensor, "v d"], faces: Tensor) -> WeakSurface:
        """Return the same of tensors."""
        return cls(vertices.detach().double().cpu().numpy(), faces.cpu().numpy())

    @classmethod
    def extracted(cls, field: Field, resolution: int = RESOLUTION) -> WeakSurface:
        """Return the mesh of a field's surface, of so many cells along the longest side of the bounds.

        Raises:
            SurfaceError: There is no surface in the bounds, or it leaves them.
        """
        return cls.of(*marched_surface(field, resolution))

    @property
    def dimension(self) -> int:
        """Number of coordinates, 2 or 3."""
        return self.vertices.shape[1]

    @cached_property
    def contents(self) -> FloatArray:
        """Area of each triangle, length of each segment (m,)."""
        return np.asarray(np.linalg.norm(self._across, axis=1))

    @cached_property
    def _corners(self) -> FloatArray:
        return self.vertices[self.faces]

    @cached_property
    def _across(self) -> FloatArray:
        """Outward vector square to each cell, as long as the cell is large (m, D)."""
        x = self._corners
        if self.dimension == 2:
            side = x[:, 1] - x[:, 0]
            return np.stack([side[:, 1], -side[:, 0]], axis=1)
        return np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2)

    @cached_property
    def cell_normals(self) -> FloatArray:
        """Outward unit normal of each cell (m, D); zero where it has no extent."""
        return self._across / np.maximum(self.contents, 1e-300)[:, None]

    @cached_property
    def _opposite(self) -> FloatArray:
        """Side of each triangle opposite to each corner (m, 3, 3)."""
        x = self._corners
        return np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)

    def _gathered(self, shares: FloatArray) -> FloatArray:
        """Return the sums over the cells at each vertex of what each corner gets, (m, D, ...) to (V, ...)."""
        flat = shares.reshape(self.faces.size, -1)
        sums = [np.bincount(self.faces.ravel(), column, len(self.vertices)) for column in flat.T]
        total: FloatArray = np.stack(sums, axis=1).astype(np.float64)
        return total.reshape(len(self.vertices), *shares.shape[2:])

    @cached_property
    def curvature_vectors(self) -> FloatArray:
        """LX, the first variation of area by each vertex (V, D): the mean-curvature vector integrated, outward."""
        if self.dimension == 2:
            unit = np.stack([-self.cell_normals[:, 1], self.cell_normals[:, 0]], axis=1)
            return self._gathered(np.stack([-unit, unit], axis=1))
        return self._gathered(np.cross(self.cell_normals[:, None, :], self._opposite) / 2)

    @cached_property
    def masses(self) -> FloatArray:
        """Share of each vertex of the area (V,): mixed Voronoi areas, which are never negative."""
        if self.dimension == 2:
            return self._gathered(np.repeat(self.contents[:, None] / 2, 2, axis=1))
        squares = (self._opposite**2).sum(axis=2)
        cotangents = self._cotangents
        # The Voronoi cell of corner k ends at the middles of the two sides there, each over the cotangent facing it.
        facing = squares * cotangents
        voronoi = (np.roll(facing, -1, axis=1) + np.roll(facing, -2, axis=1)) / 8
        obtuse = cotangents < 0
        shares = np.where(obtuse, 1 / 2, 1 / 4) * self.contents[:, None]
        return self._gathered(np.where(obtuse.any(axis=1, keepdims=True), shares, voronoi))

    @cached_property
    def _cotangents(self) -> FloatArray:
        """Cotangent of the angle at each corner (m, 3)."""
        x = self._corners
        first, second = np.roll(x, -1, axis=1) - x, np.roll(x, -2, axis=1) - x
        return np.asarray((first * second).sum(axis=2) / np.maximum(2 * self.contents, 1e-300)[:, None])

    @cached_property
    def normals(self) -> FloatArray:
        """Outward unit normal at each vertex (V, D): the direction in which the volume grows fastest."""
        across = self._gathered(np.repeat(self._across[:, None], self.dimension, axis=1))
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)

    @cached_property
    def integrated_curvature(self) -> FloatArray:
        """Mean curvature integrated about each vertex (V,): how the area changes as the vertex moves outward."""
        return np.asarray((self.curvature_vectors * self.normals).sum(axis=1))

    @cached_property
    def integrated_gauss_curvature(self) -> FloatArray:
        """Gauss curvature integrated about each vertex, the angle that is missing there (V,); 0 in the plane."""
        if self.dimension == 2:
            return np.zeros(len(self.vertices))
        cotangents = self._cotangents
        angles = np.arctan2(np.ones_like(cotangents), cotangents)
        return 2 * np.pi - self._gathered(angles)

    @cached_property
    def width(self) -> float:
        """Root mean square length of the sides, the size of a cell."""
        sides = self._corners - np.roll(self._corners, 1, axis=1)
        return float(np.sqrt((sides**2).sum(axis=2).mean()))

    @cached_property
    def gradient(self) -> tuple[sparse.csr_array, FloatArray]:
        """Slopes of functions that are linear on each cell, along its tangents, and the weights of their squares.

        Returns:
            G (t m, V) with t = D - 1 tangents a cell, cell by cell, and weights (t m,) such that sum w (G u)^2 is the
            Dirichlet energy, where no triangle is taken to be thinner than LEAST_HEIGHT.
        """
        t, m, slopes = self.dimension - 1, len(self.faces), self.hat_slopes
        columns = np.broadcast_to(self.faces[:, None, :], slopes.shape)
        pointer = np.arange(0, slopes.size + 1, self.dimension)
        matrix = sparse.csr_array((slopes.ravel(), columns.ravel(), pointer), shape=(t * m, len(self.vertices)))
        return matrix, np.repeat(self._counted * self.contents, t)

    @cached_property
    def hat_slopes(self) -> FloatArray:
        """Slopes along each cell's tangents of the function that is 1 at a corner and 0 at the others (m, D - 1, D)."""
        return np.asarray(np.einsum("mtd,mkd->mtk", self.tangents, self._hat_gradients))

    @cached_property
    def _counted(self) -> FloatArray:
        """Factor of the Dirichlet energy of each cell, less than 1 for needles (m,)."""
        if self.dimension == 2:
            return np.ones(len(self.faces))
        longest = (self._opposite**2).sum(axis=2).max(axis=1)
        return np.minimum(1.0, self.contents / np.maximum(LEAST_HEIGHT * longest, 1e-300))

    @cached_property
    def tangents(self) -> FloatArray:
        """Orthonormal vectors along each cell (m, D - 1, D)."""
        longest = self._corners[:, 1] - self._corners[:, 0]
        first = longest / np.maximum(np.linalg.norm(longest, axis=1, keepdims=True), 1e-300)
        if self.dimension == 2:
            return first[:, None]
        return np.stack([first, np.cross(self.cell_normals, first)], axis=1)

    @cached_property
    def _hat_gradients(self) -> FloatArray:
        """Gradient of the function that is 1 at a corner, 0 at the others and linear on the cell (m, D, D)."""
        size = np.maximum(self.contents, 1e-12 * self.contents.mean())[:, None, None]
        if self.dimension == 2:
            along = self.tangents / size
            return np.concatenate([-along, along], axis=1)
        return np.asarray(np.cross(self.cell_normals[:, None, :], self._opposite) / (2 * size))

    @cached_property
    def laplacian(self) -> sparse.csc_array:
        """Stiffness matrix of the Dirichlet energy (V, V): the cotangent Laplacian, but for needles."""
        G, weights = self.gradient
        return sparse.csc_array(G.T @ sparse.diags_array(weights) @ G)

    def averaged(self, integrated: FloatArray) -> FloatArray:
        """Return the density of what is integrated about the vertices, averaged over AVERAGED_CELLS (V,)."""
        return np.asarray(self._heat_step.solve(integrated))

    @cached_property
    def _heat_step(self) -> SuperLU:
        spread = (AVERAGED_CELLS * self.width) ** 2 * self.laplacian
        return splu(sparse.csc_array(sparse.diags_array(self.masses) + spread))

    @cached_property
    def averaged_normals(self) -> FloatArray:
        """Unit normals of the cells averaged over AVERAGED_CELLS, at each vertex (V, D)."""
        across = self._gathered(np.repeat(self._across[:, None], self.dimension, axis=1)) / self.dimension
        mean = np.stack([self.averaged(axis) for axis in across.T], axis=1)
        return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)

    @cached_property
    def mean_curvature(self) -> FloatArray:
        """kappa averaged over AVERAGED_CELLS, at each vertex (V,)."""
        return self.averaged(self.integrated_curvature)

    @cached_property
    def squared_curvatures(self) -> FloatArray:
        """|A|^2 = kappa^2 - 2 K, the sum of the squared principal curvatures, of averaged ones (V,)."""
        gauss = self.averaged(self.integrated_gauss_curvature) if self.dimension == 3 else 0.0
        return np.maximum(self.mean_curvature**2 - 2 * gauss, 0.0)

    def on_cells(self, values: FloatArray) -> FloatArray:
        """Return the means over the cells of values of the vertices, (V,) to (m,)."""
        return np.asarray(values[self.faces].mean(axis=1))

    def at(self, points: Float[Tensor, "n d"], values: FloatArray) -> Float[Tensor, " n"]:
        """Return values of the vertices at points of the surface, each that of the nearest vertex."""
        nearest = cKDTree(self.vertices).query(points.detach().double().cpu().numpy())[1]
        return torch.from_numpy(values[nearest]).to(points)


def surface_mean_curvature(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Return kappa at points of a field's surface (N,): from second derivatives where these tell it, else weak.

    Args:
        points: In an order whose every part is spread evenly.

    Raises:
        ValueError: The gradient vanishes at a point.
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    if normal_turning(field, points).is_smooth:
        return field.mean_curvature(points)
    return weak_mean_curvature(field, points)


def weak_mean_curvature(
    field: Field, points: Float[Tensor, "n d"], *, resolution: int = RESOLUTION
) -> Float[Tensor, " n"]:
    """Return kappa in weak form at points of a field's surface (N,), averaged over a few cells.

    It is the change of area per unit of motion along the field's own normal n, and of area: a facet that moves by b
    along n moves the mesh by b / (N . n) along its normal N, which the averaging has smoothed.

    Args:
        resolution: Cells along the longest side of the bounds of the mesh that it is read from.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
    """
    mesh = WeakSurface.extracted(field, resolution)
    smooth = torch.stack([mesh.at(points, axis) for axis in mesh.averaged_normals.T], dim=1)
    cosines = (smooth * field.normal(points)).sum(dim=1).clamp(min=LEAST_COSINE)
    return mesh.at(points, mesh.mean_curvature) / cosines
