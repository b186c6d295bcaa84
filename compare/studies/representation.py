"""One shape as a field of so many numbers, and as a mesh of so many: how far each is from it.

A mesh moved as wanted has no error, by construction; which numbers are needed to say a shape at all can be asked of
both sides. The shape is a fine mesh. On the one side are networks of several widths, fitted to it; on the other meshes
of fewer vertices: decimated (vertices where the shape bends), and even triangles with their vertices on it.

distance   rms over samples of both surfaces of the distance to the other, over the diagonal
normals    rms angle between the normals at samples of the shape and those of the representation nearest, radians
volume     relative

Numbers stored are the parameters of a network, or three coordinates a vertex.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
TARGET_VERTICES = 16_000
CELLS = 192  # of the mesh on which a field's surface is sampled
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
                measured = partial(_errors, bench, shape, (method, *at.values()), make, samples)
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

    V, F = meshref.decimate(*_target(bench, shape), faces=2 * vertices)
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


def _target(bench: Workbench, shape: str) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]:
    return bench.mesh(shape, bench.target_vertices)


def _of_panel(measured: Callable[[], Mapping[str, Any]], panel: str) -> dict[str, Any]:
    found = measured()
    return {"error": found[panel], "numbers": found["numbers"], "floor": found["floor"] if panel == "volume" else 0.0}


def _errors(
    bench: Workbench, shape: str, name: tuple[Any, ...], make: Callable[[], Found], samples: int
) -> Mapping[str, Any]:
    """Return all errors of a representation, computed once."""

    def measure() -> dict[str, Any]:
        import meshref

        V, F, numbers, volume = make()
        wanted, faces = _target(bench, shape)
        there, back = (meshref.sample_mesh(*mesh, samples) for mesh in ((wanted, faces), (V, F)))
        nearest = meshref.SignedDistanceQuery(V, F).distance(there.points)
        distances = [nearest[0], meshref.SignedDistanceQuery(wanted, faces).distance(back.points)[0]]
        cosine = (there.normals * meshref.face_normals(V, F)[nearest[1]]).sum(axis=1).clip(-1, 1)
        truth = _volume(bench, shape)
        enclosed = meshref.volume(V, F) if volume is None else volume
        diagonal = float(np.linalg.norm(np.ptp(wanted, axis=0)))
        return {
            "distance": float(np.sqrt(np.mean([np.mean(d**2) for d in distances]))) / diagonal,
            "normals": float(np.sqrt(np.mean(np.arccos(cosine) ** 2))),
            "volume": abs(enclosed / truth - 1),
            "numbers": numbers,
            "floor": 1e-6,  # of the field's quadrature at a grid this fine
        }

    return bench.kept(("errors", shape, *name), measure)


def _volume(bench: Workbench, shape: str) -> float:
    import implicit

    field = bench.field(shape)
    return bench.kept(("volume", shape), lambda: implicit.Volume().value(field, implicit.surface_quadrature(field, 96)))
