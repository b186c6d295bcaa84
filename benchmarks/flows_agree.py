"""Compare the flow of a field with that of a mesh, each converged: python -m benchmarks.flows_agree [shapes] -o FOLDER

Both follow mean curvature with the volume held, for the same time, from the same surface. Their distance is the rms
over points of the field's result from the mesh's, in diagonals; beside it stands what each side says of its own error:
the field, what its last halving of the steps has changed; the mesh, the error of its steps by extrapolation, and a
third of the distance to the flow on a quarter of its vertices. The areas over time are drawn, of the field in each
number of steps. A line is written as soon as a shape is done; --write puts table and picture in docs/smoothing.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from benchmarks.pages import DOCS, made_by, replace_part
from compare.cases.case import BUNDLED
from compare.studies.workbench import EXACT, Workbench

TIME = 8e-3
SAMPLES = 4000
LEAST = 1e-3  # change of an area that is drawn


def measured(
    bench: Workbench, shape: str, *, width: int, vertices: int, steps: int, most_steps: int, points: int
) -> dict[str, Any]:
    """Return the two flows of a shape in numbers."""
    field = bench.network(shape, width) if shape in EXACT else bench.field(shape)
    bench = _Own(bench, field)
    flows = {}
    for count in (vertices // 4, vertices):
        V, F = bench.mesh(count)
        flows[count] = meshref.converged_curvature_flow(V, F, time=TIME, tolerance=1e-4), F
    V, F = bench.mesh(vertices)
    diagonal = float(np.linalg.norm(np.ptp(V, axis=0)))
    mesh = flows[vertices][0]
    distance = meshref.SignedDistanceQuery(mesh.flow.V, F).distance
    coarse = meshref.sample_mesh(flows[vertices // 4][0].flow.V, flows[vertices // 4][1], SAMPLES).points
    mesh_space = _rms(distance(coarse)[0]) / 3 / diagonal
    start = implicit.Area().value(field, implicit.surface_quadrature(field, 64))
    curves: dict[str, Any] = {}
    rows: list[Any] = []

    def progress(step: int, count: int, row: Any) -> None:
        rows.append((count, row["time"], row["area"] / start - 1))

    found = implicit.converged_smooth(
        field,
        time=TIME,
        steps=steps,
        most_steps=most_steps,
        points=points,
        constraints=(implicit.Volume(),),
        track=torch.from_numpy(V),
        progress=progress,
    )
    for count, time, area in rows:
        curves.setdefault(f"field, {count} steps", [(0.0, 0.0)]).append((time, area))
    before = meshref.area(V, F)
    curves["mesh"] = [(row.time, row.area / before - 1) for row in mesh.flow.history]
    P = implicit.sample_surface(found.edit.field, SAMPLES).points.double().numpy()
    return {
        "shape": Path(shape).stem,
        "area of the field": found.areas[found.steps] / start - 1,
        "area of the mesh": meshref.area(mesh.flow.V, F) / before - 1,
        "distance": _rms(distance(P)[0]) / diagonal,
        "field, steps": found.time_error_rms / diagonal,
        "mesh, steps": mesh.time_error_rms / diagonal,
        "mesh, triangles": mesh_space,
        "steps": [found.steps, mesh.steps],
        "status": found.edit.status.value,
        "curves": curves,
    }


class _Own:
    """Even meshes on the surface of one field."""

    def __init__(self, bench: Workbench, field: implicit.Field) -> None:
        self._bench, self._field = bench, field

    def mesh(self, vertices: int) -> Any:
        from compare.runs.subject import common_mesh

        return self._bench.kept(("own", id(self._field), vertices), lambda: common_mesh(self._field, vertices, 96)[:2])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def drawn(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write a picture of the areas over time."""
    from matplotlib.figure import Figure

    across = min(3, len(rows))
    down = -(-len(rows) // across)
    figure = Figure(figsize=(4.2 * across, 3.4 * down), layout="constrained")
    room = figure.subplots(down, across, squeeze=False).flat
    for axes in room[len(rows) :]:
        axes.set_visible(False)
    for axes, row in zip(room, rows, strict=False):
        names = [name for name in row["curves"] if name != "mesh"]
        for k, name in enumerate(names):
            shade = 0.25 + 0.75 * (k + 1) / len(names)
            axes.plot(*np.transpose(row["curves"][name]), color="#0072b2", alpha=shade, linewidth=1.2, label=name)
        axes.plot(*np.transpose(row["curves"]["mesh"]), color="#d55e00", linestyle="--", linewidth=1.4, label="mesh")
        axes.plot(TIME, row["area of the mesh"], "D", color="#d55e00", markersize=4, label="mesh, extrapolated")
        axes.set_title(row["shape"], fontsize=10)
        if abs(row["area of the mesh"]) < LEAST:
            axes.set_ylim(-LEAST, LEAST)  # a sphere stays as it is
        axes.set_xlabel("time of the flow")
        axes.set_ylabel("change of the area")
        axes.grid(alpha=0.3, linewidth=0.4)
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=150)


