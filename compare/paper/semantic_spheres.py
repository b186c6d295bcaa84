"""The same intents through DualSDF's own spheres and through boundary sensitivity [appendix A], on the same models.

A user of DualSDF grasps the spheres in the region and moves them; Adam moves the code until they are there. The effect
of both is measured on the fine shape: how far what was to move has moved, and what else of the family changed.
"""

from __future__ import annotations

import torch

import implicit
from compare.paper.family_edits import FamilyEdit, chair_leg, leg_ends, longer_wing, uneven_wings, wing_ends
from compare.paper.findings import Finding
from compare.paper.request import Request
from compare.paper.spheres import sphere_edit, spheres_near
from implicit import families
from implicit.models import DualSdf

PART = "semantic_spheres"
TOLERANCE = 0.05  # of what was asked, where each stops: of the surface, of the spheres


def draw(request: Request) -> list[Finding]:
    """Edit both ways; the code that comes out is all that differs."""
    findings: list[Finding] = []
    resolution = 48 if request.quick else 96
    chairs, airplanes = families.bundled("dualsdf-chairs"), families.bundled("dualsdf-airplanes")
    edits = (chair_leg(chairs), longer_wing(airplanes), uneven_wings(airplanes))
    for k, edit in enumerate(edits):
        request.tell(k, len(edits), edit.name)
        findings += _both_ways(edit, "leg_length" if edit.model is chairs else "wing_span", resolution)
    return findings


def _both_ways(edit: FamilyEdit, parameter: str, resolution: int) -> list[Finding]:
    ends = leg_ends if parameter == "leg_length" else wing_ends
    points, ways = edit.points()
    implicit.semantic_edit(edit.field, points, ways, steps=1)  # torch prepares its transforms at the first call
    ours = implicit.semantic_edit(edit.field, points, ways, tolerance=TOLERANCE)
    decoder = edit.model.decoder
    assert isinstance(decoder, DualSdf)
    code = edit.model.latents[edit.shape]
    chosen, sphere_ways = _grasped(decoder, code, points, ways)
    theirs = sphere_edit(decoder, code, chosen, sphere_ways, tolerance=TOLERANCE)
    findings = []
    start = ends(edit.model, edit.field, resolution)
    spheres = (
        "The spheres are where they were sent." if theirs.reached else "The spheres do not get where they were sent."
    )
    for name, field, steps, time, status in (
        ("by boundary sensitivity", ours.field, len(ours.history), ours.seconds, ours.status.value),
        ("by spheres", edit.field.with_theta(theirs.code), theirs.steps, theirs.seconds, spheres),
    ):
        label = f"{edit.name}, {name}"
        before, after = edit.parameters_before(), edit.parameters_after(field, resolution)
        asked = float(ways[0].norm())
        change = ends(edit.model, field, resolution) - start
        others = max((abs(after[n] - before[n]), n) for n in before if n != parameter)
        unit = "[of what was asked]"
        own = (after[parameter] - before[parameter]) / asked
        counterparts = f"{label}: mean motion of its counterparts, on the mesh {unit}"
        most = f"{label}: largest change of another parameter of the family {unit}"
        findings += [
            Finding(PART, f"{label}: steps [count]", steps, note=status),
            Finding(PART, f"{label}: time of the edit [s]", time),
            Finding(PART, f"{label}: motion of what was grasped, on the mesh {unit}", float(change[0]) / asked),
            Finding(PART, counterparts, float(change[1:].mean()) / asked),
            Finding(PART, f"{label}: change of {parameter} of the nearest member, over the way asked for [ratio]", own),
            Finding(PART, most, others[0] / asked, note=f"It is {others[1]}.", headline=parameter == "leg_length"),
        ]
    return findings


def _grasped(
    decoder: DualSdf, code: torch.Tensor, points: torch.Tensor, ways: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the spheres at the points, each to go where the points nearest to it go."""
    chosen = spheres_near(decoder, code, points)
    with torch.no_grad():
        centers = decoder.spheres(code)[1][chosen]
    nearest = torch.cdist(centers, points).argmin(dim=1)
    return chosen, ways[nearest]
