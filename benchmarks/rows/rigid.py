"""A rigid edit, or the mesh's least squares and ARAP, at three sizes of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import torch
from rows.table import best, row

import implicit
import meshref
from compare import Case, Subject, default_cases, prepare_subject
from compare.operations.operation import Outcome, Target, operation_of
from compare.paper.rigidity import POINTS, mesh_of, pulled_case, rigidity
from compare.runs.operations import target_motion

VERTICES = (3_500, 35_000, 140_000)
ARAP_VERTICES = VERTICES[:2]  # a minute of the largest tells nothing that these do not


def killing(shape: str = "spot", repeats: int = 3, sizes: Sequence[int] = VERTICES) -> None:
    """One linear rigid step at 2000 points, and the Killing least squares of meshes of the same surface.

    Both start from what they solve on, a mesh or points. The energies are of both on a mesh of 4000 vertices, with
    springs at its handles as stiff as leaves them where the field's are.
    """
    subject = prepare_subject(Case(shape, "smooth"))
    case = pulled_case(shape, subject)
    found = rigidity(shape, subject)
    words = f"tangential energy {found.tangential:.3f} of the mesh's, spokes and rims {found.spokes_and_rims:.3f}, "
    words += f"handles missed by {100 * found.handle_error:.2g} % on both"
    handles = [spec.build() for spec in case.handles]
    sample = implicit.sample_surface(subject.field, POINTS, "farthest")
    ((ours_s, _),) = best(
        lambda: implicit.rigid_edit(subject.field, handles, method="linear", points=sample), repeats=repeats
    )
    for vertices in sizes:
        V, F, at, wanted = wanted_on_mesh(case, subject, vertices)
        largest = vertices == VERTICES[-1]
        ((theirs_s, result),) = best(partial(meshref.killing, V, F, at, wanted), repeats=1 if largest else repeats)
        name = f"rigid step: Killing least squares on {len(V):,} vertices ({result.solver})"
        row(name, theirs_s, ours_s, words, found.tangential <= 1.02)


def arap(shape: str = "spot", sizes: Sequence[int] = ARAP_VERTICES) -> None:
    """A whole pull, and ARAP on meshes of the same surface with its default options.

    Both are judged by the tangential Killing energy on a mesh of 4000 vertices. Ours does not minimise the ARAP energy,
    and comes out higher in it; the row says by how much.
    """
    case, subject, wanted, ours_s, ours = our_pull(shape)
    V, F = subject.V, subject.F
    handles = np.flatnonzero(wanted.at)
    by_mesh = meshref.arap(V, F, handles, (V + wanted.displacement)[handles])
    killing_ratio = meshref.killing_energy(V, F, ours.displacement) / meshref.killing_energy(V, F, by_mesh.V - V)
    arap_ratio = meshref.arap_energy(V, F, V + ours.displacement) / by_mesh.energy
    missed = np.linalg.norm(ours.displacement - wanted.displacement, axis=1)[handles]
    error = float(np.sqrt(np.mean(missed**2))) / wanted.largest
    words = f"tangential energy {killing_ratio:.3f} of ARAP's, ARAP energy {arap_ratio:.3f} of its, "
    words += f"handles missed by {100 * error:.2g} %"
    for vertices in sizes:
        V, F, at, motion = wanted_on_mesh(case, subject, vertices)
        ((theirs_s, result),) = best(partial(meshref.arap, V, F, at, V[at] + motion), repeats=1)
        name = f"rigid pull: ARAP on {len(V):,} vertices ({result.iterations} iterations)"
        row(name, theirs_s, ours_s, words, killing_ratio <= 1 and error <= 0.02)


@cache
def our_pull(shape: str) -> tuple[Case, Subject, Target, float, Outcome]:
    """The rigid edit of `default_cases` on a field: what it is, what it wants, its seconds, and what it gives."""
    subject = prepare_subject(Case(shape, "smooth"))
    (case,) = default_cases(shape, subject.V, subject.N, operations=("rigid",))
    edit_field = operation_of(case.operation).edit_field
    edit_field(case, subject)  # imports
    ((seconds, ours),) = best(lambda: edit_field(case, subject), repeats=1)
    return case, subject, target_motion(case, subject), seconds, ours


def wanted_on_mesh(
    case: Case, subject: Subject, vertices: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A mesh of the subject's surface, its handles' vertices, and how these are to move."""
    V, F = mesh_of(subject.field, vertices)
    normals = subject.field.normal(torch.from_numpy(V)).numpy()
    wanted = target_motion(case, replace(subject, V=V, F=F, N=normals))
    at = np.flatnonzero(wanted.at)
    return V, F, at, wanted.displacement[at]
