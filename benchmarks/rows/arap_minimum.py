"""How ARAP on a mesh comes to its minimum: libigl's iteration, or ours."""

from __future__ import annotations

from functools import partial

import numpy as np
from rows.table import best, row

import meshref
from compare import Case, Subject, default_cases, prepare_subject
from compare.paper.rigid_bends import STAGES, arap_way, turning_handles
from compare.runs.operations import target_motion


def arap_minimum(iterations: int = 2000) -> None:
    """A bend, a twist and a pull of meshes of 4000 vertices, by the same energy until no vertex moves by 1e-6.

    libigl's has so many iterations at most. Turns are led along their way in stages, the pull goes straight.
    """
    spot, cactus = (prepare_subject(Case(name, "smooth")) for name in ("spot", "cactus"))
    (pull,) = default_cases("spot", spot.V, spot.N, operations=("rigid",))
    bar = _bar(spot)
    scenes = [
        ("cactus bent by 90 degrees", cactus, Case("cactus", "rigid", turning_handles(cactus, "bend", 90.0)), STAGES),
        ("bar twisted by 135 degrees", bar, Case("spot", "rigid", turning_handles(bar, "twist", 135.0)), STAGES),
        ("spot pulled by 15 %", spot, pull, 1),
    ]
    for name, subject, case, stages in scenes:
        held = np.flatnonzero(target_motion(case, subject).at)
        *way, goal = arap_way(subject, case, stages)
        solve = partial(meshref.arap, subject.V, subject.F, held, goal, way=way, iterations=iterations)
        (theirs_s, theirs), (ours_s, ours) = best(partial(solve, minimiser="libigl"), solve, repeats=1)
        words = f"energy {theirs.energy:.6g} and {ours.energy:.6g}, iterations {theirs.iterations} and "
        words += f"{ours.iterations}, last move {theirs.residual:.1e} and {ours.residual:.1e} of the size"
        row(f"ARAP, {name}, {len(subject.V):,} vertices: libigl's iteration", theirs_s, ours_s, words, ours.converged)


def _bar(any_subject: Subject) -> Subject:
    """A bar five times as long as wide, a mesh alone: the field beside it is another's, and not used."""
    V, F = meshref.box(upper=(0.3, 1.5, 0.3), subdivisions=3)
    V, F = meshref.isotropic_remesh(V, F, (2 * meshref.area(V, F) / (3**0.5 * 4000)) ** 0.5)
    return Subject(any_subject.field, V, F, meshref.vertex_normals(V, F))