def within(row: dict[str, Any]) -> bool:
    """Return True where the two flows are no farther from each other than both say that they may be off."""
    return bool(row["distance"] <= row["field, steps"] + row["mesh, steps"] + row["mesh, triangles"])


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return a table of the flows, lengths in diagonals."""
    lines = [
        "| shape | steps of the field | area, field | area, mesh | distance | field, steps | mesh, steps "
        "| mesh, triangles | distance over the sum |\n|---|---|---|---|---|---|---|---|---|"
    ]
    for row in rows:
        areas = [f"{100 * row[side]:+.3f} %" for side in ("area of the field", "area of the mesh")]
        lengths = [
            f"{100 * row[name]:.2g} %" for name in ("distance", "field, steps", "mesh, steps", "mesh, triangles")
        ]
        share = row["distance"] / (row["field, steps"] + row["mesh, steps"] + row["mesh, triangles"])
        cells = [row["shape"], str(row["steps"][0]), *areas, *lengths, f"{share:.2f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Measure the shapes, print a line each, and draw the areas."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shapes", nargs="*", default=[*EXACT, *BUNDLED])
    parser.add_argument("-o", "--output", type=Path, default=Path("results/flows-agree"))
    parser.add_argument("--width", type=int, default=32)
    parser.add_argument("--fit-steps", type=int, default=1500)
    parser.add_argument("--vertices", type=int, default=8000)
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--most-steps", type=int, default=32)
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument(
        "--write", action="store_true", help="put the table and the picture of all that is kept in docs"
    )
    asked = parser.parse_args(arguments)
    asked.output.mkdir(parents=True, exist_ok=True)
    kept = asked.output / "rows.jsonl"
    bench = Workbench(asked.output / "inputs", fit_steps=asked.fit_steps)
    there = {row["shape"]: row for row in map(json.loads, kept.read_text().splitlines())} if kept.is_file() else {}
    for shape in asked.shapes:
        if Path(shape).stem not in there:
            row = measured(
                bench,
                shape,
                width=asked.width,
                vertices=asked.vertices,
                steps=asked.steps,
                most_steps=asked.most_steps,
                points=asked.points,
            )
            there[row["shape"]] = row
            with open(kept, "a") as file:
                file.write(json.dumps(row) + "\n")
        row = there[Path(shape).stem]
        words = {name: value for name, value in row.items() if name != "curves"}
        words["within"] = within(row)
        print(json.dumps(words), flush=True)
    drawn(list(there.values()), asked.output / "areas.png")
    if asked.write:
        command = f"python -m benchmarks.flows_agree {' '.join(there)} --most-steps {asked.most_steps} --write"
        replace_part(DOCS / "smoothing.md", "flows", f"{made_by(command)}:\n\n{table(list(there.values()))}")
        drawn(list(there.values()), DOCS / "flows-agree.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
