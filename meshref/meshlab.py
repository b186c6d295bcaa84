"""MeshLab's smoothing, remeshing and sampled distance, as a second opinion.

The one file that imports pymeshlab, and only when one of its functions is called: the library is under the
GPL, and nothing else here needs it. Its vertices are double precision, but several of its filters compute in single.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError, check_mesh, require_positive, require_whole
from meshref.printing import brief
from meshref.topology import FloatArray, IntArray


class MeshlabDistance(NamedTuple):
    """One-way distances between samples of one surface and another, in the unit of V."""

    max_1_to_2: float
    max_2_to_1: float
    mean_1_to_2: float
    mean_2_to_1: float

    def __repr__(self) -> str:
        return brief(self)

    @property
    def hausdorff(self) -> float:
        """Larger of the two largest distances."""
        return max(self.max_1_to_2, self.max_2_to_1)


def laplacian_smooth(V: ArrayLike, F: ArrayLike, steps: int = 3) -> FloatArray:
    """Return vertices (n, 3) after moving each to the mean of its neighbours, steps times. Shrinks.

    Raises:
        MeshError: check_mesh refuses the mesh, or pymeshlab is missing or fails.
    """
    V, F = check_mesh(V, F)
    require_whole("steps", steps)
    options = {"stepsmoothnum": int(steps), "cotangentweight": False}
    return _filtered(V, F, "apply_coord_laplacian_smoothing", **options)[0]


def taubin_smooth(V: ArrayLike, F: ArrayLike, steps: int = 10, shrink: float = 0.5, grow: float = -0.53) -> FloatArray:
    """Return vertices (n, 3) after steps of smoothing by shrink and un-smoothing by grow; the volume nearly stays.

    Source: Taubin, "A signal processing approach to fair surface design", 1995.

    Raises:
        MeshError: check_mesh refuses the mesh, the factors have the wrong signs, or pymeshlab is missing or fails.
    """
    V, F = check_mesh(V, F)
    require_whole("steps", steps)
    require_positive("shrink", shrink)
    if not (isinstance(grow, int | float) and shrink < 1 and grow < -shrink):
        raise MeshError(f"shrink must be in (0, 1) and grow below -shrink, but they are {shrink} and {grow!r}.")
    options = {"stepsmoothnum": int(steps), "lambda_": shrink, "mu": grow}
    return _filtered(V, F, "apply_coord_taubin_smoothing", **options)[0]


def isotropic_remesh(
    V: ArrayLike, F: ArrayLike, edge_length: float, iterations: int = 10
) -> tuple[FloatArray, IntArray]:
    """Return a mesh of the same surface whose edges are all about as long as told.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        edge_length: Wanted length of the edges, in the unit of V.
        iterations: Rounds of splitting, collapsing, flipping and smoothing.

    Raises:
        MeshError: check_mesh refuses the mesh, the length is not positive, or pymeshlab is missing or fails.
    """
    V, F = check_mesh(V, F)
    require_positive("edge_length", edge_length, "length")
    require_whole("iterations", iterations)
    target = _pymeshlab().PureValue(float(edge_length))
    options = {"iterations": int(iterations), "targetlen": target}
    return _filtered(V, F, "meshing_isotropic_explicit_remeshing", **options)


def decimate(V: ArrayLike, F: ArrayLike, faces: int) -> tuple[FloatArray, IntArray]:
    """Return a mesh of about so many faces, its edges collapsed where that moves the surface least.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        faces: Number of faces to come down to; a closed mesh keeps half as many vertices.

    Raises:
        MeshError: check_mesh refuses the mesh, the number is not positive, or pymeshlab is missing or fails.

    Source: Garland and Heckbert, "Surface simplification using quadric error metrics", 1997.
    """
    V, F = check_mesh(V, F)
    require_whole("faces", faces, 4)
    options = {"targetfacenum": int(faces), "preservetopology": True, "preservenormal": True, "qualitythr": 0.3}
    return _filtered(V, F, "meshing_decimation_quadric_edge_collapse", **options)


def hausdorff_distance(V1: ArrayLike, F1: ArrayLike, V2: ArrayLike, F2: ArrayLike, n: int = 20_000) -> MeshlabDistance:
    """Return MeshLab's sampled distance, both ways: its filter goes one way only, and from the vertices by default.

    Args:
        V1, F1: Vertices (n1, 3) and faces (m1, 3) of the first surface.
        V2, F2: The second.
        n: Points on the faces, besides the vertices. They are drawn anew each time.

    Raises:
        MeshError: check_mesh refuses a mesh, or pymeshlab is missing or fails.
    """
    require_whole("n", n)
    meshes = _mesh_set(*check_mesh(V1, F1)), _mesh_set(*check_mesh(V2, F2))
    both = meshes[0]
    both.add_mesh(meshes[1].current_mesh(), "second")
    options = {"samplevert": True, "sampleface": True, "samplenum": int(n)}
    there = _apply(both, "get_hausdorff_distance", sampledmesh=0, targetmesh=1, **options)
    back = _apply(both, "get_hausdorff_distance", sampledmesh=1, targetmesh=0, **options)
    return MeshlabDistance(float(there["max"]), float(back["max"]), float(there["mean"]), float(back["mean"]))


def _filtered(V: FloatArray, F: IntArray, name: str, **options: Any) -> tuple[FloatArray, IntArray]:
    mesh_set = _mesh_set(V, F)
    _apply(mesh_set, name, **options)
    mesh = mesh_set.current_mesh()
    # Its arrays are in Fortran order, and the faces 32-bit.
    vertices = np.ascontiguousarray(mesh.vertex_matrix(), dtype=np.float64)
    faces = np.ascontiguousarray(mesh.face_matrix(), dtype=np.int64)
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise MeshError(
            f"MeshLab's {name} left no usable mesh. Take fewer steps, or a length nearer to the present one."
        )
    return vertices, faces


def _mesh_set(V: FloatArray, F: IntArray) -> Any:
    library = _pymeshlab()
    mesh_set = library.MeshSet(verbose=False)
    mesh_set.add_mesh(library.Mesh(V, F), "mesh")
    return mesh_set


def _apply(mesh_set: Any, name: str, **options: Any) -> Any:
    library = _pymeshlab()
    try:
        return mesh_set.apply_filter(name, **options)
    except (library.PyMeshLabException, RuntimeError) as error:
        raise MeshError(f"MeshLab's {name} failed: {error}") from None


def _pymeshlab() -> Any:
    try:
        return importlib.import_module("pymeshlab")
    except ImportError as error:
        raise MeshError(f"this needs pymeshlab, which cannot be imported ({error}). Install pymeshlab.") from None
