"""Large rigid motions of fields beside converged ARAP on the mesh: distance, energy, pieces, seconds.

`python -m benchmarks.large_rigid SCENE...` prints rows of the table of docs/rigid.md; scenes of meshes that are not
bundled need --meshes, the folder that has them, and fit a network first.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.cases.handles import HandleSpec
from compare.cases.subject import Subject
from compare.paper.rigid_bends import BAR, STAGES, arap_way, turning_handles
from compare.runs.operations import target_motion
from compare.runs.subject import prepare_subject
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.filled import Filled
from implicit.step.local_global import STAGE_ITERATIONS, Hold, LocalGlobal
from implicit.step.spokes_and_rims import SpokesAndRims

CACHE = Path(gettempdir()) / "implicit-vs-mesh-large-rigid"  # of fits
WIDTH = 32  # of the networks, unless told
CELLS = 128  # at which the edited surface is extracted and its pieces are counted


@dataclass(frozen=True)
class Meshes:
    """Where meshes are that are not bundled, and how wide the networks are that are fitted to them and to bars."""

    folder: Path | None
    width: int


@dataclass(frozen=True, eq=False)
class Scene:
    """One large motion of a shape.

    Attributes:
        name: In words.
        case: Its handles.
        subject: The field and its common mesh.
        stages: Parts of ARAP's way.
        firmness: Of what fills the inside of the mesh where the volume is held; 0 leaves it out.
    """

    name: str
    case: Case
    subject: Subject
    stages: int
    firmness: float = 0.0

    def handles(self) -> list[implicit.Handle]:
        return [spec.build() for spec in self.case.handles]

    def arap(self) -> meshref.ArapResult:
        """Return converged ARAP on the common mesh."""
        held = np.flatnonzero(target_motion(self.case, self.subject).at)
        *way, goal = arap_way(self.subject, self.case, self.stages)
        return meshref.arap(self.subject.V, self.subject.F, held, goal, way=way)

    def with_volume(self) -> tuple[np.ndarray, float]:
        """Return the vertices of the common mesh at ARAP's least energy with its volume held, and the energy."""
        V, F = self.subject.V, self.subject.F
        held = target_motion(self.case, self.subject).at
        way = arap_way(self.subject, self.case, self.stages)
        shell = SpokesAndRims(V, F)
        energy = Filled.of(self.subject.field.to(torch.float64), shell, self.firmness) if self.firmness else shell
        start, inner = energy.vertices, len(energy.vertices) - len(V)

        def places(fraction: float) -> np.ndarray:
            goal = start.copy()
            goal[np.flatnonzero(held)] = way[max(round(fraction * self.stages), 1) - 1]
            return goal

        solver = LocalGlobal(
            energy, Hold(np.pad(held, (0, inner)), np.zeros(len(start))), EnclosedVolume(F, len(start))
        )
        found = solver.minimum(
            places,
            start,
            stages=self.stages,
            stage_iterations=60 if self.firmness else STAGE_ITERATIONS,
            tolerance=1e-6,
            iterations=2000,
            volume=solver.volume.value(start),
        )
        return found.positions[: len(V)], shell.energy(found.positions[: len(V)])

    def edit(self, **options: Any) -> tuple[implicit.Edit, float]:
        """Return the edit, with the common mesh tracked, and its processor seconds."""
        clock = time.process_time()
        found = implicit.rigid_edit(
            self.subject.field, self.handles(), track=torch.from_numpy(self.subject.V), **options
        )
        return found, time.process_time() - clock

    def row(self, edit: implicit.Edit, positions: np.ndarray, energy: float) -> dict[str, Any]:
        """Return how far an edit is from ARAP, over the longest side, its energy over ARAP's, and its pieces.

        Args:
            edit: With the common mesh tracked.
            positions, energy: ARAP's.
        """
        V, F = self.subject.V, self.subject.F
        box = float(np.ptp(V, axis=0).max())
        surface = implicit.extract_mesh(edit.field, CELLS)
        target = target_motion(self.case, self.subject)
        assert edit.tracked is not None
        moved = edit.tracked.double().cpu().numpy()
        missed = (moved - V - target.displacement)[target.at]
        parts = implicit.mesh_topology(*surface)
        return {
            "H": meshref.hausdorff(*surface, positions, F) / box,
            "rest": meshref.hausdorff(*implicit.extract_mesh(self.subject.field, CELLS), V, F) / box,
            "E": meshref.arap_energy(V, F, moved) / energy,
            "pieces": parts.components,
            "Euler": parts.euler,
            "handles": float(np.sqrt((missed**2).sum(axis=1).mean())) / box,
            "volume": meshref.volume(*surface) / meshref.volume(V, F) - 1,
        }


def bend(meshes: Meshes, degrees: float = 90.0) -> Scene:
    subject = prepare_subject(Case("cactus", "smooth"))
    case = Case("cactus", "rigid", turning_handles(subject, "bend", degrees))
    return Scene(f"cactus, {degrees:.3g} degrees", case, subject, STAGES)


def pull(meshes: Meshes) -> Scene:
    subject = prepare_subject(Case("spot", "smooth"))
    (case,) = default_cases("spot", subject.V, subject.N, operations=("rigid",))
    return Scene("spot, pull of 15 %", case, subject, 1)


def twist(meshes: Meshes, degrees: float = 135.0, sides: tuple[float, ...] = BAR) -> Scene:
    """A bar of softplus units, one end turned about its axis: sines do not turn their edges."""
    V, F = meshref.box(upper=sides, subdivisions=3)
    path = CACHE / f"bar-{sides[1] / sides[0]:.0f}.off"
    meshref.write_mesh(path, V, F)
    case = Case(str(path), "smooth", parameters={"fit": {"activation": "softplus", "width": meshes.width}})
    subject = prepare_subject(case, folder=CACHE)
    case = Case(str(path), "rigid", turning_handles(subject, "twist", degrees))
    words = f"bar, {degrees:.3g} degrees, width {meshes.width}"
    # The edit fills its inside where its points cross, with the volume held; so does the mesh beside it.
    return Scene(words, case, subject, max(STAGES, round(degrees / 20)), firmness=1.0)


