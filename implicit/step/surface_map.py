"""A deformation of a mesh, taken on to all points of the surface near it, with the normals.

    y(x) = sum over the corners k of the nearest triangle  b_k (u_k + R_k (x - x_k))

b are the barycentric coordinates of the point of the triangle that is nearest to x, x_k and u_k the corner before and
after, R_k its rotation. The map is exact for rigid motions wherever x lies, and follows the curvature of the surface
between the vertices where a triangle alone would cut it off. Normals go by the map's own slopes along two tangents,

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
        points: The points (N, 3).
        faces: Number of the triangle of each (N,).
        shares: Barycentric coordinates of each in it (N, 3).
    """

    points: FloatArray
    faces: IntArray
    shares: FloatArray


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """Map of the points near a mesh, by a deformation of it.

    Attributes:
        rest: The mesh before.
        moved: Its vertices after (V, 3).
        rotations: Rotation of each vertex (V, 3, 3).
    """

    rest: WeakSurface
    moved: FloatArray
    rotations: FloatArray

    @cached_property
    def _middles(self) -> cKDTree:
        return cKDTree(self.rest.vertices[self.rest.faces].mean(axis=1))

    def foot(self, points: FloatArray) -> Foot:
        """Return the nearest triangle of each point (N, 3), and where in it."""
        count = min(CANDIDATES, len(self.rest.faces))
        faces = self._middles.query(points, k=count)[1].reshape(len(points), count)
        corners = self.rest.vertices[self.rest.faces[faces]].reshape(-1, 3, 3)
        nearest = nearest_in_triangles(np.repeat(points, count, axis=0), corners)
        at = np.einsum("nk,nkd->nd", nearest, corners).reshape(len(points), count, 3)
        best = ((at - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
        rows = np.arange(len(points))
        return Foot(points, faces[rows, best], nearest.reshape(len(points), count, 3)[rows, best])

    def at(self, foot: Foot | FloatArray) -> FloatArray:
        """Return where points are taken (N, 3)."""
        foot = foot if isinstance(foot, Foot) else self.foot(foot)
        return np.asarray(np.einsum("nk,nkd->nd", foot.shares, self._from_corners(foot)))

    def turned(self, foot: Foot, normals: FloatArray) -> FloatArray:
        """Return the unit normals that the points have after the map (N, 3), of those before."""
        corners = self.rest.faces[foot.faces]
        first = _any_tangents(normals)
        second = np.cross(normals, first)
        shifts, mean = self._from_corners(foot), self.rotation(foot)
        slopes = self._share_slopes[foot.faces]
        along = []
        for tangent in (first, second):
            steep = np.einsum("nkd,nd->nk", slopes, tangent)
            along.append(np.einsum("nij,nj->ni", mean, tangent) + np.einsum("nk,nkd->nd", steep, shifts))
        across = np.cross(along[0], along[1])
        length = np.linalg.norm(across, axis=1, keepdims=True)
        turned = np.einsum("nij,nj->ni", self.rotations[corners[:, 0]], normals)
        return np.where(length > 1e-12, across / np.maximum(length, 1e-300), turned)

    def rotation(self, foot: Foot) -> FloatArray:
        """Return the mean of the corners' rotations at each point (N, 3, 3), which is a rotation but nearly."""
        return np.asarray(np.einsum("nk,nkij->nij", foot.shares, self.rotations[self.rest.faces[foot.faces]]))

    def _from_corners(self, foot: Foot) -> FloatArray:
        """Return u_k + R_k (x - x_k) for each corner (N, 3, 3)."""
        corners = self.rest.faces[foot.faces]
        away = foot.points[:, None] - self.rest.vertices[corners]
        return np.asarray(self.moved[corners] + np.einsum("nkij,nkj->nki", self.rotations[corners], away))

    @cached_property
    def _share_slopes(self) -> FloatArray:
        """Gradients of the barycentric coordinates of each triangle (m, 3, 3)."""
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
        shares[outside] = _nearest_on_sides(points[outside], corners[outside])
    return shares


def _nearest_on_sides(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the barycentric coordinates of the nearest point of the three sides (N, 3)."""
    start, end = corners, np.roll(corners, -1, axis=1)
    side = end - start
    way = np.einsum("nkd,nkd->nk", points[:, None] - start, side)
    part = np.clip(way / np.maximum((side**2).sum(axis=2), 1e-300), 0, 1)
    gaps = ((start + part[:, :, None] * side - points[:, None]) ** 2).sum(axis=2)
    best, rows = gaps.argmin(axis=1), np.arange(len(points))
    shares = np.zeros((len(points), 3))
    shares[rows, best] = 1 - part[rows, best]
    shares[rows, (best + 1) % 3] = part[rows, best]
    return shares


def _any_tangents(normals: FloatArray) -> FloatArray:
    """Return a unit vector square to each normal."""
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    tangent = np.cross(normals, axis)
    return np.asarray(tangent / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300))
