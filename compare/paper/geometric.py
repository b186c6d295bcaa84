"""Geometric editing of man-made and organic shapes, with the error field below each [paper, section 4.1].

Natural displacements, a bump and a stretch of a tenth of the shape on a quarter of its surface; and letters, which
no field of this size can express and which `expressibility` refuses beforehand. The mesh's biharmonic deformation has
the same handles: it says how far the target itself is from the smoothest surface with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray

import implicit
import meshref
from compare.cases.subject import Subject
from compare.paper.findings import Finding
from compare.paper.letters import Letters
from compare.paper.panels import colour_bar, panel, surface_view
from compare.paper.request import Request
from compare.reports.views import Camera
from implicit import Along, Ball, Edit, HalfSpace, Handle, Region, SurfaceSample
from implicit.edits.targets import SummedTargets

# Middles of the bumps in the field's coordinates, where the surface, moved out by a tenth of the shape along its
# normals on a quarter of its area, does not fold over: most places of thin or hollow shapes would.
BUMPS = {
    "spot": (-0.3, -0.08, 0.25),
    "cactus": (0.15, -0.61, 0.14),
    "bracket": (-0.2, -0.7, -0.1),
    "bunny": (0.34, 0.19, 0.07),
    "rocker-arm": (0.05, 0.41, 0.15),
}
CAMERAS = {
    "spot": Camera(300.0),
    "cactus": Camera(45.0),
    "bracket": Camera(90.0, -60.0),  # its under side
    "bunny": Camera(60.0),
    "rocker-arm": Camera(20.0),
}
HEIGHT = 0.1  # of the longest side, of bump and stretch
SHARE = 0.25  # of the area that moves
PARTS = 16
LETTERS = "bracket"


@dataclass(frozen=True, eq=False)
class _Task:
    """One displacement on one shape, edited and measured."""

    name: str
    kind: str
    subject: Subject
    handle: Handle
    edit: Edit
    predicted: implicit.Expressibility
    dense: SurfaceSample  # of the unedited surface, other points than those that carried the target
    error: Float[ndarray, " n"]  # the error field there
    biharmonic: float | None  # rms of the mesh's error field, over the largest target
    seconds: float

    def rms(self, which: ndarray | None = None) -> float:
        keep = np.isfinite(self.error) if which is None else which & np.isfinite(self.error)
        weights = self.dense.weights.numpy()[keep]
        return float(np.sqrt(np.average(self.error[keep] ** 2, weights=weights)))

    def rest(self) -> float:
        """Return the motion of what was to stay, over the largest displacement."""
        return self.rms(self.handle.weights(self.dense.points).numpy() == 0)


def draw(request: Request) -> list[Finding]:
    """Edit each shape, and draw what became of it and where it misses its target."""
    shapes = request.shapes("bunny.off", "rocker-arm.obj", bundled=("spot", "cactus", "bracket"))
    shapes = shapes[:1] if request.quick else shapes
    tasks: list[_Task] = []
    for shape in shapes:
        subject = request.subject(shape, vertices=4000)
        name = Path(shape).stem
        for kind in ("bump", "stretch"):
            request.tell(len(tasks), 2 * len(shapes) + 1, f"{name}, {kind}")
            tasks.append(_task(request, name, kind, subject, natural(subject.field, name, kind)))
    subject = request.subject(LETTERS, vertices=4000)
    tasks.append(_task(request, LETTERS, "letters", subject, letters()))
    shown = [task for task in tasks if task.kind != "stretch"]
    request.save(_picture(shown), "geometric")
    return [finding for task in tasks for finding in _findings(task)]


def natural(field: implicit.Field, name: str, kind: str) -> Handle:
    """Return a bump or a stretch of a tenth of the shape, sinking smoothly to nothing over a quarter of its surface."""
    sample = implicit.surface_quadrature(field, 48)
    low, high = sample.points.amin(dim=0), sample.points.amax(dim=0)
    axis = int((high - low).argmax())
    height = HEIGHT * float((high - low).max())
    if kind == "bump":
        center = BUMPS[name]
        return Handle(_quarter(sample, lambda r: Ball(center, 0.1 * r, falloff=0.9 * r)), Along(height))
    direction = torch.zeros(3, dtype=torch.float64)
    direction[axis] = 1.0
    end, along = high.tolist(), direction.tolist()

    def tip(length: float) -> Region:
        point = [x - 0.2 * length * a for x, a in zip(end, along, strict=True)]
        return HalfSpace(point, along, falloff=0.8 * length)

    return Handle(_quarter(sample, tip), (height * direction).tolist())


def letters() -> Handle:
    """Three letters pressed a fortieth of the shape deep into the under side of the bracket."""
    region = Letters("SDF", (-0.2, -0.7, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), height=0.3, depth=0.1)
    return Handle(region, Along(-0.04))


def _quarter(sample: SurfaceSample, region_of) -> Region:  # type: ignore[no-untyped-def]  # length -> Region
    """Return the region of the length at which it holds a quarter of the area."""
    low, high = 0.05, 4.0
    for _ in range(40):
        middle = (low + high) / 2
        inside = float(sample.weights[region_of(middle)(sample.points) > 0].sum() / sample.weights.sum())
        low, high = (middle, high) if inside < SHARE else (low, middle)
    return region_of(middle)


def _task(request: Request, name: str, kind: str, subject: Subject, handle: Handle) -> _Task:
    field = subject.field
    parts, points = (4, 1500) if request.quick else (PARTS, 4000)
    predicted = implicit.expressibility(field, handle, steps=parts, points=points, seed=request.seed)
    start = perf_counter()
    edit = implicit.geometric_edit(field, handle, steps=parts, points=points, seed=request.seed)
    seconds = perf_counter() - start
    # Letters have edges that a coarse quadrature would hit or miss.
    dense = implicit.surface_quadrature(field, 96 if kind == "letters" else 48, exact_points=True)
    error = edit.error_field(dense).numpy()
    return _Task(name, kind, subject, handle, edit, predicted, dense, error, _biharmonic(subject, handle), seconds)


def _biharmonic(subject: Subject, handle: Handle) -> float | None:
    """The error field of a biharmonic mesh deformation with the core of the handle moved and the rest held."""
    points, normals = torch.from_numpy(subject.V), torch.from_numpy(subject.N)
    targets = SummedTargets([handle], points, normals)
    weights, target = targets.handle_weights[0].numpy(), targets.displacement().numpy()
    held = np.flatnonzero((weights == 0) | (weights > 1 - 1e-9))
    if len(held) == len(weights) or not (weights > 1 - 1e-9).any():
        return None  # letters have no falloff to be smooth over
    result = meshref.biharmonic(subject.V, subject.F, held, target[held])
    along = ((result.displacement - target) * subject.N).sum(axis=1) / np.abs((target * subject.N).sum(axis=1)).max()
    return float(np.sqrt(np.average(along**2, weights=meshref.vertex_areas(subject.V, subject.F))))


def _picture(tasks: list[_Task]) -> Figure:
    figure = Figure(figsize=(1.9 * len(tasks) + 0.5, 5.6), layout="constrained")
    grid = figure.subplots(3, len(tasks), squeeze=False)
    for column, task in enumerate(tasks):
        camera = CAMERAS[task.name]
        field = task.subject.field
        fine = 160 if task.kind == "letters" else 96
        start = surface_view(field, partial(_target, task), fine)
        after = surface_view(task.edit.field, resolution=fine)
        error = surface_view(field, partial(_error, task), fine)
        panel(grid[0, column], start, camera, 1.0, f"{task.name}: target")
        panel(grid[1, column], after, camera, None, "edited")
        panel(grid[2, column], error, camera, 0.1, f"error: rms {100 * task.rms():.2g} %")
        for axes in grid[:, column]:
            axes.set_xlim(*grid[1, column].get_xlim())
            axes.set_ylim(*grid[1, column].get_ylim())
    colour_bar(figure, [*grid[0], *grid[1]], 1.0, "target / largest")
    colour_bar(figure, list(grid[2]), 0.1, "(achieved - target) / largest", beyond=True)
    return figure


def _target(task: _Task, V: ndarray) -> ndarray:
    points = torch.from_numpy(V)
    normals = task.subject.field.normal(points)
    displacement = SummedTargets([task.handle], points, normals).displacement()
    normal = (displacement * normals).sum(dim=1).numpy()
    return np.asarray(normal / max(np.abs(normal).max(), 1e-300))


def _error(task: _Task, V: ndarray) -> ndarray:
    points = torch.from_numpy(V)
    sample = SurfaceSample(points, task.subject.field.normal(points), torch.ones_like(points[:, 0]))
    return np.asarray(task.edit.error_field(sample).numpy())


def _findings(task: _Task) -> list[Finding]:
    part, what = "geometric", f"{task.name}, {task.kind}"
    edit, before = task.edit, task.edit.before
    sound = "" if before is None else f"The 1st percentile of the slope went from {before.slope_low:.2f}"
    if before is not None and edit.after is not None:
        sound = f"{sound} to {edit.after.slope_low:.2f}, the pieces from {before.pieces} to {edit.after.pieces}."
    ended = " ".join([edit.status.value, sound, *edit.notes])
    error, unit = "error field, achieved minus wanted normal motion", "[of the largest wanted]"
    headline = task.kind == "bump" and task.name in ("spot", "bunny", "rocker-arm")
    found = [
        Finding(part, f"{what}: {error}, rms over the surface {unit}", task.rms(), note=ended, headline=headline),
        Finding(part, f"{what}: {error}, largest size {unit}", float(np.nanmax(np.abs(task.error)))),
        Finding(part, f"{what}: motion of what is to stay, rms {unit}", task.rest()),
        Finding(
            part, f"{what}: rms predicted before the edit {unit}", task.predicted.rms, note=task.predicted.sentence()
        ),
        Finding(part, f"{what}: time of the edit [s]", task.seconds),
    ]
    if task.biharmonic is not None:
        note = "Moved along its normals the mesh has none; left to be smooth between the handles it differs by this."
        what = f"{what}: {error}, rms of the biharmonic mesh {unit}"
        found.append(Finding(part, what, task.biharmonic, note=note))
    return found
