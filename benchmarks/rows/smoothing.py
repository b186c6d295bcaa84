"""Smoothing with the volume kept: the mesh flow, or ours."""

from __future__ import annotations

from rows.table import best, row

import implicit
import meshref
from compare.paper.rigidity import mesh_of
from implicit import shapes


def smoothing(vertices: int = 35_000, steps: int = 30) -> None:
    """Steps of the bundled cow with the volume kept: the mesh flow on 35k vertices, and ours."""
    field = shapes.bundled("spot")
    V, F = mesh_of(field.to(dtype=field.theta.double().dtype), vertices)
    size = 1e-4 * meshref.area(V, F)
    holding = implicit.Holding(resolution=32, fine_resolution=128)

    def theirs() -> meshref.FlowResult:
        return meshref.mean_curvature_flow(
            V, F, steps=steps, step_size=size, method="semi-implicit", preserve_volume="newton"
        )

    def ours() -> implicit.Edit:
        return implicit.smooth(field, steps=steps, step_size=size, constraints=(implicit.Volume(),), holding=holding)

    implicit.smooth(field, steps=1)  # the first derivative of its kind makes torch import half of itself
    (theirs_s, flow), (ours_s, edit) = best(theirs, ours, repeats=1)
    after, before = (implicit.integrate(f, implicit.Volume(), 160).value for f in (edit.field, field))
    drift = abs(after / before - 1)
    round_theirs, round_ours = flow.history[-1].sphericity, edit.history[-1]["sphericity"]
    pieces = max(record["components"] for record in edit.history)
    words = f"volume drift {drift:.1e}, sphericity {round_theirs:.3f}, {round_ours:.3f}, most pieces {pieces}"
    good = drift < 1e-6 and round_ours >= round_theirs - 1e-3 and pieces == 1
    row(f"{steps} smoothing steps, volume kept: the mesh flow on {len(V):,} vertices", theirs_s, ours_s, words, good)
