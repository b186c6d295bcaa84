"""One shape as a field of so many numbers, and as a mesh of so many: how far each is from it.

A mesh moved as wanted has no error, by construction; which numbers are needed to say a shape at all can be asked of
both sides. The shape is the surface of a field, taken as a fine mesh of it. On the one side are networks of several
widths, fitted to it; on the other meshes of fewer vertices: decimated (vertices where the shape bends), and even
triangles with their vertices on it.

distance   rms over samples of both surfaces of the distance to the other, over the diagonal
normals    rms angle between the normals at samples of the shape and those of the representation nearest, radians
volume     relative

Numbers stored are the parameters of a network, or three coordinates a vertex.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.cases.case import BUNDLED
from compare.errors import Progress
from compare.studies.diagram import FIELD, MESH, Diagram, DiagramRow, Point
from compare.studies.workbench import EXACT, Workbench

WIDTHS = (8, 12, 16, 24, 32, 48, 64)
VERTICES = (60, 120, 250, 500, 1000, 2000, 4000)
FIT_STEPS = 4000
TARGET_VERTICES = 16_000  # of the mesh that is decimated, and near which networks are fitted
CELLS = 192  # of the meshes on which the surfaces of fields are sampled
SAMPLES = 20_000


class Representation(Diagram):
    """The diagram of errors of a shape against numbers stored; see the top of this file."""

    name = "representation"
    title = "One shape as a field and as a mesh of as many numbers"
    shapes = ("spot", "cactus", "bracket")
    quick_shapes = ("sphere",)
    known_shapes = (*EXACT, *BUNDLED)
    panels: Mapping[str, str] = {
        "distance": "rms distance of the surfaces, over the diagonal",
        "normals": "rms angle between the normals, radians",
        "volume": "relative error of the volume",
    }
    costs = ("numbers",)

    def points(self, shapes: Sequence[str], quick: bool, folder: Path, progress: Progress | None) -> list[Point]:
        """Return the points of all panels."""
        bench = Workbench(
            folder,
            fit_steps=400 if quick else FIT_STEPS,
            batch=512 if quick else 2048,
            target_vertices=1500 if quick else TARGET_VERTICES,
            resolution=48 if quick else 128,
            progress=progress,
        )
        cells = 48 if quick else CELLS
        samples = 2000 if quick else SAMPLES
        found = []
        for shape in shapes:
            ways: list[tuple[str, str, dict[str, int], Callable[[], Any]]] = []
            for vertices in (60, 250) if quick else VERTICES:
                at = {"vertices": vertices}
                ways.append((MESH, "decimated", at, partial(_decimated, bench, shape, vertices)))
                ways.append((MESH, "even triangles", at, partial(_even, bench, shape, vertices)))
            for width in (16,) if quick else WIDTHS:
                ways.append(
                    (FIELD, "fitted networks", {"units wide": width}, partial(_fitted, bench, shape, width, cells))
                )
            for side, method, at, make in ways:
                measured = partial(_errors, bench, shape, (method, *at.values()), make, (cells, samples))
                for panel in self.panels:
                    name = Path(shape).stem
                    key = "/".join((panel, shape, method, *map(str, at.values())))
                    row = DiagramRow(key, panel, name, side, method, self.costs, at)
                    found.append(Point(row, partial(_of_panel, measured, panel)))
        return found


# A representation as a mesh to sample, and the numbers that it takes, and its volume where that is known better.
Found = tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"], int, float | None]


def _decimated(bench: Workbench, shape: str, vertices: int) -> Found:
    import meshref

    V, F = meshref.decimate(*bench.mesh(shape, bench.target_vertices), faces=2 * vertices)
    return V, F, V.size, None


def _even(bench: Workbench, shape: str, vertices: int) -> Found:
    V, F = bench.mesh(shape, vertices)
    return V, F, V.size, None


def _fitted(bench: Workbench, shape: str, width: int, cells: int) -> Found:
    import implicit

    field = bench.network(shape, width)
    V, F = implicit.extract_mesh(field, cells)
    volume = implicit.Volume().value(field, implicit.surface_quadrature(field, cells // 2))
    return V, F, field.theta.numel(), volume


@dataclass(frozen=True, eq=False)
class Target:
    """A shape as a mesh of its field, and how well that says it."""

    V: Float[ndarray, "n 3"]
    F: Int[ndarray, "m 3"]
    volume: float  # by quadrature
    floors: Mapping[str, float]  # error of each panel that the mesh itself has

    @property
    def diagonal(self) -> float:
        """Diagonal of its box."""
        return float(np.linalg.norm(np.ptp(self.V, axis=0)))


def _target(bench: Workbench, shape: str, cells: int) -> Target:
    """Return the shape itself; its triangles are off by what their middles and their normals are."""
    import torch

    import implicit
    import meshref

    def make() -> Target:
        field = bench.field(shape)
        V, F = implicit.extract_mesh(field, cells)
        volume = implicit.integrate(field, implicit.Volume(), max(32, cells // 2))
        value, gradient = field.value_and_gradient(torch.from_numpy(V[F].mean(axis=1)))
        length = gradient.norm(dim=1)
        cosine = ((gradient / length[:, None]).numpy() * meshref.face_normals(V, F)).sum(axis=1)
        off = float((value / length).square().mean().sqrt()) / float(np.linalg.norm(np.ptp(V, axis=0)))
        angle = float(np.sqrt(np.mean(np.arccos(cosine.clip(-1, 1)) ** 2)))
        floors = {"distance": off, "normals": angle, "volume": volume.error / abs(volume.value)}
        return Target(V, F, volume.value, floors)

    return bench.kept(("target", shape), make)


def _of_panel(measured: Callable[[], tuple[Mapping[str, Any], Mapping[str, float]]], panel: str) -> dict[str, Any]:
    found, floors = measured()
    return {"error": found[panel], "numbers": found["numbers"], "floor": floors[panel]}


def _errors(
    bench: Workbench, shape: str, name: tuple[Any, ...], make: Callable[[], Found], fineness: tuple[int, int]
) -> tuple[Mapping[str, Any], Mapping[str, float]]:
    """Return all errors of a representation, computed once, and those of the shape that it is held against."""
    cells, samples = fineness
    wanted = _target(bench, shape, cells)

    def measure() -> dict[str, Any]:
        import meshref

        V, F, numbers, volume = make()
        there, back = (meshref.sample_mesh(*mesh, samples) for mesh in ((wanted.V, wanted.F), (V, F)))
        distance, face = meshref.SignedDistanceQuery(V, F).distance(there.points)
        other = meshref.SignedDistanceQuery(wanted.V, wanted.F).distance(back.points)[0]
        cosine = (there.normals * meshref.face_normals(V, F)[face]).sum(axis=1).clip(-1, 1)
        enclosed = meshref.volume(V, F) if volume is None else volume
        return {
            "distance": float(np.sqrt((np.mean(distance**2) + np.mean(other**2)) / 2)) / wanted.diagonal,
            "normals": float(np.sqrt(np.mean(np.arccos(cosine) ** 2))),
            "volume": abs(enclosed / wanted.volume - 1),
            "numbers": numbers,
        }

    return bench.kept(("errors", shape, *name), measure), wanted.floors
