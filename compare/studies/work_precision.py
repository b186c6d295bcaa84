"""Work and precision of three operations, on a field and on meshes: error against seconds, and against numbers stored.

volume       of a shape. Error: relative, to the closed form or to the field's quadrature converged.
smoothing    mean-curvature flow for a time; of the sphere free, of others with the volume held. Error: rms distance of
             the result's surface from the reference's, over the diagonal.
rigid        one end held, one moved sideways. Error: rms distance of the displacement from the reference's, over the
             largest.

Both sides start from the same surface: meshes have their vertices on it. References are closed forms (volume of sphere
and torus; the sphere that shrinks, R^2 - 4 t), or the finest computation of the better side with an estimate of its own
error, below which no error is said.

Seconds are of the operation alone, from a field or a mesh that is there. Numbers stored are the parameters of a
network, or three coordinates a vertex; the triangles' corners would be as much twice again. Against seconds a field is
taken at its own size with more and more points, cells and steps; against numbers, networks of several widths are
fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.cases.case import BUNDLED
from compare.errors import Progress
from compare.studies.diagram import FIELD, MESH, REPEATS, Diagram, DiagramRow, Point, timed
from compare.studies.workbench import EXACT, SPHERE_RADIUS, Workbench

if TYPE_CHECKING:
    from implicit import Field

SECONDS, NUMBERS = "seconds", "numbers"

# Points of a surface on which the distance to the reference is averaged.
SAMPLES = 4000

# Steps that no flow of a mesh is given more of; pairs of flows are extrapolated.
MOST_STEPS = 128


@dataclass(frozen=True)
class Resolutions:
    """The sweep of each side."""

    cells: Sequence[int]  # of the quadrature of a field
    vertices: Sequence[int]  # of a mesh whose volume is asked for
    flow_vertices: Sequence[int]
    field_flows: Sequence[tuple[int, int]]  # steps, points
    rigid_vertices: Sequence[int]
    linear_points: Sequence[int]  # of a field's linear steps
    finite_points: Sequence[int]  # of a field's finite rotations
    widths: Sequence[int]  # of networks that are fitted
    fit_steps: int
    batch: int
    target_vertices: int
    reference_cells: int
    reference_vertices: int  # of the mesh on which flow and deformation are converged
    flow_time: float  # of the smoothing, a squared length of the field's units
    repeats: int
    resolution: int  # cells of the grids that meshes are taken from


FULL = Resolutions(
    cells=(16, 24, 32, 48, 64, 96, 128),
    vertices=(250, 1000, 4000, 16_000),
    flow_vertices=(500, 1000, 2000, 4000),
    field_flows=((2, 400), (4, 500), (8, 1000), (16, 1000)),
    rigid_vertices=(500, 1000, 2000, 4000),
    linear_points=(500, 1000, 2000),
    finite_points=(4000,),
    widths=(12, 20, 32),
    fit_steps=1500,
    batch=2048,
    target_vertices=16_000,
    reference_cells=192,
    reference_vertices=12_000,
    flow_time=8e-3,
    repeats=REPEATS,
    resolution=128,
)
QUICK = Resolutions(
    cells=(12, 24),
    vertices=(100, 400),
    flow_vertices=(100, 200),
    field_flows=((1, 100), (2, 100)),
    rigid_vertices=(100, 200),
    linear_points=(100,),
    finite_points=(),
    widths=(16,),
    fit_steps=400,
    batch=512,
    target_vertices=600,
    reference_cells=32,
    reference_vertices=500,
    flow_time=2e-3,
    repeats=2,
    resolution=32,
)


class WorkPrecision(Diagram):
    """The diagram of volume, smoothing and rigid editing; see the top of this file."""

    name = "work-precision"
    title = "Work and precision of field and mesh: error against seconds and against numbers stored"
    shapes = ("sphere", "torus", "spot")
    quick_shapes = ("sphere",)
    known_shapes = (*EXACT, *BUNDLED)
    panels: Mapping[str, str] = {
        "volume": "relative error of the volume",
        "smoothing": "rms distance from the flow, over the diagonal",
        "rigid": "rms distance from the converged motion, over the largest",
    }
    costs = (SECONDS, NUMBERS)

    def points(self, shapes: Sequence[str], quick: bool, folder: Path, progress: Progress | None) -> list[Point]:
        """Return the points of all three panels."""
        r = QUICK if quick else FULL
        bench = Workbench(
            folder,
            fit_steps=r.fit_steps,
            batch=r.batch,
            target_vertices=r.target_vertices,
            resolution=r.resolution,
            progress=progress,
        )
        found = []
        for shape in shapes:
            found += _volume_points(bench, r, shape)
        for shape in shapes:
            if shape != "torus":
                found += _smoothing_points(bench, r, shape)
        for shape in shapes:
            if shape not in EXACT or quick:
                found += _rigid_points(bench, r, shape)
        return found


def _point(
    panel: str,
    shape: str,
    side: str,
    method: str,
    costs: tuple[str, ...],
    at: Mapping[str, Any],
    measure: Callable[[], Mapping[str, Any]],
) -> Point:
    name = Path(shape).stem
    key = "/".join((panel, shape, method, *(f"{name}={value}" for name, value in at.items())))
    return Point(DiagramRow(key, panel, name, side, method, costs, dict(at)), measure)


# Volume


def _volume_points(bench: Workbench, r: Resolutions, shape: str) -> list[Point]:
    truth = partial(_true_volume, bench, r, shape)
    points = []
    for cells in r.cells:
        points.append(
            _point(
                "volume",
                shape,
                FIELD,
                "quadrature",
                (SECONDS,),
                {"cells": cells},
                partial(_of_field, bench, r, shape, cells, truth),
            )
        )
    for vertices in r.vertices:
        work = partial(_of_mesh, bench, r, shape, vertices, truth)
        points.append(_point("volume", shape, MESH, "flat triangles", (SECONDS, NUMBERS), {"vertices": vertices}, work))
    for cells in r.cells:
        points.append(
            _point(
                "volume",
                shape,
                MESH,
                "flat triangles, extracted",
                (SECONDS,),
                {"cells": cells},
                partial(_extracted, bench, r, shape, cells, truth),
            )
        )
    for width in r.widths:
        work = partial(_of_network, bench, r, shape, width, truth)
        points.append(_point("volume", shape, FIELD, "fitted networks", (NUMBERS,), {"units wide": width}, work))
    return points


def _true_volume(bench: Workbench, r: Resolutions, shape: str) -> tuple[float, float]:
    """Return the volume of a shape, and the relative error that it may have."""
    import implicit
    from implicit.shapes import exact_volume

    def make() -> tuple[float, float]:
        field = bench.field(shape)
        if shape in EXACT:
            return exact_volume(field), 1e-15
        found = implicit.integrate(field, implicit.Volume(), r.reference_cells)
        return found.value, found.error / abs(found.value)

    return bench.kept(("volume", shape), make)


def _quadrature(field: Field, cells: int) -> float:
    import implicit

    return implicit.Volume().value(field, implicit.surface_quadrature(field, cells))


def _of_field(bench: Workbench, r: Resolutions, shape: str, cells: int, truth: Any) -> dict[str, Any]:
    field, (volume, floor) = bench.field(shape), truth()
    found, seconds = timed(lambda: _quadrature(field, cells), r.repeats)
    return {"error": abs(found / volume - 1), "floor": floor, "seconds": seconds, "numbers": field.theta.numel()}


def _of_mesh(bench: Workbench, r: Resolutions, shape: str, vertices: int, truth: Any) -> dict[str, Any]:
    import meshref

    (V, F), (volume, floor) = bench.mesh(shape, vertices), truth()
    found, seconds = timed(lambda: meshref.volume(V, F), r.repeats)
    return {"error": abs(found / volume - 1), "floor": floor, "seconds": seconds, "numbers": V.size}


def _extracted(bench: Workbench, r: Resolutions, shape: str, cells: int, truth: Any) -> dict[str, Any]:
    import implicit
    import meshref

    field, (volume, floor) = bench.field(shape), truth()
    found, seconds = timed(lambda: meshref.volume(*implicit.extract_mesh(field, cells)), r.repeats)
    return {"error": abs(found / volume - 1), "floor": floor, "seconds": seconds}


def _of_network(bench: Workbench, r: Resolutions, shape: str, width: int, truth: Any) -> dict[str, Any]:
    field, (volume, floor) = bench.network(shape, width), truth()
    found = _quadrature(field, max(r.cells))
    return {"error": abs(found / volume - 1), "floor": floor, "numbers": field.theta.numel()}


# Smoothing


@dataclass(frozen=True, eq=False)
class FlowReference:
    """The surface to which a flow leads, and the error it may have, both in units of the diagonal of the start."""

    distance: Callable[[Float[ndarray, "n 3"]], Float[ndarray, " n"]]  # of points from it
    floor: float
    diagonal: float


def _smoothing_points(bench: Workbench, r: Resolutions, shape: str) -> list[Point]:
    points = []
    start = partial(_edited_field, bench, r, shape)
    reference = partial(_flow_reference, bench, r, shape)
    for steps, samples in r.field_flows:
        work = partial(_flow_of_field, r, shape, start, steps, samples, reference, True)
        at = {"steps": steps, "points": samples}
        points.append(_point("smoothing", shape, FIELD, "boundary sensitivity", (SECONDS,), at, work))
    for vertices in r.flow_vertices:
        work = partial(_flow_of_mesh, bench, r, shape, vertices, reference)
        points.append(
            _point("smoothing", shape, MESH, "converged steps", (SECONDS, NUMBERS), {"vertices": vertices}, work)
        )
    steps, samples = r.field_flows[-2]
    for width in r.widths:
        network = partial(bench.network, shape, width)
        work = partial(_flow_of_field, r, shape, network, steps, samples, reference, False)
        points.append(_point("smoothing", shape, FIELD, "fitted networks", (NUMBERS,), {"units wide": width}, work))
    return points


def _edited_field(bench: Workbench, r: Resolutions, shape: str) -> Field:
    """Return the field that is edited: of a closed form a network, for its own few numbers are none to edit."""
    return bench.network(shape, max(r.widths)) if shape in EXACT else bench.field(shape)


def _flow_reference(bench: Workbench, r: Resolutions, shape: str) -> FlowReference:
    return bench.kept(("flow", shape), lambda: _make_flow_reference(bench, r, shape))


def _make_flow_reference(bench: Workbench, r: Resolutions, shape: str) -> FlowReference:
    import meshref

    if shape == "sphere":
        radius = float(np.sqrt(SPHERE_RADIUS**2 - 4 * r.flow_time))
        diagonal = 2 * SPHERE_RADIUS * 3**0.5
        return FlowReference(lambda P: np.linalg.norm(P, axis=1) - radius, 1e-15, diagonal)
    results = []
    for vertices in (r.reference_vertices // 4, r.reference_vertices):
        V, F = bench.mesh(shape, vertices)
        results.append(
            (
                meshref.converged_curvature_flow(
                    V, F, time=r.flow_time, tolerance=0.1 / vertices, most_steps=MOST_STEPS
                ),
                F,
            )
        )
    diagonal = _diagonal(bench.mesh(shape, r.reference_vertices)[0])
    coarse, fine = results
    distance = meshref.SignedDistanceQuery(fine[0].flow.V, fine[1]).distance
    sampled = meshref.sample_mesh(coarse[0].flow.V, coarse[1], SAMPLES).points
    # A quarter of the vertices has four times the error: a third of the difference is that of the finer one.
    space = _rms(distance(sampled)[0]) / 3
    floor = (space + fine[0].time_error_rms) / diagonal
    return FlowReference(lambda P: distance(P)[0], floor, diagonal)


def _flow_of_field(
    r: Resolutions,
    shape: str,
    start: Callable[[], Field],
    steps: int,
    samples: int,
    reference: Callable[[], FlowReference],
    against_time: bool,
) -> dict[str, Any]:
    import implicit

    field, wanted = start(), reference()
    held = () if shape == "sphere" else (implicit.Volume(),)

    def work() -> implicit.Edit:
        return implicit.smooth(field, steps=steps, step_size=r.flow_time / steps, points=samples, constraints=held)

    edit, seconds = timed(work, r.repeats) if against_time else (work(), ())
    if edit.status not in (implicit.EditStatus.DONE, implicit.EditStatus.REACHED):
        raise RuntimeError(edit.status.value)
    P = implicit.sample_surface(edit.field, SAMPLES).points.double().numpy()
    found = {"error": _rms(wanted.distance(P)) / wanted.diagonal, "floor": wanted.floor}
    return {**found, "seconds": seconds, "numbers": field.theta.numel(), "status": edit.status.value}


def _flow_of_mesh(
    bench: Workbench, r: Resolutions, shape: str, vertices: int, reference: Callable[[], FlowReference]
) -> dict[str, Any]:
    import meshref

    (V, F), wanted = bench.mesh(shape, vertices), reference()
    # The error of so many vertices falls as one over their number, and that of the steps is kept below it.
    flow, seconds = timed(
        lambda: meshref.converged_curvature_flow(
            V,
            F,
            time=r.flow_time,
            tolerance=0.2 / vertices,
            most_steps=MOST_STEPS,
            preserve_volume=None if shape == "sphere" else "newton",
        ),
        r.repeats,
    )
    if flow.flow.status is not meshref.FlowStatus.FINISHED:
        raise RuntimeError(flow.flow.status.value)
    P = meshref.sample_mesh(flow.flow.V, F, SAMPLES).points
    found = {"error": _rms(wanted.distance(P)) / wanted.diagonal, "floor": wanted.floor}
    return {**found, "seconds": seconds, "numbers": V.size, "status": flow.flow.status.value}


# Rigid editing


@dataclass(frozen=True, eq=False)
class RigidReference:
    """The displacement of a fine mesh on which as-rigid-as-possible deformation has converged."""

    V: Float[ndarray, "n 3"]
    displacement: Float[ndarray, "n 3"]
    weights: Float[ndarray, " n"]  # area of each vertex
    largest: float  # displacement asked for
    floor: float

    def error(self, displacement: Float[ndarray, "n 3"]) -> float:
        """Return how far a displacement of the same vertices is from it."""
        square = ((displacement - self.displacement) ** 2).sum(axis=1)
        return float(np.sqrt(np.average(square, weights=self.weights))) / self.largest


def _rigid_points(bench: Workbench, r: Resolutions, shape: str) -> list[Point]:
    reference = partial(_rigid_reference, bench, r, shape)
    points = []
    for way, counts in (("linear", r.linear_points), ("finite", r.finite_points)):
        for count in counts:
            work = partial(_rigid_of_field, bench, r, shape, None, way, count, reference)
            method = {"linear": "linear steps", "finite": "finite rotations"}[way]
            points.append(_point("rigid", shape, FIELD, method, (SECONDS,), {"points": count}, work))
    for vertices in r.rigid_vertices:
        work = partial(_rigid_of_mesh, bench, r, shape, vertices, reference)
        points.append(_point("rigid", shape, MESH, "ARAP", (SECONDS, NUMBERS), {"vertices": vertices}, work))
    for width in r.widths:
        work = partial(_rigid_of_field, bench, r, shape, width, "linear", r.linear_points[-1], reference)
        points.append(_point("rigid", shape, FIELD, "fitted networks", (NUMBERS,), {"units wide": width}, work))
    return points


def _rigid_reference(bench: Workbench, r: Resolutions, shape: str) -> RigidReference:
    return bench.kept(("rigid", shape), lambda: _make_rigid_reference(bench, r, shape))


def _make_rigid_reference(bench: Workbench, r: Resolutions, shape: str) -> RigidReference:
    import meshref

    V, F = bench.mesh(shape, r.reference_vertices)
    fine = _arap(bench, shape, V, F)
    coarse_mesh = bench.mesh(shape, r.reference_vertices // 2)
    coarse = _carried_to(V, *coarse_mesh, _arap(bench, shape, *coarse_mesh))
    wanted = RigidReference(V, fine, meshref.vertex_areas(V, F), _largest(bench, shape), 0.0)
    return RigidReference(V, fine, wanted.weights, wanted.largest, wanted.error(coarse))


def _handles(bench: Workbench, shape: str) -> Any:
    """Return the handles that `run` takes: one end held, the other moved sideways by 15 % of the length."""
    import torch

    from compare.operations.operation import operation_of

    def make() -> Any:
        V, _ = bench.mesh(shape, 2000)
        N = bench.field(shape).normal(torch.from_numpy(V)).numpy()
        return operation_of("rigid").default_handles(V, N)

    return bench.kept(("handles", shape), make)


def _largest(bench: Workbench, shape: str) -> float:
    return max(float(np.linalg.norm(spec.motion["vector"])) for spec in _handles(bench, shape))


def _arap(bench: Workbench, shape: str, V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"]) -> Float[ndarray, "n 3"]:
    import torch

    import meshref

    held: list[ndarray] = []
    goals: list[ndarray] = []
    for spec in _handles(bench, shape):
        at = np.flatnonzero(spec.build().weights(torch.from_numpy(V)).numpy() > 0.5)
        held.append(at)
        goals.append(V[at] + np.asarray(spec.motion["vector"]))
    result = meshref.arap(V, F, np.concatenate(held), np.concatenate(goals))
    if not result.converged:
        raise RuntimeError(result.status.value)
    return result.V - V


def _carried_to(
    P: Float[ndarray, "k 3"], V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], displacement: Float[ndarray, "n 3"]
) -> Float[ndarray, "k 3"]:
    """Return the displacement of points by that of a mesh, linear in the triangle nearest to each."""
    import meshref

    nearest = meshref.SignedDistanceQuery(V, F)(P)
    A, B, C = (V[F[nearest.face, k]] for k in range(3))
    normal = np.cross(B - A, C - A)
    square = (normal**2).sum(axis=1)
    w = [
        (np.cross(p, q) * normal).sum(axis=1) / square
        for p, q in ((C - B, nearest.closest - B), (A - C, nearest.closest - C), (B - A, nearest.closest - A))
    ]
    return sum(w[k][:, None] * displacement[F[nearest.face, k]] for k in range(3))


def _rigid_of_field(
    bench: Workbench,
    r: Resolutions,
    shape: str,
    width: int | None,
    way: Any,
    count: int,
    reference: Callable[[], RigidReference],
) -> dict[str, Any]:
    import torch

    import implicit

    field = _edited_field(bench, r, shape) if width is None else bench.network(shape, width)
    wanted = reference()
    V = torch.from_numpy(wanted.V)
    if field is not bench.field(shape):  # a network's surface is another
        V = implicit.project_to_surface(field, V)
    handles = [spec.build() for spec in _handles(bench, shape)]
    options: dict[str, Any] = {"steps": 3} if way == "linear" else {}

    def work() -> implicit.Edit:
        return implicit.rigid_edit(field, handles, method=way, points=count, track=V, **options)

    edit, seconds = timed(work, r.repeats) if width is None else (work(), ())
    if edit.tracked is None or not bool(torch.isfinite(edit.tracked).all()):
        raise RuntimeError(f"{edit.status.value} Points of the surface were lost.")
    error = wanted.error((edit.tracked.double() - V.double()).numpy())
    found = {"error": error, "floor": wanted.floor, "seconds": seconds}
    return {**found, "numbers": field.theta.numel(), "status": edit.status.value}


def _rigid_of_mesh(
    bench: Workbench, r: Resolutions, shape: str, vertices: int, reference: Callable[[], RigidReference]
) -> dict[str, Any]:
    (V, F), wanted = bench.mesh(shape, vertices), reference()
    displacement, seconds = timed(lambda: _arap(bench, shape, V, F), r.repeats)
    error = wanted.error(_carried_to(wanted.V, V, F, displacement))
    return {"error": error, "floor": wanted.floor, "seconds": seconds, "numbers": V.size}


def _diagonal(V: Float[ndarray, "n 3"]) -> float:
    return float(np.linalg.norm(np.ptp(V, axis=0)))


def _rms(values: Float[ndarray, " n"]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
