"""The same handles on a mesh of the same surface, and the energies of both.

| method | of meshref |
|---|---|
| ARAP | arap: as rigid as possible |
| Killing | killing: least squares of the linear strain |
| biharmonic | biharmonic: smooth |

Handles of the mesh are the vertices that a region holds with more than half its weight, and those that are held. In a
geometric edit the rest is to stay, so the vertices in no region are held too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

import implicit
import meshref
from compare.cases.handles import HandleSpec
from compare.editor.evidence import Evidence
from compare.editor.linear import Surface
from compare.errors import InputError
from implicit.edits.targets import AveragedTargets, SummedTargets
from implicit.surface.even_mesh import even_mesh

VERTICES = 2000


@dataclass(frozen=True, eq=False)
class Beside:
    """An edit of a mesh beside that of the field.

    Attributes:
        V, F: The mesh before, on the surface of the field.
        moved: Its vertices after the method.
        neural: Its vertices after the edit of the field.
        method: Name of the method.
        status: Sentence that says how it ended.
        energies: Of the mesh and of the field by name of the energy, on the same mesh: (mesh, field).
        seconds: Of the method.
    """

    V: Float[ndarray, "n 3"]
    F: Int[ndarray, "m 3"]
    moved: Float[ndarray, "n 3"]
    neural: Float[ndarray, "n 3"]
    method: str
    status: str
    energies: Mapping[str, tuple[float, float]]
    seconds: float


def _arap(
    V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], at: Int[ndarray, " h"], D: Float[ndarray, "h 3"]
) -> tuple[Float[ndarray, "n 3"], str]:
    result = meshref.arap(V, F, at, V[at] + D)
    return result.V, result.status.value


def _killing(
    V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], at: Int[ndarray, " h"], D: Float[ndarray, "h 3"]
) -> tuple[Float[ndarray, "n 3"], str]:
    result = meshref.killing(V, F, at, D)
    return V + result.displacement, result.status.value


def _biharmonic(
    V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], at: Int[ndarray, " h"], D: Float[ndarray, "h 3"]
) -> tuple[Float[ndarray, "n 3"], str]:
    result = meshref.biharmonic(V, F, at, D)
    return V + result.displacement, result.status.value


METHODS: Mapping[str, Callable[..., tuple[Float[ndarray, "n 3"], str]]] = {
    "ARAP": _arap,
    "Killing": _killing,
    "biharmonic": _biharmonic,
}


def beside(
    before: implicit.Field,
    edit: implicit.Edit,
    handles: Sequence[HandleSpec],
    method: str,
    *,
    rest_stays: bool,
    vertices: int = VERTICES,
) -> Beside:
    """Return what a mesh method makes of the handles of an edit.

    Args:
        before: The field before the edit.
        edit: The edit.
        handles: Of the edit.
        method: One of METHODS.
        rest_stays: Whether vertices in no region are held, as in a geometric edit.
        vertices: About how many the mesh has.

    Raises:
        InputError: There is no such method, or it has no handle or nothing to move.
    """
    if method not in METHODS:
        raise InputError(f"A method is one of {', '.join(METHODS)}, but got {method!r}.")
    points, faces = even_mesh(before, vertices)
    V, F = points.double().numpy(), faces.numpy()
    N = before.normal(points.to(before.theta)).double().numpy()
    at, displacement = _targets(V, N, handles, rest_stays)
    if len(at) in (0, len(V)):
        raise InputError("The mesh has no vertex that is free, or none that is held. Pick other regions.")
    start = perf_counter()
    try:
        moved, status = METHODS[method](V, F, at, displacement)
    except meshref.MeshError as error:
        raise InputError(f"{method} on the mesh: {error}") from error
    seconds = perf_counter() - start
    surface = Surface(V, F, N, meshref.vertex_areas(V, F))
    neural = Evidence.of(surface, edit).carried()
    energies = {
        "Killing, membrane": _both(lambda U: meshref.killing_energy(V, F, U - V), moved, neural),
        "ARAP": _both(lambda U: meshref.arap_energy(V, F, U), moved, neural),
    }
    return Beside(V, F, moved, neural, method, status, energies, seconds)


def _both(
    energy: Callable[[Float[ndarray, "n 3"]], float], moved: Float[ndarray, "n 3"], neural: Float[ndarray, "n 3"]
) -> tuple[float, float]:
    return float(energy(moved)), float(energy(neural))


def _targets(
    V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"], handles: Sequence[HandleSpec], rest_stays: bool
) -> tuple[Int[ndarray, " h"], Float[ndarray, "h 3"]]:
    """Return the vertices that have a target and their displacements to it."""
    points, normals, built = torch.from_numpy(V), torch.from_numpy(N), [handle.build() for handle in handles]
    if rest_stays:
        summed = SummedTargets(built, points, normals)
        weights = torch.stack(summed.handle_weights).amax(dim=0).numpy()
        at = np.flatnonzero((weights == 0) | (weights > 1 - 1e-9))
        return at, summed.displacement().numpy()[at]
    averaged = AveragedTargets(built, points, normals)
    at = np.flatnonzero(torch.stack(averaged.handle_weights).amax(dim=0).numpy() > 0.5)
    return at, (averaged.positions(1.0) - points).numpy()[at]
