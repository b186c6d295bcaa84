"""A deformation of a mesh, taken on to all points of the surface near it, with the normals.

    y(x) = sum over the corners k of the nearest triangle  b_k (u_k + R_k (x - x_k))

b are the barycentric coordinates of the point of the triangle that is nearest to x, x_k and u_k the corner before and
after, R_k its rotation. The map is exact for rigid motions wherever x lies, and follows the curvature of the surface
between the vertices where a triangle alone would cut it off. In the plane, segments of a curve stand for the triangles.
Normals go by the map's own slopes along the tangents,

    dy/dx t = sum b_k R_k t + sum (u_k + R_k (x - x_k)) (grad b_k . t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from implicit.sensitivity.weak_curvature import FloatArray, IntArray, WeakSurface

# Triangles that are looked at for the nearest one, by their middles.
CANDIDATES = 8


@dataclass(frozen=True, eq=False)
class Foot:
    """Points of the surface and the triangles they belong to.

    Attributes:
        points: The points (N, D).
        faces: Number of the triangle of each (N,).
        shares: Barycentric coordinates of each in it (N, D).
    """

    points: FloatArray
    faces: IntArray
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Map of the points near a mesh, by a deformation of it.

    Attributes:
        rest: The mesh before.
        moved: Its vertices after (V, D).
        rotations: Rotation of each vertex (V, D, D).
    """

    rest: WeakSurface
    moved: FloatArray
    rotations: FloatArray

    @cached_property
    def _middles(self) -> cKDTree:
        return cKDTree(self.rest.vertices[self.rest.faces].mean(axis=1))

    def foot(self, points: FloatArray) -> Foot:
        """Return the nearest triangle of each point (N, D), and where in it."""
        count, D = min(CANDIDATES, len(self.rest.faces)), self.rest.dimension
        faces = self._middles.query(points, k=count)[1].reshape(len(points), count)
        corners = self.rest.vertices[self.rest.faces[faces]].reshape(-1, D, D)
        nearest_in = nearest_in_triangles if D == 3 else nearest_on_sides
        nearest = nearest_in(np.repeat(points, count, axis=0), corners)
        at = np.einsum("nk,nkd->nd", nearest, corners).reshape(len(points), count, D)
        best = ((at - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        rows = np.arange(len(points))
        return Foot(points, faces[rows, best], nearest.reshape(len(points), count, D)[rows, best])

    def at(self, foot: Foot | FloatArray) -> FloatArray:
        """Return where points are taken (N, D)."""
        foot = foot if isinstance(foot, Foot) else self.foot(foot)
        return np.asarray(np.einsum("nk,nkd->nd", foot.shares, self._from_corners(foot)))

    def turned(self, foot: Foot, normals: FloatArray) -> FloatArray:
        """Return the unit normals that the points have after the map (N, D), of those before."""
        corners = self.rest.faces[foot.faces]
        tangents = _tangents(normals)
        shifts, mean = self._from_corners(foot), self.rotation(foot)
        slopes = self._share_slopes[foot.faces]
        along = []
        for tangent in tangents:
            steep = np.einsum("nkd,nd->nk", slopes, tangent)
            along.append(np.einsum("nij,nj->ni", mean, tangent) + np.einsum("nk,nkd->nd", steep, shifts))
        across = np.cross(*along) if len(along) == 2 else np.stack([along[0][:, 1], -along[0][:, 0]], axis=1)
        length = np.linalg.norm(across, axis=1, keepdims=True)
        turned = np.einsum("nij,nj->ni", self.rotations[corners[:, 0]], normals)
        return np.where(length > 1e-12, across / np.maximum(length, 1e-300), turned)

    def rotation(self, foot: Foot) -> FloatArray:
        """Return the mean of the corners' rotations at each point (N, D, D), which is a rotation but nearly."""
        return np.asarray(np.einsum("nk,nkij->nij", foot.shares, self.rotations[self.rest.faces[foot.faces]]))

    def _from_corners(self, foot: Foot) -> FloatArray:
        """Return u_k + R_k (x - x_k) for each corner (N, D, D)."""
        corners = self.rest.faces[foot.faces]
        away = foot.points[:, None] - self.rest.vertices[corners]
        return np.asarray(self.moved[corners] + np.einsum("nkij,nkj->nki", self.rotations[corners], away))

    @cached_property
    def _share_slopes(self) -> FloatArray:
        """Gradients of the barycentric coordinates of each cell (m, D, D)."""
        if self.rest.dimension == 2:
            start, end = (self.rest.vertices[self.rest.faces[:, k]] for k in range(2))
            steep = (end - start) / np.maximum(self.rest.contents, 1e-300)[:, None] ** 2
            return np.stack([-steep, steep], axis=1)
        return np.asarray(np.einsum("mtd,mtk->mkd", self.rest.tangents, self.rest.hat_slopes))


def nearest_in_triangles(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the barycentric coordinates (N, 3) of the point of each triangle that is nearest to each point.

    Args:
        points: (N, 3).
        corners: Of one triangle a point (N, 3, 3).
    """
    sides = corners[:, 1:] - corners[:, :1]
    away = points - corners[:, 0]
    gram = np.einsum("nad,nbd->nab", sides, sides)
    right = np.einsum("nad,nd->na", sides, away)
    determinant = np.maximum(gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2, 1e-300)
    v = (gram[:, 1, 1] * right[:, 0] - gram[:, 0, 1] * right[:, 1]) / determinant
    w = (gram[:, 0, 0] * right[:, 1] - gram[:, 0, 1] * right[:, 0]) / determinant
    shares = np.stack([1 - v - w, v, w], axis=1)
    outside = (shares < 0).any(axis=1)
    if outside.any():
        shares[outside] = nearest_on_sides(points[outside], corners[outside])
    return shares


def nearest_on_sides(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the barycentric coordinates (N, k) of the nearest point of the sides of polygons, or of segments.

    Args:
        points: (N, D).
        corners: Of one polygon a point (N, k, D).
    """
    start, end = corners, np.roll(corners, -1, axis=1)
    side = end - start
    way = np.einsum("nkd,nkd->nk", points[:, None] - start, side)
    part = np.clip(way / np.maximum((side**2).sum(axis=2), 1e-300), 0, 1)
    gaps = ((start + part[:, :, None] * side - points[:, None]) ** 2).sum(axis=2)
    best, rows = gaps.argmin(axis=1), np.arange(len(points))
    shares = np.zeros(corners.shape[:2])
    shares[rows, best] = 1 - part[rows, best]
    shares[rows, (best + 1) % corners.shape[1]] = part[rows, best]
    return shares


def _tangents(normals: FloatArray) -> tuple[FloatArray, ...]:
    """Return unit vectors square to each normal, one in the plane and two in space, that turn to it as the axes do."""
    if normals.shape[1] == 2:
        return (np.stack([-normals[:, 1], normals[:, 0]], axis=1),)
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    tangent = np.cross(normals, axis)
    first = tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    return first, np.cross(normals, first)
