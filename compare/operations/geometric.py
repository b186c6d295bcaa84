"""Geometric editing: parts of the surface are moved along with their falloff, and the rest stays.

| neural field | mesh |
|---|---|
| implicit.geometric_edit, the rest fixed | each vertex moved to its target; meshref.biharmonic beside it |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import cKDTree

from compare.cases.case import Case
from compare.cases.handles import HandleSpec, rounded
from compare.cases.subject import Subject
from compare.errors import Progress
from compare.operations.operation import (
    Column,
    Editor,
    Headline,
    Operation,
    Outcome,
    Target,
    normal_part,
)

# A bump is on a flank if normals within so much of the longest side agree with its own, by the mean cosine; of other
# places, so many are looked at.
AS_WIDE_AS = 0.15
LEAST_AGREEMENT = 0.5
CANDIDATES = 400


class Geometric(Operation):
    """Every vertex has a target: its handles' displacements, weighted by their falloff."""

    name = "geometric"
    takes_handles = True
    sums_handles = True
    full: Mapping[str, Any] = {}
    quick: Mapping[str, Any] = {"implicit": {"parts": 4, "points": 500}}
    error_needs_other = False
    error_means = "motion along the normal minus the wanted one"
    error_over_target = True
    headline = Headline("error_relative", "error {} of the bump")
    columns = (
        Column(
            "error_relative",
            "normal",
            "the same of the motion along the normal alone, for geometric edits",
            percent=True,
            brief=False,
            label="normal error, relative",
        ),
    )

    def default_handles(self, V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"]) -> tuple[HandleSpec, ...]:
        """Return a smooth bump, 6 % of the longest side high, in the middle of a flank."""
        sides = V.max(axis=0) - V.min(axis=0)
        size, across = float(sides.max()), int(np.argmin(sides))
        center = rounded(V[_flank(V, N, across)])
        region = {"kind": "ball", "center": center, "radius": round(0.04 * size, 6), "falloff": round(0.24 * size, 6)}
        return (HandleSpec(region, {"kind": "along", "distance": round(0.06 * size, 6)}),)

    def option_sources(self) -> Mapping[str, tuple[Callable[..., Any], ...]]:
        """Return the neural editor; moving each vertex to its target takes no options."""
        import implicit

        return {"implicit": (implicit.geometric_edit,), "mesh": ()}

    def edit_field(self, case: Case, subject: Subject, progress: Progress | None = None) -> Outcome:
        """Edit the field by boundary sensitivity, with what no handle moves kept fixed."""
        import implicit
        from compare.operations.neural import run_edit

        handles = [spec.build() for spec in case.handles]
        method = "boundary sensitivity"
        return run_edit(implicit.geometric_edit, case, subject, method, progress, handles=handles, rest="fixed")

    def mesh_editors(self) -> Mapping[str, Editor]:
        """Return the targets themselves, and a biharmonic deformation that finds the falloff by itself."""
        return {"mesh": _move, "mesh, biharmonic": _biharmonic}

    def error_field(self, subject: Subject, target: Target, own: Outcome, other: Outcome) -> Float[ndarray, " n"]:
        """Return the motion along the normal beyond that to the target."""
        return normal_part(subject, own.displacement - target.displacement)


def _move(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome:
    return Outcome(target.displacement, "vertices moved as wanted", "Every vertex is moved as wanted.", True, 0.0)


def _biharmonic(case: Case, subject: Subject, target: Target, progress: Progress | None = None) -> Outcome | None:
    """Leave the falloff to a biharmonic deformation.

    Vertices in the core of a region, at a weight of 1, are moved and those outside all regions held; those between
    follow smoothly. None where every vertex is one or the other.
    """
    import torch

    import meshref

    points = torch.from_numpy(subject.V)
    weights = np.max([spec.build().weights(points).numpy() for spec in case.handles], axis=0)
    held = np.flatnonzero((weights == 0) | (weights > 1 - 1e-9))
    if len(held) in (0, len(weights)) or not (weights > 1 - 1e-9).any():
        return None
    start = perf_counter()
    result = meshref.biharmonic(subject.V, subject.F, held, target.displacement[held])
    seconds, done = perf_counter() - start, result.status is meshref.BiharmonicStatus.SOLVED
    return Outcome(
        result.displacement, "biharmonic", result.status.value, done, seconds, seconds_by_phase={"solve": seconds}
    )


def _flank(V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"], across: int) -> int:
    """Return the vertex nearest the middle of the side that faces along the thinnest axis, or of another flat side.

    Where only a corner faces that way, as of a tetrahedron, a bump there would be a spike.
    """
    facing = np.flatnonzero(N[:, across] > 0.8)
    if facing.size == 0:  # no part of the surface faces that way, e.g. a coarse mesh of a knife's edge
        found = int(np.argmax(V[:, across]))
    else:
        offset = V[facing] - V.mean(axis=0)
        offset[:, across] *= 0.1  # the middle as seen from that side; between sheets, the outer one is not favoured
        found = int(facing[np.argmin((offset**2).sum(axis=1))])
    candidates = np.linspace(0, len(V) - 1, min(len(V), CANDIDATES)).astype(np.int64)
    near = cKDTree(V).query_ball_point(V[[found, *candidates]], AS_WIDE_AS * float(np.ptp(V, axis=0).max()))
    cosines = [N[round_it] @ N[k] for k, round_it in zip([found, *candidates], near)]
    agreement = np.array([cosine[cosine > -0.8].mean() for cosine in cosines])  # the back of a plate is no corner
    if agreement[0] >= LEAST_AGREEMENT or agreement[1:].max() < LEAST_AGREEMENT:
        return found
    flat = candidates[agreement[1:] >= agreement[1:].max() - 0.02]
    return int(flat[np.argmin(((V[flat] - V.mean(axis=0)) ** 2).sum(axis=1))])
