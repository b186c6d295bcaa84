"""A large displacement in 1, 2, 4, 8 and 16 parts, against the silhouette of the target [paper, appendix C]."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import implicit
from compare.cases.subject import Subject
from compare.paper.findings import Finding
from compare.paper.panels import panel, surface_view
from compare.paper.request import Request
from compare.reports.figures import same_frame
from compare.reports.views import Camera, View
from implicit import Edit, HalfSpace, Handle
from implicit.edits.targets import SummedTargets

PARTS = (1, 2, 4, 8, 16)
SHIFT = 0.3
CAMERA = Camera(0.0, 0.0)


def draw(request: Request) -> list[Finding]:
    """Push the upper half of the cactus aside, in more and more parts, and by as many as the edit chooses itself."""
    subject = request.subject("cactus")
    handle = Handle(HalfSpace((0.0, 0.6, 0.0), (0.0, 1.0, 0.0), falloff=1.0), (SHIFT, 0.0, 0.0))
    points = 1000 if request.quick else 4000
    counts: list[int | None] = [*PARTS] if request.quick else [*PARTS, None]
    edits = []
    for done, parts in enumerate(counts):
        request.tell(done, len(counts), f"splitting, {parts or 'chosen'} parts")
        edits.append(implicit.geometric_edit(subject.field, handle, steps=parts, points=points, seed=request.seed))
    dense = implicit.surface_quadrature(subject.field, 48, exact_points=True)
    rms = [_rms(edit, dense) for edit in edits]
    request.save(_picture(subject, handle, edits, rms), "splitting")
    what, unit = "cactus, the upper half 0.3 aside", "[of the largest wanted]"
    findings = [
        Finding("splitting", f"{what} in {_parts(k)}: rms of the error field {unit}", error, note=edit.status.value)
        for k, error, edit in zip(PARTS, rms, edits, strict=False)
    ]
    for error, edit in zip(rms[len(PARTS) :], edits[len(PARTS) :], strict=True):
        chosen = f"{what} in the {len(edit.history)} parts that the edit chose: rms of the error field {unit}"
        findings.append(Finding("splitting", chosen, error, note=edit.status.value))
    ratio = f"{what}: rms of the error field in 1 part over that in 16 parts [ratio]"
    return [*findings, Finding("splitting", ratio, rms[0] / rms[len(PARTS) - 1], headline=True)]


def _parts(count: int) -> str:
    return f"{count} part{'s' * (count > 1)}"


def _rms(edit: Edit, dense: implicit.SurfaceSample) -> float:
    error = edit.error_field(dense)
    lost = torch.isnan(error)
    # A point that finds no surface near its goal is as far off as the whole displacement.
    return float((dense.weights @ torch.where(lost, 1.0, error) ** 2 / dense.weights.sum()).sqrt())


def _picture(subject: Subject, handle: Handle, edits: list[Edit], rms: list[float]) -> Figure:
    figure = Figure(figsize=(1.7 * len(PARTS) + 2.4, 2.6), layout="constrained")
    grid = figure.subplots(1, len(PARTS) + 1, width_ratios=[1.0] * len(PARTS) + [1.35])
    points, normals = torch.from_numpy(subject.V), torch.from_numpy(subject.N)
    target = SummedTargets([handle], points, normals).positions(1.0)
    goal = View(target.numpy(), subject.F, np.zeros(len(target)))
    for axes, parts, edit, error in zip(grid, PARTS, edits, rms, strict=False):
        panel(axes, surface_view(edit.field), CAMERA, None, f"{_parts(parts)}: {100 * error:.2g} %")
        silhouette(axes, goal, CAMERA)
    same_frame(grid[:-1])
    curve = grid[-1]
    curve.loglog(PARTS, rms[: len(PARTS)], "o-", label="measured")
    curve.loglog(PARTS, [rms[0] / parts for parts in PARTS], "--", color="grey", label="first order")
    curve.set_xticks(PARTS, [str(parts) for parts in PARTS])
    curve.minorticks_off()
    curve.set_xlabel("parts", fontsize=7)
    curve.set_ylabel("rms of the error field", fontsize=7)
    curve.tick_params(labelsize=6)
    curve.legend(fontsize=6)
    return figure


def silhouette(axes: Axes, view: View, camera: Camera) -> None:
    """Draw the edges between faces that look at the viewer and faces that look away."""
    right, up, back = camera.axes()
    corners = view.V[view.F]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ back > 0
    ends = np.sort(np.stack([view.F, np.roll(view.F, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges, owner = np.unique(ends, axis=0, return_inverse=True)
    towards = np.bincount(owner.reshape(-1), np.repeat(facing, 3).astype(float), minlength=len(edges))
    for a, b in edges[towards == 1]:
        line = view.V[[a, b]]
        axes.plot(line @ right, line @ up, color="#c44e52", linewidth=0.8, solid_capstyle="round")
