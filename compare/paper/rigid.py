"""Rigid editing beside the mesh: handles, results, and where each is strained [paper, section 4.3].

The paper gives one energy for each side. The mesh notebook that its author published sums it over faces without their
areas, so it grows with the mesh; here it is one of three, of which the tangential one means the same on every mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy import ndarray

import meshref
from compare.cases.case import Case
from compare.cases.subject import Subject
from compare.operations.operation import Outcome, Target
from compare.operations.rigid import strain
from compare.paper.findings import Finding
from compare.paper.request import Request
from compare.paper.rigidity import mesh_seconds, pulled_case, rigidity
from compare.paper.scenes import PAPER, rigid_scene
from compare.reports.figures import HELD, MOVED, SURFACE, paint, same_frame
from compare.reports.views import Camera, View
from compare.runs.measure import measure
from compare.runs.operations import edit_by_all, target_motion

SIDES = {"implicit": "neural field", "mesh": "mesh, Killing", "mesh, ARAP": "mesh, ARAP"}
BESIDE = {  # with springs at their handles, as stiff as leaves these where the field's are
    "mesh, equal error": "mesh, Killing, at equal handle error",
    "mesh, ARAP, equal error": "mesh, ARAP, at equal handle error",
}
ENERGIES = {
    "killing_energy": "tangential energy, int |P(J+J')P|² [length², shape's units]",
    "killing_ambient": "ambient energy, int |J+J'|² [length², shape's units]",
    "killing_notebook": "unweighted energy, sum of |J+J'|² over the faces [pure number]",
    "killing_spokes_and_rims": "spokes and rims energy, with a rotation a vertex [length², shape's units]",
    "arap": "ARAP energy, spokes and rims with finite rotations [length², shape's units]",
}
MESHES = (3500, 35_000, 140_000)  # vertices for the timings of the mesh side
CAMERAS = {
    "spot": Camera(300.0),
    "cactus": Camera(40.0),
    "bracket": Camera(40.0),
    "bunny": Camera(40.0),
    "bar": Camera(40.0),
    "armadillo": Camera(150.0),
}
DENSITIES = "magma_r"
SLOWER = "about 10"  # times, the paper's neural step than its mesh solve; its bunny's mesh has 3500 vertices
PAPER_NOTE = "The paper names neither the form nor the mesh; this is the published notebook's, on our mesh."


@dataclass(frozen=True, eq=False)
class _Scene:
    """One rigid edit by the neural field and by the two mesh methods, their handles exact and at equal error."""

    name: str
    case: Case
    subject: Subject
    target: Target
    outcomes: Mapping[str, Outcome]

    def density(self, side: str) -> Float[ndarray, " n"]:
        """Tangential Killing energy per area at each vertex, a pure number."""
        return 4 * strain(self.subject, self.outcomes[side].displacement) ** 2

    def energies(self, side: str) -> dict[str, Any]:
        """Return all numbers of one side, in the user's units."""
        V, F, D = self.subject.V, self.subject.F, self.outcomes[side].displacement
        row = measure(self.case, self.subject, self.target, self.outcomes[side], strain(self.subject, D))
        return {**row, "arap": meshref.arap_energy(V, F, V + D) * self.subject.scale**2}


def draw(request: Request) -> list[Finding]:
    """Edit each shape in its ready-made scene, draw it, and measure one small step beside the mesh's."""
    files = ("bunny.off", "cactus.off", "bar.off", "armadillo.obj")
    shapes = request.shapes(*files, bundled=("spot", "cactus", "bracket"))
    shapes = shapes[1:2] if request.quick else shapes
    scenes, findings = [], []
    for done, shape in enumerate(shapes):
        request.tell(done, len(shapes), Path(shape).stem)
        subject = request.subject(shape)
        scene = _edited(shape, subject, request)
        scenes.append(scene)
        findings += _energies(scene) + _small_step(shape, subject, scene.name, request)
    request.save(_picture(scenes), "rigid")
    return findings


def _edited(shape: str, subject: Subject, request: Request) -> _Scene:
    case = rigid_scene(shape, subject, quick=request.quick, seed=request.seed)
    target = target_motion(case, subject)
    outcomes = edit_by_all(case, subject, target)
    path = Path(shape)
    name = f"{path.stem} ({path.name})" if path.suffix else path.stem
    return _Scene(name, case, subject, target, outcomes)


