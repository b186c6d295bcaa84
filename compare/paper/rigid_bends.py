"""Large rigid motions: a bar twisted by 135 degrees and a cactus bent by 90, beside converged ARAP on the mesh.

The handles turn along their path; a bend sends the end to where an arc as long as the axis ends. The field goes by
finite rotations, its volume free or held. ARAP is led along the same path in stages and goes on at the goal until it
has converged. Linear steps forget what earlier ones have strained: the mesh's Killing least squares along the path,
which minimises in each step what the field's linear steps do, shows how far that ends from ARAP on the same mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from numpy import ndarray

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.handles import HandleSpec
from compare.cases.subject import Subject
from compare.operations.operation import Target
from compare.paper.findings import Finding
from compare.paper.panels import panel, surface_view
from compare.paper.request import Request
from compare.reports.figures import HELD, MOVED, SURFACE, paint, same_frame
from compare.reports.views import Camera, View
from compare.runs.operations import target_motion

TWIST, BEND = 135.0, 90.0  # degrees
STEPS = {"twist": 27, "bend": 18}  # of 5 degrees, of the mesh's Killing steps
STAGES = 7  # on ARAP's way: with more it ends at the same minimum
END = 0.12  # of the length, at each end, that handles hold
BAR = (0.3, 1.5, 0.3)  # sides of the bar that is fitted where no folder of meshes has one
# A bar of sines does not follow: what moves its edges is linear for a thousandth of such a step only.
BAR_ACTIVATION = "softplus"
CAMERA = Camera(35.0)


@dataclass(frozen=True, eq=False)
class _Bend:
    """One large motion by the field, with its volume free and held, and by the mesh."""

    what: str
    subject: Subject
    target: Target
    free: implicit.Edit
    held: implicit.Edit
    arap: meshref.ArapResult
    killing: Float[ndarray, "n 3"]  # the same by linear steps
    tracked: Float[ndarray, "n 3"]  # the mesh's vertices on the free field

    @property
    def box(self) -> float:
        """Longest side of the shape, before."""
        return float(np.ptp(self.subject.V, axis=0).max())

    def distance(self, edit: implicit.Edit) -> float:
        """Return the two-sided Hausdorff distance of the edited surface and the mesh's, over the box."""
        V, F = implicit.extract_mesh(edit.field, 128)
        return self.from_arap(V, F)

    def from_arap(self, V: Float[ndarray, "k 3"], F: Int[ndarray, "m 3"]) -> float:
        """Return the two-sided Hausdorff distance of any mesh and the mesh's, over the box."""
        return meshref.hausdorff(V, F, self.arap.V, self.subject.F) / self.box

    def volume_change(self, edit: implicit.Edit) -> float:
        """Return the relative change of the volume of the field itself."""
        before, after = (
            implicit.integrate(field, implicit.Volume(), 96).value for field in (self.subject.field, edit.field)
        )
        return after / before - 1


def draw(request: Request) -> list[Finding]:
    """Twist and bend, draw both results, and measure how far apart they are."""
    bends = []
    bar = request.subject(_bar(request), activation=BAR_ACTIVATION)
    for done, (what, shape, subject, angle) in enumerate(
        (("twist", "bar", bar, TWIST), ("bend", "cactus", request.subject("cactus"), BEND))
    ):
        request.tell(done, 2, what)
        bends.append(_bent(request, what, shape, subject, angle))
    request.save(_picture(bends), "rigid_bends")
    return [finding for bend in bends for finding in _findings(bend)]


def turning_handles(subject: Subject, what: str, degrees: float) -> tuple[HandleSpec, ...]:
    """Return one end of the longest axis held, the other turned about that axis, or bent so that it becomes an arc."""
    low, high = subject.V.min(axis=0), subject.V.max(axis=0)
    _, wide, along = np.argsort(high - low)
    axes, angle = np.eye(3), degrees * pi / 180
    margin = END * (high - low)[along] * axes[along]
    end = (low + high) / 2
    end[along] = (high - margin)[along]
    turn: dict[str, Any] = {"kind": "rigid", "center": end.tolist()}
    if what == "twist":
        turn |= {"rotation": (angle * axes[along]).tolist()}
    else:
        length = (1 - 2 * END) * (high - low)[along]  # of the axis between the handles, which the arc keeps
        aside = np.cross(axes[wide], axes[along])
        arrived = length / angle * (np.sin(angle) * axes[along] + (1 - np.cos(angle)) * aside)
        turn |= {
            "rotation": (angle * axes[wide]).tolist(),
            "translation": (arrived - length * axes[along]).tolist(),
        }
    still: dict[str, Any] = {"kind": "vector", "vector": [0.0, 0.0, 0.0]}
    return (
        HandleSpec({"kind": "halfspace", "point": (low + margin).tolist(), "normal": (-axes[along]).tolist()}, still),
        HandleSpec({"kind": "halfspace", "point": (high - margin).tolist(), "normal": axes[along].tolist()}, turn),
    )


def arap_along_the_path(subject: Subject, case: Case, stages: int) -> meshref.ArapResult:
    """ARAP at the goal, led there through as many parts of the handles' path."""
    held = np.flatnonzero(target_motion(case, subject).at)
    *way, goal = arap_way(subject, case, stages)
    return meshref.arap(subject.V, subject.F, held, goal, way=way)


