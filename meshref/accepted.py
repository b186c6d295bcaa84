"""Meshes as other libraries hold them, as the arrays V and F that all of meshref takes."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from meshref.check import MeshError, as_arrays
from meshref.files import read_mesh
from meshref.topology import FloatArray, IntArray


def as_mesh(mesh: Any) -> tuple[FloatArray, IntArray]:
    """Return vertices V (n, 3) and faces F (m, 3) of a mesh in any usual form, checked as all arrays are.

    Args:
        mesh: (V, F); a trimesh.Trimesh, or whatever has `vertices` and `faces`; a pyvista.PolyData of triangles; or
            the name of a mesh file.

    Raises:
        MeshError: It is none of these, has faces of more corners, or its arrays are no mesh.
    """
    if isinstance(mesh, str | os.PathLike):
        return as_arrays(*read_mesh(mesh))
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        return as_arrays(*mesh)
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):  # trimesh, open3d-like, and many others
        return as_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    if hasattr(mesh, "points") and hasattr(mesh, "faces"):  # pyvista, whose faces say how many corners each has
        return as_arrays(np.asarray(mesh.points), _of_vtk(np.asarray(mesh.faces)))
    raise MeshError(
        f"a mesh must be (V, F), a trimesh.Trimesh, a pyvista.PolyData or the name of a file, but is a "
        f"{type(mesh).__name__}."
    )


def _of_vtk(faces: Any) -> Any:
    """Return the faces of VTK's list, which has the number of corners before each."""
    if faces.ndim == 2:
        return faces
    if faces.size % 4 or (faces[::4] != 3).any():
        raise MeshError("a pyvista mesh must have triangles alone. Call its triangulate() first.")
    return faces.reshape(-1, 4)[:, 1:]