def _energies(scene: _Scene) -> list[Finding]:
    findings = []
    for side, words in {**SIDES, **BESIDE}.items():
        if side not in scene.outcomes:
            continue
        row = scene.energies(side)
        for key, energy in ENERGIES.items():
            paper, note = None, ""
            values = PAPER.get(Path(scene.case.shape).stem)
            if key == "killing_notebook" and values and side in ("implicit", "mesh"):
                paper, note = values[side != "implicit"], PAPER_NOTE
            what = f"{scene.name}, {words}: {energy}"
            headline = paper is not None and _is_the_papers(scene.case.shape)
            findings.append(Finding("rigid", what, row[key], paper, note, headline))
        missed = f"{scene.name}, {words}: rms distance of the handles from where they were sent [of the pull]"
        findings += [
            Finding("rigid", missed, row["handle_error_relative"], note=row["status"]),
            Finding("rigid", f"{scene.name}, {words}: time of the edit [s]", row["seconds"]),
        ]
    return findings


def _small_step(shape: str, subject: Subject, name: str, request: Request) -> list[Finding]:
    found = rigidity(shape, subject, points=400 if request.quick else 2000, seed=request.seed)
    equal = f"Handles missed by {found.handle_error:.2e} of the pull; on the mesh {found.mesh_handle_error:.2e}."
    what = f"{name}, one small step, neural over mesh Killing:"
    headline = _is_the_papers(shape)
    findings = [
        Finding("rigid", f"{what} tangential energy [ratio]", found.tangential, note=equal, headline=headline),
        Finding("rigid", f"{what} spokes and rims energy [ratio]", found.spokes_and_rims, note=equal),
    ]
    case = pulled_case(shape, subject)
    for vertices in MESHES[:1] if request.quick else MESHES:
        timing = mesh_seconds(case, subject, vertices)
        note = f"{found.seconds:.2f} s against {timing.seconds:.2f} s by {timing.solver}."
        words = f"{what} time, mesh of {timing.vertices:,} vertices [ratio]"
        paper = None
        if vertices == MESHES[0] and Path(shape).stem in PAPER:
            paper, note = SLOWER, f"{note} The paper names no machine; what its two solvers were decides this."
        findings.append(Finding("rigid", words, found.seconds / timing.seconds, paper, note, headline))
    return findings


def _is_the_papers(shape: str) -> bool:
    """Return whether the paper has numbers for the shape; the bundled cactus, no file, is another than its own."""
    return Path(shape).stem in PAPER and bool(Path(shape).suffix)


def _picture(scenes: list[_Scene]) -> Figure:
    figure = Figure(figsize=(8.2, 2.3 * len(scenes)), layout="constrained")
    grid = figure.subplots(len(scenes), 1 + len(SIDES), squeeze=False)
    for row, scene in zip(grid, scenes, strict=True):
        camera = CAMERAS.get(Path(scene.case.shape).stem, Camera(30.0))
        V, F = scene.subject.V, scene.subject.F
        palette = np.array([SURFACE, *(HELD if handle.holds else MOVED for handle in scene.case.handles)])
        colours = palette[scene.target.handle][F].mean(axis=1)
        paint(row[0], View(V, F, scene.target.handle.astype(float)), colours, camera)
        row[0].set_title(f"{scene.name}\nheld blue, moved orange", fontsize=7)
        limit = max(float(np.quantile(scene.density(side), 0.98)) for side in SIDES)
        for axes, (side, words) in zip(row[1:], SIDES.items(), strict=True):
            density = scene.density(side)
            view = View(V + scene.outcomes[side].displacement, F, density)
            colours = colormaps[DENSITIES](Normalize(0, limit)(density[F].mean(axis=1)))[:, :3]
            paint(axes, view, colours, camera)
            energy = scene.energies(side)["killing_energy"] / scene.subject.scale**2
            axes.set_title(f"{words}\nenergy {energy:.3g}", fontsize=7)
        same_frame(row)
    bar = figure.colorbar(ScalarMappable(Normalize(0, 1), DENSITIES), ax=grid, shrink=0.6, pad=0.01, extend="max")
    bar.set_label("Killing energy per area\n(1: the row's 98 % quantile)", fontsize=7)
    bar.ax.tick_params(labelsize=6)
    return figure
