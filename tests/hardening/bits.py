"""Run every editor, sampler, fit and mesh operation so many times, and print the hashes of what they give.

python bits.py 2        the runs of one process must agree, and with those of another, whatever its hash seed
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from implicit import shapes
from implicit.step.tangential_basis import CosineFeatures

BALL = shapes.sphere(0.5)
BULB = shapes.smooth_union(shapes.capsule(), shapes.sphere(0.25, (0.3, 0.0, 0.0)))
TOP = implicit.Handle(implicit.HalfSpace((0, 0.3, 0), (0, 1, 0)), (0.05, 0.0, 0.0))
FOOT = implicit.Handle(implicit.HalfSpace((0, -0.3, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
BUMP = implicit.Handle(implicit.Ball((0.5, 0, 0), 0.2, falloff=0.1), implicit.Along(0.03))
SMALL: dict[str, Any] = {"points": 100, "resolution": 16}
V, F = meshref.torus(12, 8)
HANDLES = np.array([0, 17, 40, 70])
WANTED = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])


def fit() -> object:
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 2 - 1
    distances = points.norm(dim=1) - 0.5
    distances[:50] *= 1e-2
    field, _ = implicit.fit_field(points, distances, points, width=8, depth=2, steps=30, batch=64, band=0.1)
    return field.theta


def semantic() -> object:
    def decoder(points: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
        return (points * (1 + code[:3])).norm(dim=1) - 0.5 - code[3]

    field = implicit.decoder_field(decoder, torch.zeros(4, dtype=torch.float64))
    points, ways = implicit.prescribe(field, BUMP, 20, resolution=16)
    return implicit.semantic_edit(field, points, ways, steps=3)


RUNS: dict[str, Callable[[], object]] = {
    "sample stratified": lambda: implicit.sample_surface(BULB, 50, resolution=16, seed=3),
    "sample uniform": lambda: implicit.sample_surface(BULB, 50, "uniform", resolution=16, seed=3),
    "sample farthest": lambda: implicit.sample_surface(BULB, 20, "farthest", resolution=16, seed=3),
    "sample rejection": lambda: implicit.sample_surface(BULB, 20, "rejection", resolution=16, seed=3),
    "quadrature": lambda: implicit.surface_quadrature(BULB, 16),
    "extract": lambda: implicit.extract_mesh(BULB, 16),
    "geometric": lambda: implicit.geometric_edit(BALL, BUMP, steps=2, **SMALL),
    "rigid": lambda: implicit.rigid_edit(BULB, [TOP, FOOT], tangential=CosineFeatures(BULB, waves=40), **SMALL),
    "smooth": lambda: implicit.smooth(BALL, steps=2, step_size=1e-4, constraints=[implicit.Volume()], **SMALL),
    "semantic": semantic,
    "expressibility": lambda: implicit.expressibility(BALL, BUMP, steps=2, points=100).error,
    "trained step": lambda: (
        implicit.trained_rigid_step(
            BULB, [TOP, FOOT], iterations=5, points=50, tangential=CosineFeatures(BULB, waves=40)
        ).d_theta
    ),
    "fit": fit,
    "killing": lambda: meshref.killing(V, F, HANDLES, WANTED),
    "killing soft": lambda: meshref.killing(V, F, HANDLES, WANTED, method="soft"),
    "arap": lambda: meshref.arap(V, F, HANDLES, V[HANDLES] + WANTED, iterations=20),
    "biharmonic": lambda: meshref.biharmonic(V, F, HANDLES, WANTED),
    "flow": lambda: meshref.mean_curvature_flow(V, F, steps=3, step_size=1e-3, preserve_volume="newton"),
    "flow limit": lambda: meshref.explicit_step_limit(V, F),
    "mesh sample": lambda: meshref.sample_mesh(V, F, 50, seed=3),
    "mesh distance": lambda: meshref.surface_distance(V, F, 1.1 * V, F, n=100),
    "signed distance": lambda: meshref.signed_distance(V, F, WANTED),
    "iou": lambda: meshref.iou(V, F, 1.1 * V, F, n=100),
    "mend": lambda: meshref.mend_mesh(np.vstack([V, V[:3]]), F[5:])[:2],
}

TIMES = ("seconds", "seconds_solve", "seconds_start")


def bits(value: Any, digest: Any) -> None:
    """Feed all numbers in a result to the hash, but not how long it took."""
    value = _plain(value)
    if isinstance(value, np.ndarray):
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for name in value:
            if name not in TIMES:
                bits([name, value[name]], digest)
    elif isinstance(value, list | tuple):
        for part in value:
            bits(part, digest)
    elif isinstance(value, Enum) or not callable(value):
        digest.update(repr(value).encode())


def _plain(value: Any) -> Any:
    """Return a field or tensor as an array, and a record as a mapping of its parts."""
    if isinstance(value, implicit.Field):
        value = value.theta
    if isinstance(value, torch.Tensor):
        return value.detach().numpy()
    if dataclasses.is_dataclass(value) and not isinstance(value, type | Mapping):
        return {part.name: getattr(value, part.name) for part in dataclasses.fields(value)}
    return value._asdict() if hasattr(value, "_asdict") else value


def hash_of(run: Callable[[], object]) -> str:
    """Of all that a run gives."""
    digest = hashlib.sha256()
    bits(run(), digest)
    return digest.hexdigest()


if __name__ == "__main__":
    times = int(sys.argv[1])
    json.dump({name: [hash_of(run) for _ in range(times)] for name, run in RUNS.items()}, sys.stdout)