def whole_turn(meshes: Meshes) -> Scene:
    """A bar ten times as long as wide, turned once about its axis; its mesh is filled, for alone it would unwind."""
    return twist(meshes, 360.0, (0.15, 1.5, 0.15))


def arm(meshes: Meshes) -> Scene:
    """The armadillo's right arm lowered by 60 degrees, all beyond its shoulder held."""
    turn = {"kind": "rigid", "center": [-0.2, 0.15, 0.0], "rotation": [0.0, 0.0, math.pi / 3]}
    held, moved = _half((-0.12, 0, 0), (1, 0, 0)), _half((-0.33, 0, 0), (-1, 0, 0))
    return _of_file("armadillo, arm, 60 degrees", meshes, "armadillo.obj", held, moved, turn)


def neck(meshes: Meshes) -> Scene:
    """The dinosaur's head turned aside by 60 degrees about the foot of its neck, its body held."""
    turn = {"kind": "rigid", "center": [-0.17, 0.0, -0.2], "rotation": [0.0, math.pi / 3, 0.0]}
    held, moved = _half((-0.05, 0, -0.05), (0.6, 0, 0.8)), _half((-0.25, 0, -0.3), (-0.6, 0, -0.8))
    return _of_file("dino, neck, 60 degrees", meshes, "dino.off", held, moved, turn)


def head(meshes: Meshes) -> Scene:
    """The knight's head turned by 45 degrees about his height, his feet held."""
    turn = {"kind": "rigid", "center": [0.5, 0.8, 0.5], "rotation": [0.0, math.pi / 4, 0.0]}
    held, moved = _half((0, 0.25, 0), (0, -1, 0)), _half((0, 0.8, 0), (0, 1, 0))
    return _of_file("knight, 45 degrees", meshes, "knight.off", held, moved, turn)


def _half(point: tuple[float, ...], normal: tuple[float, ...]) -> dict[str, Any]:
    return {"kind": "halfspace", "point": list(map(float, point)), "normal": list(map(float, normal))}


def _of_file(
    words: str, meshes: Meshes, name: str, held: dict[str, Any], moved: dict[str, Any], turn: dict[str, Any]
) -> Scene:
    """A scene of a mesh, its handles in the coordinates of the file."""
    if meshes.folder is None:
        raise SystemExit(f"{name} is not bundled: name its folder by --meshes.")
    path = str(meshes.folder / name)
    # The default's own settings stand for it, so that fits of before are found.
    parameters = {} if meshes.width == WIDTH else {"fit": {"width": meshes.width, "depth": 3, "activation": "sine"}}
    subject = prepare_subject(Case(path, "smooth", parameters=parameters), folder=CACHE)
    still = {"kind": "vector", "vector": [0.0, 0.0, 0.0]}
    units = subject.field.units
    handles = tuple(
        HandleSpec(region, motion).in_field(units.scale, units.offset)
        for region, motion in ((held, still), (moved, turn))
    )
    return Scene(f"{words}, width {meshes.width}", Case(path, "rigid", handles), subject, STAGES)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scenes", nargs="*", choices=[[], *SCENES], default=["pull", "bend"], metavar="SCENE")
    parser.add_argument("--meshes", type=Path, help="folder of armadillo.obj, dino.off and knight.off")
    parser.add_argument("--width", type=int, default=WIDTH, help="of the networks that are fitted first")
    parser.add_argument("--volume", action="store_true", help="hold the volume")
    parser.add_argument("--area", action="store_true", help="hold the area")
    parser.add_argument("--method", choices=["auto", "finite", "warp", "linear", "coupled"], default="auto")
    given = parser.parse_args()
    CACHE.mkdir(exist_ok=True)
    held = [make() for make, asked in ((implicit.Volume, given.volume), (implicit.Area, given.area)) if asked]
    print(
        "| scene | H, % | E | pieces, Euler | handles, rms % | volume, % | processor s |\n|---|---|---|---|---|---|---|"
    )
    for name in given.scenes:
        scene = SCENES[name](Meshes(given.meshes, given.width))
        edit, seconds = scene.edit(method=given.method, constraints=held)
        print(f"  {scene.name}: {seconds:.1f} processor s, {edit.status.name} {edit.notes}", flush=True)
        if given.volume:
            reference = scene.with_volume()
        else:
            arap = scene.arap()
            reference = arap.V, arap.energy
        row = scene.row(edit, *reference)
        print(
            f"| {scene.name} | {row['H']:.2%} ({row['rest']:.2%}) | {row['E']:.3f} | {row['pieces']}, {row['Euler']}: "
            f"{edit.status.name} | {row['handles']:.3%} | {row['volume']:.2%} | {seconds:.1f} |",
            flush=True,
        )
        steps = [
            {
                key: row.get(key)
                for key in (
                    "seconds_points",
                    "seconds_field",
                    "seconds",
                    "iterations",
                    "follow_steps",
                    "miss_rms",
                    "energy",
                    "strain_left",
                    "constraint_gap",
                )
            }
            for row in edit.history
        ]
        print("  ", steps, flush=True)


SCENES: dict[str, Callable[[Meshes], Scene]] = {
    scene.__name__: scene for scene in (pull, bend, twist, whole_turn, arm, neck, head)
}

if __name__ == "__main__":
    main()
