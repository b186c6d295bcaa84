"""A rigid edit, or the mesh's least squares and ARAP, at three sizes of the mesh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from rows.table import best, row

import implicit
import meshref
from compare import Case, default_cases, prepare_subject
from compare.operations import edit_field, wanted_motion
from compare.rigidity import mesh_of, mesh_seconds, pulled_case, rigidity

VERTICES = (3_500, 35_000, 140_000)


def killing(shape: str = "spot", repeats: int = 3) -> None:
    """One linear rigid step at 2000 points, and the Killing least squares of meshes of the same surface.

    The mesh's seconds are those of assembly, factorisation and solve; ours start from given points. The energies are
    of both on a mesh of 4000 vertices, with springs at its handles as stiff as leaves them where the field's are.
    """
    subject = prepare_subject(Case(shape, "smooth"))
    case = pulled_case(shape, subject)
    implicit.rigid_edit(subject.field, [spec.build() for spec in case.handles], points=300)  # imports
    found = [rigidity(shape, subject) for _ in range(repeats)]
    ours = min(each.seconds for each in found)
    words = f"tangential energy {found[0].tangential:.3f} of the mesh's, spokes and rims "
    words += f"{found[0].spokes_and_rims:.3f}, handles missed by {100 * found[0].handle_error:.2g} % on both"
    for vertices in VERTICES:
        times = [mesh_seconds(case, subject, vertices) for _ in range(1 if vertices == VERTICES[-1] else repeats)]
        mesh = min(times, key=lambda timing: timing.seconds)
        name = f"rigid step: Killing least squares on {mesh.vertices:,} vertices ({mesh.solver})"
        row(name, mesh.seconds, ours, words, found[0].tangential <= 1.02)


def arap(shape: str = "spot", most: float = 1.05) -> None:
    """A whole pull, and ARAP on meshes of the same surface until it has converged.

    Both are judged by the ARAP energy of a mesh of 4000 vertices, over its least one there, that of ARAP itself.
    """
    subject = prepare_subject(Case(shape, "smooth"))
    (case,) = default_cases(shape, subject.V, subject.N, operations=("rigid",))
    wanted = wanted_motion(case, subject)
    edit_field(case, subject)  # imports
    ours = edit_field(case, subject)
    V, F = subject.V, subject.F
    handles = np.flatnonzero(wanted.at)
    least = meshref.arap(V, F, handles, (V + wanted.displacement)[handles]).energy
    energy = meshref.arap_energy(V, F, V + ours.displacement) / least
    missed = np.linalg.norm(ours.displacement - wanted.displacement, axis=1)[handles]
    error = float(np.sqrt(np.mean(missed**2))) / wanted.largest
    words = f"ARAP energy {energy:.3f} of the least, handles missed by {100 * error:.2g} %"
    for vertices in VERTICES:
        finer_V, finer_F = mesh_of(subject.field, vertices)
        normals = subject.field.normal(torch.from_numpy(finer_V)).numpy()
        goal = wanted_motion(case, replace(subject, V=finer_V, F=finer_F, N=normals))
        at = np.flatnonzero(goal.at)
        targets = (finer_V + goal.displacement)[at]
        ((theirs, result),) = best(lambda: meshref.arap(finer_V, finer_F, at, targets), repeats=1)  # noqa: B023
        name = f"rigid pull: ARAP on {len(finer_V):,} vertices ({result.iterations} iterations)"
        row(name, theirs, ours.seconds, words, energy <= most and error <= 0.02)
