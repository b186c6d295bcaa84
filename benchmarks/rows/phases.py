"""Where the time of the main operations goes, by what kind of work it is: the table of docs/profile.md."""

from __future__ import annotations

import cProfile
import pstats
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

import implicit
import meshref
from compare.paper.rigidity import mesh_of
from implicit import families, shapes

# Kinds of work, by the files and names of the functions whose own time counts; what is in none of them is the rest.
KINDS = {
    "network": r"models/|torch\.(sin|cos|tanh)|_nn\.|run_backward|functorch|autograd|nn/modules",
    "products, factors": r"cholesky|superlu|SuperLU|cholespy|symmetric\.py|_linalg|einsum|eigh|\.mm'|"
    r"/factors/\w+\.py:(of|solve)|/deformation\.py:strain_rows|/meshref/(arap|rotations|quasi_newton)\.py:(?!_energy)",
    "marching cubes": r"_marching_cubes",
    "numbers from text": r"meshref/formats|'(str|bytes|list)' objects|numpy\.array",
}


def phases() -> None:
    """Seconds of the processor on one thread, the largest of these kinds of work, and the rest."""
    torch.set_num_threads(1)
    print(f"\n| operation | s | {' | '.join(KINDS)} | rest |\n|---|---|{'---|' * (len(KINDS) + 1)}")
    with tempfile.TemporaryDirectory() as folder:
        for name, work in operations(Path(folder)).items():
            work()  # imports
            profile = cProfile.Profile(time.process_time)
            profile.runcall(work)
            found: pstats.Stats = pstats.Stats(profile)
            shares = dict.fromkeys([*KINDS, "rest"], 0.0)
            for (file, _, function), (_, _, own, _, _) in found.stats.items():  # type: ignore[attr-defined]
                kind = next((k for k, names in KINDS.items() if re.search(names, f"{file}:{function}")), "rest")
                shares[kind] += own
            total = sum(shares.values())
            cells = " | ".join(f"{100 * share / total:.0f} %" for share in shares.values())
            print(f"| {name} | {total:.3g} | {cells} |", flush=True)


def operations(folder: Path) -> dict[str, Callable[[], object]]:
    """Each of modest size, on the bundled cow and on an even mesh of it with 35,000 vertices."""
    field = shapes.bundled("spot")
    precise = field.to(torch.float64)
    V, F = mesh_of(precise, 35_000)
    meshref.write_mesh(folder / "spot.obj", V, F)
    low, high = np.quantile(V[:, 1], [0.1, 0.9])
    at = np.flatnonzero((V[:, 1] < low) | (V[:, 1] > high))
    way = np.where(V[at, 1:2] > high, [[0.1, 0.0, 0.0]], 0.0)
    bump = implicit.Handle(implicit.HalfSpace((0, 0.35, 0), (0, 1, 0), falloff=0.3), (0.0, 0.16, 0.0))
    feet = implicit.Handle(implicit.HalfSpace((0, -0.6, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
    head = implicit.Handle(implicit.HalfSpace((0, 0.5, 0), (0, 1, 0)), (0.1, 0.0, 0.0))
    model = families.bundled("deepsdf-chairs")
    chair = model.field(model.latents[0])
    below = implicit.HalfSpace((0, -0.45 * model.scale, 0), (0, -1, 0))
    points, ways = implicit.prescribe(chair, implicit.Handle(below, (0.0, 0.1 * model.scale, 0.0)))
    near = implicit.sample_surface(precise, 20_000)
    off = 0.02 * torch.randn(len(near), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    samples = near.points + off[:, None] * near.normals, off, near.normals
    step = 1e-4 * meshref.area(V, F)
    return {
        "geometric_edit, 4 parts, 2000 points": lambda: implicit.geometric_edit(precise, bump, steps=4, points=2000),
        "smooth, 3 steps, volume held": lambda: implicit.smooth(field, steps=3, constraints=(implicit.Volume(),)),
        "rigid_edit, 1000 points": lambda: implicit.rigid_edit(precise, [feet, head], method="linear", points=1000),
        "semantic_edit, a chair's feet": lambda: implicit.semantic_edit(chair, points, ways),
        "extract_mesh, 256^3": lambda: implicit.extract_mesh(field, 256),
        "surface_quadrature, 64^3": lambda: implicit.surface_quadrature(precise, 64),
        "sample_surface, 10,000 points": lambda: implicit.sample_surface(field, 10_000),
        "fit_field, 300 steps": lambda: implicit.fit_field(*samples, steps=300),
        "meshref.arap, 20 iterations": lambda: meshref.arap(V, F, at, V[at] + way, iterations=20, tolerance=1e-15),
        "meshref.killing": lambda: meshref.killing(V, F, at, way),
        "mean_curvature_flow, 10 steps": lambda: meshref.mean_curvature_flow(
            V, F, steps=10, step_size=step, preserve_volume="rescale"
        ),
        "read_mesh, .obj": lambda: meshref.read_mesh(folder / "spot.obj"),
        "check_mesh, closed": lambda: meshref.check_mesh(V, F, closed=True),
    }
