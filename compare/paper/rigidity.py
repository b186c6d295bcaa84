"""Rigidity and time of a small neural step beside the Killing least squares of the mesh.

Both sides are linear, or nearly, for a small motion, so that energies can be divided. A field cannot place its handles
exactly, and a handle that lags costs less energy: the mesh's handles are therefore held by springs, as stiff as leaves
them the same error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.optimize import brentq

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.paper.scenes import pulled_less
from compare.runs.operations import target_motion
from compare.runs.subject import Subject, common_mesh
from meshref.killing import Form
from meshref.primitives import split_in_four

PART = 0.01  # of the pull of default_cases, itself 15 % of the longest side
POINTS = 2000
PENALTIES = (1e1, 1e8)  # between which the springs are sought, per squared length and area of the surface
SAME_ERROR = 0.02  # how near the two handle errors are brought, relative
REMESHED = 10_000  # vertices beyond which meshes are split instead, for remeshing takes longer than solving


@dataclass(frozen=True)
class Rigidity:
    """Energies of the neural step over those of the mesh Killing least squares, on the common mesh."""

    tangential: float  # int |P (J + J^T) P|^2, the headline
    spokes_and_rims: float  # with bending, in the form that the mesh minimises
    handle_error: float  # of the neural step, rms over the handles' vertices and over the pull
    mesh_handle_error: float
    seconds: float  # of the neural step, its points given


@dataclass(frozen=True)
class Timing:
    """Seconds of assembly, factorisation and solve of the mesh Killing least squares on one mesh."""

    vertices: int
    seconds: float
    solver: str  # the one that meshref takes to be the fastest of those installed


def rigidity(shape: str, subject: Subject, *, points: int = POINTS, part: float = PART, seed: int = 0) -> Rigidity:
    """Measure one linear step of `implicit.rigid_edit`, with its default options, on the pull of `default_cases`.

    Args:
        shape: As for Case.
        subject: It, made ready.
        points: That carry the neural energies.
        part: Of the pull; both energies are quadratic in it as long as it is small.
        seed: Of the points and of the tangential features.

    Raises:
        ValueError: No stiffness leaves the mesh's handles as far off as the field's are.
    """
    V, F = subject.V, subject.F
    case = pulled_case(shape, subject, part)
    target = target_motion(case, subject)
    handles = np.flatnonzero(target.at)
    moved = target.displacement[handles]

    def missed(D: Float[ndarray, "n 3"]) -> float:
        return float(np.sqrt(((D[handles] - moved) ** 2).sum(axis=1).mean()) / target.largest)

    def by_mesh(penalty: float) -> Float[ndarray, "n 3"]:
        return meshref.killing(V, F, handles, moved, method="soft", penalty=penalty).displacement

    neural, seconds = neural_step(case, subject, points=points, seed=seed)
    error = missed(neural)
    low, high = (np.log(penalty) for penalty in PENALTIES)
    if not missed(by_mesh(PENALTIES[1])) < error < missed(by_mesh(PENALTIES[0])):
        raise ValueError(
            f"The neural step leaves its handles {error:.2g} of the pull away, which no spring between "
            f"{PENALTIES[0]:.0e} and {PENALTIES[1]:.0e} on the mesh does. Take other points or options."
        )
    # The error is about one over the stiffness, so a tolerance in the logarithm of one is that of the other.
    found = brentq(lambda p: np.log(missed(by_mesh(float(np.exp(p)))) / error), low, high, xtol=SAME_ERROR)
    mesh = by_mesh(float(np.exp(found)))

    def over_the_mesh(form: Form) -> float:
        return meshref.killing_energy(V, F, neural, form) / meshref.killing_energy(V, F, mesh, form)

    return Rigidity(over_the_mesh("membrane"), over_the_mesh("spokes-and-rims"), error, missed(mesh), seconds)


def pulled_case(shape: str, subject: Subject, part: float = PART) -> Case:
    """Return the pull of `default_cases`, a part as long."""
    (case,) = default_cases(shape, subject.V, subject.N, operations=("rigid",))
    return pulled_less(case, part)


def neural_step(
    case: Case, subject: Subject, *, points: int = POINTS, seed: int = 0
) -> tuple[Float[ndarray, "n 3"], float]:
    """Return one step of the case: how it moves the common mesh, and its seconds without those of sampling."""
    handles = [spec.build() for spec in case.handles]
    sample = implicit.sample_surface(subject.field, points, "farthest", seed=seed)
    edit = implicit.rigid_edit(
        subject.field, handles, method="linear", points=sample, track=torch.from_numpy(subject.V), seed=seed
    )
    assert edit.tracked is not None
    start = perf_counter()
    implicit.rigid_edit(
        subject.field, handles, method="linear", points=sample, seed=seed
    )  # as it is used, with nothing to carry along
    return edit.tracked.double().numpy() - subject.V, perf_counter() - start


def mesh_seconds(case: Case, subject: Subject, vertices: int) -> Timing:
    """Return the mesh Killing least squares of the case on a mesh of the same surface."""
    V, F = mesh_of(subject.field, vertices)
    finer = replace(subject, V=V, F=F, N=subject.field.normal(torch.from_numpy(V)).numpy())
    target = target_motion(case, finer)
    handles = np.flatnonzero(target.at)
    result = meshref.killing(V, F, handles, target.displacement[handles])
    return Timing(len(V), sum(result.seconds.values()), result.solver)


def mesh_of(field: implicit.Field, vertices: int) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]:
    """Return a mesh of the field's surface with about as many vertices, by splitting where remeshing takes long."""
    splits = 0
    while vertices / 4**splits > REMESHED:
        splits += 1
    V, F, _ = common_mesh(field, round(vertices / 4**splits), 96)
    for _ in range(splits):
        V, F = split_in_four(V, F)
    return implicit.project_to_surface(field, torch.from_numpy(V)).numpy(), F