def arap_way(subject: Subject, case: Case, stages: int) -> list[Float[ndarray, "h 3"]]:
    """Return the places of the vertices that handles hold after each part of their path, the goal last."""
    held = np.flatnonzero(target_motion(case, subject).at)
    return [_path(subject, case, stage / stages)[held] for stage in range(1, stages + 1)]


def killing_along_the_path(subject: Subject, case: Case, steps: int) -> Float[ndarray, "n 3"]:
    """Solve a Killing least squares for each part of the path, on the mesh as the last part left it."""
    held = np.flatnonzero(target_motion(case, subject).at)
    U = subject.V
    for step in range(1, steps + 1):
        way = _path(subject, case, step / steps)[held] - U[held]
        U = U + meshref.killing(U, subject.F, held, way).displacement
    return U


def _path(subject: Subject, case: Case, fraction: float) -> Float[ndarray, "n 3"]:
    """Return the vertices, those that handles hold where they are to be after the fraction of the way."""
    points, normals = torch.from_numpy(subject.V), torch.from_numpy(subject.N)
    goal = subject.V.copy()
    for spec in case.handles:
        handle = spec.build()
        inside = handle.weights(points).numpy() > 0.5
        goal[inside] = handle.position(fraction, points, normals).numpy()[inside]
    return goal


def _bent(request: Request, what: str, shape: str, subject: Subject, degrees: float) -> _Bend:
    steps = 2 if request.quick else STEPS[what]
    degrees = degrees / 6 if request.quick else degrees
    case = Case(shape, "rigid", turning_handles(subject, what, degrees), seed=request.seed)
    handles = [spec.build() for spec in case.handles]
    options: dict[str, Any] = {"method": "finite", "seed": request.seed}
    if request.quick:
        options["resolution"] = 24
    free = implicit.rigid_edit(subject.field, handles, track=torch.from_numpy(subject.V), **options)
    held = implicit.rigid_edit(subject.field, handles, constraints=(implicit.Volume(),), **options)
    words = f"{shape}, {what} by {degrees:.3g} degrees"
    arap, killing = arap_along_the_path(subject, case, STAGES), killing_along_the_path(subject, case, steps)
    assert free.tracked is not None
    tracked = free.tracked.double().cpu().numpy()
    return _Bend(words, subject, target_motion(case, subject), free, held, arap, killing, tracked)


def _bar(request: Request) -> str:
    found = request.shapes("bar.off")
    if found:
        return found[0]
    V, F = meshref.box(upper=BAR, subdivisions=3)
    request.folder.mkdir(parents=True, exist_ok=True)
    path = request.folder / "bar.off"
    meshref.write_mesh(path, V, F)
    return str(path)


def _findings(bend: _Bend) -> list[Finding]:
    V, F = bend.subject.V, bend.subject.F
    status = bend.free.status.value

    def grown(U: Float[ndarray, "n 3"]) -> float:
        return meshref.volume(U, F) / meshref.volume(V, F) - 1

    apart, change = "Hausdorff distance to the mesh's ARAP [of the longest side]", "change of volume [of that before]"
    arap = bend.arap
    rested = f"{arap.status.value} {arap.iterations} iterations; the last moved none by more than {arap.residual:.0e}."
    energy = meshref.arap_energy(V, F, bend.tracked) / arap.energy
    rows = [
        (f"neural: {apart}", bend.distance(bend.free), status),
        ("neural over mesh, ARAP: ARAP energy on the common mesh [ratio]", energy, ""),
        ("neural: time of the edit [s]", bend.free.seconds, ""),
        (f"neural, volume held: {apart}", bend.distance(bend.held), bend.held.status.value),
        (f"mesh, Killing steps: {apart}", bend.from_arap(bend.killing, F), ""),
        (f"neural: {change}", bend.volume_change(bend.free), ""),
        (f"neural, volume held: {change}", bend.volume_change(bend.held), ""),
        (f"mesh, ARAP: {change}", grown(arap.V), rested),
        (f"mesh, Killing steps: {change}", grown(bend.killing), ""),
    ]
    return [Finding("rigid_bends", f"{bend.what}; {what}", value, note=note) for what, value, note in rows]


def _picture(bends: list[_Bend]) -> Figure:
    figure = Figure(figsize=(7.2, 2.6 * len(bends)), layout="constrained")
    grid = figure.subplots(len(bends), 4, squeeze=False)
    palette = np.array([SURFACE, HELD, MOVED])
    for row, bend in zip(grid, bends, strict=True):
        V, F, handle = bend.subject.V, bend.subject.F, bend.target.handle
        colours = palette[handle][F].mean(axis=1)
        paint(row[0], View(V, F, np.zeros(len(V))), colours, CAMERA)
        row[0].set_title(bend.what.replace(" by", "\nby"), fontsize=7)
        panel(row[1], surface_view(bend.free.field), CAMERA, None, "neural field")
        panel(row[2], surface_view(bend.held.field), CAMERA, None, "neural field,\nvolume held")
        paint(row[3], View(bend.arap.V, F, np.zeros(len(V))), colours, CAMERA)
        row[3].set_title("mesh, ARAP", fontsize=7)
        same_frame(row)
    return figure
