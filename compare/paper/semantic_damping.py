"""Damping trades steps against the rest of the shape [appendix B]: the same edits with lambda 10, 0.1 and 0.001."""

from __future__ import annotations

import torch

import implicit
from compare.paper.family_edits import chair_leg, longer_wing
from compare.paper.findings import Finding
from compare.paper.request import Request
from implicit import families

PART = "semantic_damping"
DAMPINGS = (10.0, 0.1, 0.001)
STEPS_OF_THE_PAPER: dict[float, float | str] = {10.0: 860, 0.1: "under 10", 0.001: "under 10"}
NETWORKS = "The paper's networks are those published, of 128 and 256 numbers a code; ours are small, of 16."


def draw(request: Request) -> list[Finding]:
    """Return the steps until a twentieth of the target is left, and how far what was not prescribed has moved by then.

    The more cautious an edit is, the less of the tolerance it leaves unused; so the motion is given per unit reached.
    """
    findings = []
    edits = [("chair", chair_leg(families.bundled("deepsdf-chairs")))]
    if not request.quick:
        edits.append(("airplane", longer_wing(families.bundled("deepsdf-airplanes"))))
    most = 100 if request.quick else 3000
    for k, (name, edit) in enumerate(edits):
        points, ways = edit.points()
        rest = edit.free_points(500)
        for damping in DAMPINGS:
            request.tell(k, len(edits), f"damping {damping:g}")
            result = implicit.semantic_edit(
                edit.field, points, ways, steps=most, damping=damping, tolerance=0.05, track=rest
            )
            assert result.tracked is not None
            moved = (result.tracked - rest).norm(dim=1).square().mean().sqrt()
            reached = 1 - float(result.error_field()[torch.isfinite(result.wanted).all(dim=1)].square().mean().sqrt())
            code = float((result.field.theta - edit.field.theta).norm())
            steps = len(result.history)
            label = f"{name}, {edit.name}, damping {damping:g}"
            paper = STEPS_OF_THE_PAPER[damping] if name == "chair" else None
            note = f"{result.status.value} {NETWORKS}" if paper else result.status.value
            rest_moved = f"{label}: motion of all that was not prescribed, rms [of what was reached]"
            findings += [
                Finding(PART, f"{label}: steps until a twentieth is missed [count]", steps, paper, note, bool(paper)),
                Finding(PART, rest_moved, float(moved) / float(ways[0].norm()) / reached),
                Finding(PART, f"{label}: norm of the change of the code [units of the code]", code),
                Finding(PART, f"{label}: time of the edit [s]", result.seconds),
            ]
    return findings
