"""Measures between two surfaces: distances, normals, overlap.

Distances run from sampled points of one surface to the exact nearest point on the triangles of the other, both ways.
The vertices are among the samples of the largest distance: it is then a lower bound that misses only what lies between
samples. (libigl's hausdorff looks at vertices alone, and finds 0 between a flat triangle and its three corners.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError, check_mesh, finite_points, require_whole, vertex_indices
from meshref.distance import SignedDistanceQuery
from meshref.measures import doubled_area_vectors, face_areas
from meshref.printing import brief
from meshref.topology import FloatArray, IntArray


class MeshSample(NamedTuple):
    """Points drawn from a surface."""

    points: FloatArray  # (k, 3)
    face: IntArray  # (k,), the face of each
    normals: FloatArray  # (k, 3), the unit normal of that face

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, eq=False)
class SurfaceDistance:
    """Distances between surface 1 and surface 2; lengths in the unit of V."""

    mean_1_to_2: float  # mean distance from points of surface 1 to surface 2
    mean_2_to_1: float
    rms: float  # root mean square over the points of both
    max_1_to_2: float  # largest distance from points and vertices of surface 1 to surface 2
    max_2_to_1: float
    normal_consistency: float  # mean cosine between the normals at a point and at its nearest point, both ways

    __repr__ = brief

    @property
    def chamfer(self) -> float:
        """Mean of the two mean distances."""
        return (self.mean_1_to_2 + self.mean_2_to_1) / 2

    @property
    def hausdorff(self) -> float:
        """Larger of the two largest distances."""
        return max(self.max_1_to_2, self.max_2_to_1)


def surface_distance(
    V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 20_000, seed: int = 0
) -> SurfaceDistance:
    """Return all distances between two surfaces at once, from n random points on each.

    Args:
        V1, F1: Vertices (n1, 3) and faces (m1, 3) of the first surface, open or closed.
        V2, F2: The second.
        n: Points drawn on each; the means have a relative error of about 1 / sqrt(n).
        seed: The same seed gives the same points.

    Raises:
        MeshError: check_mesh refuses a mesh, or n is not positive.
    """
    there = _one_way(V1, F1, V2, F2, n, seed)
    back = _one_way(V2, F2, V1, F1, n, seed)
    return SurfaceDistance(
        mean_1_to_2=float(there.distance.mean()),
        mean_2_to_1=float(back.distance.mean()),
        rms=float(np.sqrt((np.mean(there.distance**2) + np.mean(back.distance**2)) / 2)),
        max_1_to_2=there.largest,
        max_2_to_1=back.largest,
        normal_consistency=float((there.cosine.mean() + back.cosine.mean()) / 2),
    )


def chamfer(V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 20_000, seed: int = 0) -> float:
    """Return the mean distance between two surfaces (not squared), the mean of both ways.

    Args:
        V1, F1, V2, F2, n, seed: See surface_distance.

    Raises:
        MeshError: See surface_distance.
    """
    return surface_distance(V1, F1, V2, F2, n, seed).chamfer


def hausdorff(V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 20_000, seed: int = 0) -> float:
    """Return the largest distance between two surfaces over samples and vertices, both ways.

    Args:
        V1, F1, V2, F2, n, seed: See surface_distance.

    Raises:
        MeshError: See surface_distance.
    """
    return surface_distance(V1, F1, V2, F2, n, seed).hausdorff


def normal_consistency(
    V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 20_000, seed: int = 0
) -> float:
    """Return the mean cosine of the normals of two surfaces at nearest points, 1 where they agree.

    Args:
        V1, F1, V2, F2, n, seed: See surface_distance.

    Raises:
        MeshError: See surface_distance.
    """
    return surface_distance(V1, F1, V2, F2, n, seed).normal_consistency


def iou(V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 100_000, seed: int = 0) -> float:
    """Return the volume of intersection over union of two solids, from n random points in their common box.

    Args:
        V1, F1: Vertices (n1, 3) and faces (m1, 3) of the first, oriented outwards; small holes do no harm.
        V2, F2: The second.
        n: Points drawn.
        seed: The same seed gives the same points.

    Raises:
        MeshError: check_mesh refuses a mesh, n is not positive, or no point lies in either solid.
    """
    require_whole("n", n)
    require_whole("seed", seed, 0)
    first, second = SignedDistanceQuery(V1, F1), SignedDistanceQuery(V2, F2)
    both = np.concatenate([np.asarray(V1, dtype=np.float64), np.asarray(V2, dtype=np.float64)])
    points = np.random.default_rng(seed).uniform(both.min(axis=0), both.max(axis=0), (n, 3))
    in_first, in_second = first.inside(points), second.inside(points)
    union = np.count_nonzero(in_first | in_second)
    if union == 0:
        raise MeshError(f"none of {n} points lies inside either solid. Are the faces oriented outwards? See mend_mesh.")
    return float(np.count_nonzero(in_first & in_second) / union)


def sample_mesh(V: ArrayLike, F: ArrayLike, n: int, seed: int = 0) -> MeshSample:
    """Draw n points from a surface, every piece with a chance in proportion to its area.

    Args:
        V: Vertices, (m, 3).
        F: Faces, (m, 3).
        n: Number of points.
        seed: The same seed gives the same points.

    Raises:
        MeshError: check_mesh refuses the mesh, n is not positive, or the mesh has no area.
    """
    V, F = check_mesh(V, F, degenerate="allow")
    require_whole("n", n)
    require_whole("seed", seed, 0)
    doubled = doubled_area_vectors(V, F)
    length = np.linalg.norm(doubled, axis=1)
    if length.sum() == 0:
        raise MeshError("no points can be drawn from a mesh without area. Remove its degenerate faces with mend_mesh.")
    generator = np.random.default_rng(seed)
    face = generator.choice(len(F), size=n, p=length / length.sum())
    # A parallelogram is filled evenly by two even coordinates; the half outside the triangle is folded back.
    s, t = generator.random((2, n))
    folded = s + t > 1
    s, t = np.where(folded, 1 - s, s)[:, None], np.where(folded, 1 - t, t)[:, None]
    a, b, c = V[F[face]].transpose(1, 0, 2)
    return MeshSample(a + s * (b - a) + t * (c - a), face.astype(np.int64), doubled[face] / length[face, None])


def handle_error(displacement: ArrayLike, handles: ArrayLike, wanted: ArrayLike) -> float:
    """Return the largest distance by which a handle vertex misses its wanted displacement, in the unit of V.

    Args:
        displacement: Displacement of every vertex, (n, 3).
        handles: Numbers of the handle vertices, (h,).
        wanted: Their wanted displacements, (h, 3).

    Raises:
        MeshError: The shapes do not fit.
    """
    field, target = finite_points(displacement, "displacement", "vertices"), finite_points(wanted, "wanted", "handles")
    rows = vertex_indices(handles, len(field))
    if len(rows) != len(target):
        raise MeshError(f"wanted must have a row for each of the {len(rows)} handles, but has {len(target)} rows.")
    return float(np.linalg.norm(field[rows] - target, axis=1).max(initial=0.0))


class _OneWay(NamedTuple):
    distance: FloatArray  # of the samples
    cosine: FloatArray  # between the normals
    largest: float  # of samples and vertices


def _one_way(V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int, seed: int) -> _OneWay:
    sample = sample_mesh(V1, F1, n, seed)
    query = SignedDistanceQuery(V2, F2)
    V2, F2 = check_mesh(V2, F2, degenerate="allow")
    distance, face = query.distance(sample.points)
    from_vertices, _ = query.distance(V1)
    doubled = doubled_area_vectors(V2, F2)[face]
    length = 2 * face_areas(V2, F2)[face]
    dot = np.einsum("ij,ij->i", sample.normals, doubled)
    cosine = np.divide(dot, length, out=np.zeros(n), where=length > 0)
    return _OneWay(distance, cosine, float(max(distance.max(), from_vertices.max())))
