"""Surfaces on which no handle is, such as the wall of a cavity: taken along with the body that they belong to.

A mesh editor moves what is connected to its handles. The rest of a body has no say in it, and no equation either: its
least energy is at any rigid motion. Here each of its vertices follows the motion of the edited surface near it, the
rigid motion that fits the nearest vertices best, weighted by closeness; a body moved rigidly takes its cavities along
exactly.

Source: the weighted rigid fit is that of Schaefer, McPhail and Warren, "Image deformation using moving least squares",
2006, in three dimensions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial import cKDTree

from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import Editor, Outcome, Target

NEAREST = 60  # vertices of the edited surface that each vertex of the rest follows
LEAST_HANDLES = 3  # vertices of a part, without which it can turn about a line


def carried(editor: Editor, case: Case, subject: Subject, target: Target, progress: Progress | None) -> Outcome | None:
    """Return what a mesh editor makes of the parts that handles hold, with the others taken along.

    Where every vertex has a target, or every part is held or none is, the editor sees the whole mesh.
    """
    import meshref

    part = meshref.components(subject.V, subject.F)
    held = np.bincount(part[target.at], minlength=part.max() + 1) >= LEAST_HANDLES
    if not case.handles or target.at.all() or held.all() or not held.any():
        return editor(case, subject, target, progress)
    edited = held[part]
    number = np.cumsum(edited) - 1
    alone = replace(subject, V=subject.V[edited], F=number[subject.F[edited[subject.F[:, 0]]]], N=subject.N[edited])
    own = Target(target.handle[edited], target.at[edited], target.displacement[edited])
    outcome = editor(case, alone, own, progress)
    if outcome is None:
        return None

    def whole(displacement: Float[ndarray, "k 3"]) -> Float[ndarray, "n 3"]:
        return followed(subject.V, edited, displacement)

    count = int(np.count_nonzero(~held))
    surfaces = "One surface on which no handle is follows" if count == 1 else f"{count} surfaces without handles follow"
    return replace(
        outcome,
        displacement=whole(outcome.displacement),
        path=[replace(at, displacement=whole(at.displacement)) for at in outcome.path],
        notes=[*outcome.notes, f"{surfaces} the motion of the edited surface nearest to it."],
    )


def followed(
    V: Float[ndarray, "n 3"], edited: Bool[ndarray, " n"], displacement: Float[ndarray, "k 3"]
) -> Float[ndarray, "n 3"]:
    """Return the displacement of all vertices, from that of those edited.

    Args:
        V: The vertices.
        edited: Which of them have a displacement.
        displacement: Of these.
    """
    own, rest = V[edited], V[~edited]
    count = min(NEAREST, len(own))
    distance, nearest = cKDTree(own).query(rest, k=count)
    distance, nearest = np.reshape(distance, (-1, count)), np.reshape(nearest, (-1, count))
    weight = 1 / np.maximum(distance / distance[:, :1].clip(1e-300), 1e-12) ** 4
    weight /= weight.sum(axis=1, keepdims=True)
    before, after = own[nearest], own[nearest] + displacement[nearest]
    middle = np.einsum("ij,ijx->ix", weight, before)
    moved = np.einsum("ij,ijx->ix", weight, after)
    U, _, W = np.linalg.svd(np.einsum("ij,ijx,ijy->ixy", weight, after - moved[:, None], before - middle[:, None]))
    U[:, :, 2] *= np.sign(np.linalg.det(U @ W))[:, None]  # a rotation, no reflection
    result = np.empty_like(V)
    result[edited] = displacement
    result[~edited] = np.einsum("ixy,iy->ix", U @ W, rest - middle) + moved - rest
    return result
