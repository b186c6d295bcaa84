"""Rigid steps of bundled fields: seconds, memory, and the strain beside the mesh's least squares.

`python -m benchmarks.rigid` prints the tables of docs/rigid.md.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch

import implicit
import meshref
from benchmarks.common import leave_out_if_slow, sizes, spot
from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.cases.handles import HandleSpec
from compare.runs.operations import target_motion
from compare.runs.subject import prepare_subject
from implicit.edits.trained_rigid_step import TrainedStep, trained_rigid_step

# Motions are scaled by this: one step is linear, and its strain is compared with that of a linear solve.
SMALL = 0.1

# Penalties of the mesh's handles, of which each gives an energy and a handle error to compare with at equal error.
PENALTIES = np.geomspace(1e2, 1e5, 7)


class Scene:
    """The handles of the comparison on a bundled shape, and its common mesh of about 4000 vertices."""

    def __init__(self, name: str) -> None:
        self.subject = prepare_subject(Case(name, "smooth"))
        (case,) = default_cases(name, self.subject.V, self.subject.N, operations=("rigid",))
        self.target = target_motion(case, self.subject)
        self.field = self.subject.field.to(torch.float64)
        self.tracked = torch.from_numpy(self.subject.V)
        self.handles = [
            HandleSpec(spec.region, {**spec.motion, "vector": [SMALL * v for v in spec.motion["vector"]]}).build()
            for spec in case.handles
        ]

    def step(self, points: int) -> implicit.Edit:
        return implicit.rigid_edit(self.field, self.handles, method="linear", points=points, track=self.tracked)

    def trained(self, points: int, iterations: int) -> TrainedStep:
        return trained_rigid_step(self.field, self.handles, points=points, iterations=iterations)

    def measured(self, displacement: np.ndarray) -> tuple[float, float]:
        """Membrane energy on the common mesh and the handles' error relative to their motion, of a small motion."""
        V, F = self.subject.V, self.subject.F
        D = displacement / SMALL
        held, target = self.target.at, self.target.displacement
        error = np.sqrt(((D - target)[held] ** 2).sum(axis=1).mean()) / np.linalg.norm(target, axis=1).max()
        return meshref.killing_energy(V, F, D), float(error)

    def mesh_energy(self, error: float) -> float:
        """Membrane energy of the mesh's Killing least squares at a handle error, between soft handles of some weights.

        Below the least error of these it is that of hard handles.
        """
        V, F = self.subject.V, self.subject.F
        held = np.flatnonzero(self.target.at)
        found = [
            self.measured(
                SMALL
                * meshref.killing(
                    V, F, held, self.target.displacement[held], method="soft", penalty=float(penalty)
                ).displacement
            )
            for penalty in PENALTIES
        ]
        energies, errors = np.log(np.array(found)).T
        order = errors.argsort()
        return float(np.exp(np.interp(np.log(error), errors[order], energies[order])))

    def ratio(self, displacement: np.ndarray) -> tuple[float, float, float]:
        """Energy, handle error, and the energy over the mesh's at that error."""
        energy, error = self.measured(displacement)
        return energy, error, energy / self.mesh_energy(error)


class RigidStep:
    """One step from few points to many."""

    params = sizes(["spot", "cactus"], [500, 1000, 2000])
    param_names = ("shape", "points")
    timeout = 600

    def setup(self, shape, points):
        self.scene = Scene(shape)

    def time_step(self, shape, points):
        self.scene.step(points)

    def peakmem_setup(self, shape, points):
        """Imports and setup alone: the baseline to subtract from peakmem_step."""

    def peakmem_step(self, shape, points):
        self.scene.step(points)

    def track_energy(self, shape, points):
        edit = self.scene.step(points)
        return self.scene.ratio((edit.tracked - self.scene.tracked).numpy())[2]

    def track_handle_error(self, shape, points):
        edit = self.scene.step(points)
        return self.scene.measured((edit.tracked - self.scene.tracked).numpy())[1]

    track_energy.unit = "of meshref.killing at the same handle error"
    track_handle_error.unit = "of the handles' motion"


class TangentialMotions:
    """The motion along the surface that follows from a given normal one."""

    params = sizes(["constant normals", "near-isometric"])
    param_names = ("tangential motion",)

    def setup(self, method):
        self.field = spot("float64")
        self.points = implicit.sample_surface(self.field, 1000, "farthest").points
        generator = torch.Generator().manual_seed(0)
        self.d_theta = 1e-3 * torch.randn(len(self.field.theta), generator=generator, dtype=torch.float64)
        self.motion = implicit.ConstantNormals() if method == "constant normals" else implicit.NearIsometric()

    def time_motion(self, method):
        self.motion(self.field, self.d_theta, self.points)


class TrainedNetwork:
    """The paper's trained network for one step, beside the least squares on the same points."""

    timeout = 600

    def setup(self):
        leave_out_if_slow()
        self.scene = Scene("spot")

    def time_training(self):
        self.scene.trained(500, 200)

    def track_energy(self):
        step = self.scene.trained(500, 200)
        return step.energy / step.linear_energy

    def track_seconds(self):
        step = self.scene.trained(500, 200)
        return step.seconds / step.linear_seconds

    track_energy.unit = "of the least squares"
    track_seconds.unit = "of the least squares"


def print_points(names: list[str], counts: list[int]) -> None:
    print("| shape | points | membrane energy | handle error | energy / mesh's at that error | seconds |")
    print("|---|---|---|---|---|---|")
    for name in names:
        scene = Scene(name)
        for points in counts:
            clock = time.perf_counter()
            edit = scene.step(points)
            seconds = time.perf_counter() - clock
            energy, error, ratio = scene.ratio((edit.tracked - scene.tracked).numpy())
            print(f"| {name} | {points} | {energy:.4g} | {error:.2%} | {ratio:.3f} | {seconds:.1f} |", flush=True)


def print_training(names: list[str], points: int, counts: list[int]) -> None:
    print(f"| shape, {points} points | iterations | E_K + alpha E_C / linear | membrane / mesh's | seconds / linear |")
    print("|---|---|---|---|---|")
    for name in names:
        scene = Scene(name)
        for iterations in counts:
            s = scene.trained(points, iterations)
            ratios = f"{s.energy / s.linear_energy:.2f} | {scene.ratio(s.displacement(scene.tracked).numpy())[2]:.2f}"
            seconds = f"{s.seconds:.1f} / {s.linear_seconds:.1f} = {s.seconds / s.linear_seconds:.1f}"
            print(f"| {name} | {iterations} | {ratios} | {seconds} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", nargs="+", default=["spot", "cactus"])
    parser.add_argument("--points", nargs="+", type=int, default=[500, 1000, 2000, 4000])
    parser.add_argument("--iterations", nargs="*", type=int, default=[200, 1000, 5000])
    chosen = parser.parse_args()
    print_points(chosen.shapes, chosen.points)
    if chosen.iterations:
        print_training(chosen.shapes[:1], 1000, chosen.iterations)
