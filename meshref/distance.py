"""Signed distance from points to a mesh: negative inside, exact, right at the mouths of holes.

The distance comes from the nearest triangle, the sign from the winding number (inside where it is above 1/2).
libigl's own signed_distance returns (1 - 2w) times the distance instead, which is 0 at the mouth of a hole.
Source of the winding number: Barill, Dickson, Schmidt, Levin, Jacobson, "Fast winding numbers", 2018.
"""

from __future__ import annotations

from typing import NamedTuple

import igl
import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError, check_mesh, finite_points, place
from meshref.measures import doubled_area_vectors, summed_normals, unit_or_zero
from meshref.printing import brief
from meshref.solids import inverted_face
from meshref.topology import FloatArray, IntArray, edge_table

# Nearer to the surface than this part of the mesh's size, point minus nearest point is mostly rounding.
ON_SURFACE = 1e-8

_NOT_LOOKED_FOR = -1  # in place of a face that looks inwards


class SignedDistance(NamedTuple):
    """Signed distances, nearest points, their faces, and normals of k points."""

    distance: FloatArray  # (k,), negative inside, in the length unit of V
    closest: FloatArray  # (k, 3), nearest point of the surface
    face: IntArray  # (k,), the face it lies on
    normal: FloatArray  # (k, 3), unit gradient of the distance; on the surface, the normal of the surface

    def __repr__(self) -> str:
        return brief(self)


def signed_distance(V: ArrayLike, F: ArrayLike, P: ArrayLike) -> SignedDistance:
    """Return distance, nearest point, face and normal of points P (k, 3); SignedDistanceQuery does so many times.

    Raises:
        MeshError: check_mesh refuses the mesh, a part of it is inside out, or P is not k finite points.
    """
    return SignedDistanceQuery(V, F)(P)


class SignedDistanceQuery:
    """The search trees of one mesh, to be asked many times: query(P) -> SignedDistance."""

    def __init__(self, V: ArrayLike, F: ArrayLike) -> None:
        """Build the trees.

        Args:
            V: Vertices, (n, 3).
            F: Faces, (m, 3), oriented outwards. They may be open: a point is inside where the surface winds round it
                by more than half. Faces without area are allowed.

        Raises:
            MeshError: check_mesh refuses the mesh. Where the first sign is asked for, a part of it is inside out: every
                sign there would be wrong.
        """
        V, F = check_mesh(V, F, degenerate="allow")
        # The trees work in coordinates about the middle, which keep more digits than those far from the origin.
        self._middle = (V.min(axis=0) + V.max(axis=0)) / 2
        self._V, self._F = V - self._middle, F
        self._size = float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
        self._tree = igl.AABB()
        self._tree.init(self._V, self._F)
        self._winding = igl.FastWindingNumberBVH()
        self._winding.init(self._V, self._F, 2)
        self._inverted: int | None = _NOT_LOOKED_FOR
        self._normals: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def __call__(self, P: ArrayLike) -> SignedDistance:
        """Return the signed distances of points P, (k, 3)."""
        points = finite_points(P, "P", "points") - self._middle
        if len(points) == 0:
            return SignedDistance(np.zeros(0), np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        distance, face, closest = self._nearest(points)
        sign = np.where(self._winding_number(points) > 0.5, -1.0, 1.0)
        on_surface = distance <= ON_SURFACE * self._size
        away = (points - closest) * sign[:, None]
        normal = np.divide(away, distance[:, None], out=np.zeros_like(away), where=~on_surface[:, None])
        if on_surface.any():
            normal[on_surface] = self._surface_normals(face[on_surface], closest[on_surface])
        return SignedDistance(sign * distance, closest + self._middle, face, unit_or_zero(normal))

    def distance(self, P: ArrayLike) -> tuple[FloatArray, IntArray]:
        """Return unsigned distance (k,) and nearest face (k,) of points P, (k, 3): half the work of a full answer."""
        points = finite_points(P, "P", "points") - self._middle
        distance, face, _ = self._nearest(points) if len(points) else (np.zeros(0), np.zeros(0, dtype=np.int64), points)
        return distance, face

    def inside(self, P: ArrayLike) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return True, (k,), for each of the points P, (k, 3), that the surface winds round by more than half."""
        points = finite_points(P, "P", "points") - self._middle
        if len(points) == 0:
            return np.zeros(0, dtype=np.bool_)
        return self._winding_number(points) > 0.5

    def _nearest(self, points: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        squared, face, closest = self._tree.squared_distance(self._V, self._F, points)
        face = np.asarray(face, dtype=np.int64).reshape(-1)
        return np.sqrt(np.asarray(squared).reshape(-1)), face, np.asarray(closest).reshape(-1, 3)

    def _winding_number(self, points: FloatArray) -> FloatArray:
        if self._inverted == _NOT_LOOKED_FOR:
            self._inverted = inverted_face(self._V, self._F)
        if self._inverted is not None:
            raise MeshError(
                f"faces must be oriented outwards, but those of the part of face {self._inverted} near "
                f"{place(self._V[self._F[self._inverted, 0]] + self._middle)} look inwards, and inside and outside "
                "would be taken for each other. Turn them with mend_mesh, or pass F[:, ::-1]."
            )
        return np.asarray(self._winding.winding_number(points)).reshape(-1)

    def _surface_normals(self, face: IntArray, closest: FloatArray) -> FloatArray:
        """Return the normal of the face, edge (sum of its faces) or vertex (sum by angle) that each point lies on."""
        if self._normals is None:
            self._normals = _feature_normals(self._V, self._F)
        of_face, of_edge, of_vertex = self._normals
        corners = self._V[self._F[face]]
        # Height over each side, as a part of the corner's: the barycentric coordinates.
        weight = _barycentric(closest, corners)
        tiny = weight < 1e-7
        normal = of_face[face]
        on_edge, on_vertex = tiny.sum(axis=1) == 1, tiny.sum(axis=1) >= 2
        # The side opposite to corner k is half-edge k + 1 of the face.
        side = 3 * face + (tiny.argmax(axis=1) + 1) % 3
        normal[on_edge] = of_edge[side[on_edge]]
        normal[on_vertex] = of_vertex[self._F[face, weight.argmax(axis=1)][on_vertex]]
        return normal


def _feature_normals(V: FloatArray, F: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    of_face = unit_or_zero(doubled_area_vectors(V, F))
    table = edge_table(F, len(V))
    of_half_edge = np.repeat(of_face, 3, axis=0)
    k = len(table.edges)
    of_edge = np.stack([np.bincount(table.of_half_edge, weights=x, minlength=k) for x in of_half_edge.T], axis=1)
    return of_face, np.asarray(of_edge[table.of_half_edge], dtype=np.float64), summed_normals(V, F, "angle")


def _barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(a, b)
    squared = (normal**2).sum(axis=1)
    safe = np.where(squared > 0, squared, 1)
    second = (np.cross(p, b) * normal).sum(axis=1) / safe
    third = (np.cross(a, p) * normal).sum(axis=1) / safe
    return np.stack([1 - second - third, second, third], axis=1)
