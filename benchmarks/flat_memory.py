"""Memory of the long operations over a thousand steps, to show that it stays flat: python benchmarks/flat_memory.py

Resident memory, as the system counts it, after a fifth of the steps and at the end, of tiny fields and meshes, so that
the numbers of the fields themselves do not count. What grows is a leak, or a history.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from implicit import shapes
from implicit.step.tangential_basis import CosineFeatures

Progress = Callable[..., None]
BALL = shapes.sphere(0.5)
BULB = shapes.smooth_union(shapes.capsule(), shapes.sphere(0.25, (0.3, 0.0, 0.0)))
V, F = meshref.torus(24, 12)
HANDLES = np.array([0, 90, 150, 250])


def resident() -> float:
    """Megabytes that this process has in memory."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


def geometric(steps: int, progress: Progress) -> None:
    bump = implicit.Handle(implicit.Ball((0.5, 0, 0), 2.0), implicit.Along(0.05))
    implicit.geometric_edit(BALL, bump, steps=steps, points=60, resolution=8, progress=progress)


def smooth(steps: int, progress: Progress) -> None:
    volume = [implicit.Volume()]
    options: dict[str, Any] = {"points": 60, "resolution": 8, "constraints": volume}
    implicit.smooth(BULB, steps=steps, step_size=1e-7, progress=progress, **options)


def rigid(steps: int, progress: Progress) -> None:
    top = implicit.Handle(implicit.HalfSpace((0, 0.3, 0), (0, 1, 0)), (0.02, 0.0, 0.0))
    foot = implicit.Handle(implicit.HalfSpace((0, -0.3, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
    model = CosineFeatures(BULB, waves=20)
    implicit.rigid_edit(BULB, [top, foot], steps=steps, tangential=model, points=60, progress=progress)


def semantic(steps: int, progress: Progress) -> None:
    sample = implicit.sample_surface(BALL, 20, resolution=8)
    displacement = 0.1 * sample.normals
    implicit.semantic_edit(BALL, sample.points, displacement, steps=steps, stride=5e-5, progress=progress)


def fit(steps: int, progress: Progress) -> None:
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    distances = points.norm(dim=1) - 0.5
    distances[:200] *= 1e-2
    implicit.fit_field(points, distances, points, width=8, depth=2, steps=steps, batch=64, progress=progress)


def flow(steps: int, progress: Progress) -> None:
    meshref.mean_curvature_flow(V, F, steps=steps, step_size=1e-6, preserve_volume="newton", progress=progress)


def arap(steps: int, progress: Progress) -> None:
    targets = V[HANDLES] + [[0, 0, 0.3], [0, 0, 0], [0.3, 0, 0], [0, 0, 0]]
    meshref.arap(V, F, HANDLES, targets, iterations=steps, tolerance=1e-300, progress=progress)


def killing(steps: int, progress: Progress) -> None:
    for step in range(steps):
        meshref.killing(V, F, HANDLES, np.full((4, 3), 0.1))
        progress(step + 1, steps)


OPERATIONS = (geometric, smooth, rigid, semantic, fit, flow, arap, killing)


def main() -> None:
    """Print a row for each operation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="of operations; all by default")
    parser.add_argument("--steps", type=int, default=1000)
    arguments = parser.parse_args()
    print("| operation | steps | MB after a fifth | MB at the end | growth | s |\n|---|---|---|---|---|---|")
    for operation in OPERATIONS:
        if arguments.names and operation.__name__ not in arguments.names:
            continue
        seen: dict[int, float] = {}

        def progress(step: int, *_: object, seen: dict[int, float] = seen) -> None:
            seen[step] = resident()

        start = time.perf_counter()
        operation(arguments.steps, progress)
        early = seen[min(step for step in seen if step >= max(seen) / 5)]
        late = seen[max(seen)]
        seconds = time.perf_counter() - start
        name = operation.__name__
        print(f"| {name} | {max(seen)} | {early:.1f} | {late:.1f} | {late - early:+.1f} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    main()
