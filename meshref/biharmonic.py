"""Biharmonic deformation: handles go where they are told, the rest follows as smoothly as it can.

    minimise  integral of |Lap d|^2 = d^T L M^-1 L d       over the displacements d that agree with the handles

It is linear and knows no rotation: details lean where the surface turns. Source: Botsch and Kobbelt, An intuitive
framework for real-time freeform modeling, 2004.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from meshref.check import check_mesh, handle_vectors, require_handle_on_each_part, vertex_indices
from meshref.curvature import laplacian
from meshref.factor import Solver, factorise
from meshref.measures import lumped_areas
from meshref.printing import brief
from meshref.topology import FloatArray


class BiharmonicStatus(Enum):
    """End of a solve; the value is the sentence a user reads."""

    SOLVED = "The smoothest displacement that agrees with the handles was found."
    INACCURATE = "The mesh is too ill-shaped for the solver: the displacement is off by more than rounding."


@dataclass(frozen=True, eq=False)
class BiharmonicResult:
    """A displacement of all vertices, its energy, and the residual of the equations."""

    displacement: FloatArray  # (n, 3), in the units of V
    energy: float  # the integral of |Lap d|^2, a pure number
    residual: float  # of the equations, relative to the sizes of their terms
    solver: str  # the library that did it
    status: BiharmonicStatus

    __repr__ = brief


def biharmonic(
    V: ArrayLike, F: ArrayLike, handles: ArrayLike, displacements: ArrayLike, *, solver: Solver = "auto"
) -> BiharmonicResult:
    """Move handles and let the rest follow smoothly.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        handles: Numbers of the vertices with a prescribed displacement, (h,), each once.
        displacements: Their displacements, (h, 3).
        solver: See factorise.

    Raises:
        MeshError: The mesh or the handles cannot be used, or a part of the mesh has no handle.
    """
    V, F = check_mesh(V, F)
    held = vertex_indices(handles, len(V))
    wanted = handle_vectors(displacements, held, "displacements")
    require_handle_on_each_part(V, F, held)
    L = laplacian(V, F)
    energy = sparse.csc_array(L @ sparse.diags_array(1 / lumped_areas(V, F)) @ L)
    d = np.zeros_like(V)
    d[held] = wanted
    free = np.setdiff1d(np.arange(len(V)), held)
    if free.size == 0:
        return _result(energy, d, 0.0, "none needed")
    right = -(energy[free] @ d)
    factor = factorise(sparse.csc_array(energy[free][:, free]), solver)
    d[free] = factor.solve(right)
    terms = abs(energy[free]) @ abs(d)
    residual = float(np.abs(energy[free] @ d).max() / max(terms.max(), 1e-300))
    return _result(energy, d, residual, factor.solver)


def _result(energy: sparse.csc_array, d: FloatArray, residual: float, solver: str) -> BiharmonicResult:
    status = BiharmonicStatus.SOLVED if residual < 1e-9 else BiharmonicStatus.INACCURATE
    return BiharmonicResult(d, float((d * (energy @ d)).sum()), residual, solver, status)
