"""Semantic editing [section 4.2]: regions and vectors above, what the models make below.

The last column asks for what no member of the family is, a longer wing on one side and a shorter one on the other: it
is not reached, and the status says so.
"""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import implicit
from compare.paper.family_edits import FamilyEdit, chair_leg, leg_ends, longer_wing, uneven_wings, wing_ends
from compare.paper.findings import Finding
from compare.paper.request import Request
from compare.reports.figures import MOVED, SURFACE, paint
from compare.reports.views import Camera, View
from implicit import families

PART = "semantic"
MODELS = ("deepsdf", "dualsdf", "imnet")
POINTS = 100


def draw(request: Request) -> list[Finding]:
    """Edit the bundled models, draw four of the edits, and say what became of the families' parameters."""
    resolution = 64 if request.quick else 128
    findings: list[Finding] = []
    for name in MODELS:
        findings += _leg(name, chair_leg(families.bundled(f"{name}-chairs")), resolution)
    for name in MODELS[:2]:
        findings += _wings(name, families.bundled(f"{name}-airplanes"), resolution)
    chairs, airplanes = families.bundled("dualsdf-chairs"), families.bundled("dualsdf-airplanes")
    columns = [
        (chair_leg(chairs), Camera(35.0, 15.0)),
        (chair_leg(chairs, amount=-0.12), Camera(35.0, 15.0)),
        (longer_wing(airplanes), Camera(25.0, 50.0)),
        (uneven_wings(airplanes), Camera(25.0, 50.0)),
    ]
    request.save(_picture(columns, resolution), PART)
    return findings


def _leg(name: str, edit: FamilyEdit, resolution: int) -> list[Finding]:
    points, ways = edit.points(POINTS)
    result = implicit.semantic_edit(edit.field, points, ways)
    change = leg_ends(edit.model, result.field, resolution) - leg_ends(edit.model, edit.field, resolution)
    wanted = float(ways[0].norm()) / edit.model.scale
    others = float(np.abs(change[1:] / change[0] - 1).max())
    before, after = edit.parameters_before(), edit.parameters_after(result.field, min(resolution, 96))
    shorter = before["leg_length"] - after["leg_length"]
    label, asked, steps = f"{name}, {edit.name}", "[of what was asked]", len(result.history)
    return [
        Finding(PART, f"{label}: points prescribed, at most [count]", POINTS, "about 100"),
        Finding(PART, f"{label}: steps [count]", steps, "under 15", result.status.value, name != "deepsdf"),
        Finding(PART, f"{label}: rise of its foot, on the mesh {asked}", float(change[0]) / wanted),
        Finding(PART, f"{label}: largest difference of the other three's rise from its own [of its own]", others),
        Finding(
            PART,
            f"{label}: change of the family's leg length, of the nearest member {asked}",
            shorter / wanted,
            note=_moved_otherwise(before, after, "leg_length"),
        ),
    ]


def _wings(name: str, model: families.FamilyModel, resolution: int) -> list[Finding]:
    findings = []
    for edit in (longer_wing(model), uneven_wings(model)):
        points, ways = edit.points(POINTS)
        result = implicit.semantic_edit(edit.field, points, ways)
        change = wing_ends(model, result.field, resolution) - wing_ends(model, edit.field, resolution)
        error = result.error_field()
        missed = float(error[torch.isfinite(error)].square().mean().sqrt())
        wanted = float(ways[0].norm()) / model.scale
        label, asked = f"{name}, {edit.name}", "[of what was asked]"
        headline = name == "dualsdf" and edit.name == "one wing longer"
        paper = "under 15" if edit.name == "one wing longer" else None
        findings += [
            Finding(PART, f"{label}: steps [count]", len(result.history), paper, result.status.value, headline),
            Finding(PART, f"{label}: rms of what is missed {asked}", missed),
            Finding(PART, f"{label}: growth of the wing at +x, on the mesh {asked}", float(change[0]) / wanted),
            Finding(PART, f"{label}: growth of the other wing, on the mesh {asked}", float(change[1]) / wanted),
        ]
        if edit.name == "one wing longer":
            before, after = edit.parameters_before(), edit.parameters_after(result.field, min(resolution, 96))
            longer = (after["wing_span"] - before["wing_span"]) / 2
            what = f"{label}: half the change of the family's span, of the nearest member {asked}"
            note = _moved_otherwise(before, after, "wing_span")
            findings.append(Finding(PART, what, longer / wanted, note=note))
    return findings


def _moved_otherwise(before: dict[str, float], after: dict[str, float], but: str) -> str:
    changes = {name: after[name] - before[name] for name in before if name != but}
    name = max(changes, key=lambda name: abs(changes[name]))
    return f"Of the other parameters {name} changed most, by {changes[name]:+.3f}."


def _picture(columns: list[tuple[FamilyEdit, Camera]], resolution: int) -> Figure:
    figure = Figure(figsize=(2.6 * len(columns), 5.2), layout="constrained")
    grid = figure.subplots(2, len(columns))
    for (edit, camera), above, below in zip(columns, grid[0], grid[1], strict=True):
        points, ways = edit.points(POINTS)
        result = implicit.semantic_edit(edit.field, points, ways)
        V, F = implicit.extract_mesh(edit.field, resolution)
        weights = [handle.weights(torch.from_numpy(V).to(edit.field.theta)) for handle in edit.handles]
        coloured = (torch.stack(weights).amax(dim=0) > 0)[torch.from_numpy(F)].all(dim=1).numpy()
        paint(above, View(V, F, np.zeros(len(V))), np.where(coloured[:, None], MOVED, SURFACE), camera)
        _draw_vectors(above, edit, V, camera)
        W, G = implicit.extract_mesh(result.field, resolution)
        paint(below, View(W, G, np.zeros(len(W))), np.tile(SURFACE, (len(G), 1)), camera)
        above.set_title(edit.name, fontsize=8)
        below.set_title(f"{result.status.name.lower().replace('_', ' ')}, {len(result.history)} steps", fontsize=8)
        low = np.minimum(above.get_xlim()[0], below.get_xlim()[0]), np.minimum(above.get_ylim()[0], below.get_ylim()[0])
        high = (
            np.maximum(above.get_xlim()[1], below.get_xlim()[1]),
            np.maximum(above.get_ylim()[1], below.get_ylim()[1]),
        )
        for axes in (above, below):
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], high[1])
    return figure


def _draw_vectors(axes: Axes, edit: FamilyEdit, V: np.ndarray, camera: Camera) -> None:
    """Draw an arrow from the middle of each region, twice as long as the way so that it can be seen."""
    right, up, _ = camera.axes()
    for handle in edit.handles:
        inside = handle.weights(torch.from_numpy(V).to(edit.field.theta)).numpy() > 0
        start = V[inside].mean(axis=0)
        way = (
            handle.position(1.0, torch.from_numpy(start[None]), torch.zeros(1, 3, dtype=torch.float64)).numpy()[0]
            - start
        )
        end = start + 2 * way
        axes.update_datalim([end @ np.stack([right, up], axis=1)])
        axes.autoscale_view()
        axes.annotate(
            "",
            (end @ right, end @ up),
            (start @ right, start @ up),
            arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.2},
        )
