"""Ten meshes that are hard to fit, made in code, and the table of their fits: python benchmarks/hard_meshes.py

Thin blades and teeth, many handles, rings that hold each other, a hollow: what a network rounds, closes or loses. Each
is fitted as `implicit-vs-mesh fit --budget 300` fits it, and what comes out is held against what it was made of.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import manifold3d
import numpy as np

import meshref
from compare.fitting.fit import fit_mesh

BUDGET = 300.0  # seconds for each

WIDTHS = {3 * w + w + 2 * w * (w + 1) + w + 1: w for w in (32, 64, 128, 256)}  # by parameters

Mesh = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Hard:
    """A mesh and what it is, known from its making."""

    make: Callable[[], Mesh]
    surfaces: int  # connected ones: a hollow has one of its own
    genus: int  # of all surfaces together
    volume: float | None = None  # in closed form, where its faces are flat


def tray() -> Mesh:
    """A plate with 23 square holes."""
    places = [(x, y) for y in range(5) for x in range(5)][:23]
    return _arrays(_box((6, 6, 0.6)) - _sum(_box((0.6, 0.6, 2)).translate((x - 2, y - 2, 0)) for x, y in places))


def chain() -> Mesh:
    """Three rings, each through the next."""
    V, F = meshref.torus(64, 32, major_radius=1.0, minor_radius=0.25)
    turned, step = V[:, [0, 2, 1]] * [1, 1, -1], np.array([1.4, 0, 0])
    rings = [V, turned + step, V + 2 * step]
    return np.concatenate(rings), np.concatenate([F + k * len(V) for k in range(3)])


def hollow_box() -> Mesh:
    """A box with a box of nothing in it, and walls of a tenth."""
    return _arrays(_box((2, 2, 2)) - _box((1.6, 1.6, 1.6)))


def lattice() -> Mesh:
    """The rods of 2 x 2 x 2 cells."""
    rods = [np.roll([2.3, 0.3, 0.3], axis) for axis in range(3)]
    places = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    return _arrays(
        _sum(_box(rods[k]).translate(np.insert([a, b], k, 0).astype(float)) for k in range(3) for a, b in places)
    )


def comb() -> Mesh:
    """A spine with 20 teeth, each a fortieth of the length wide."""
    teeth = (_box((0.1, 1.2, 0.15)).translate((0.2 * k - 1.9, -0.6, 0)) for k in range(20))
    return _arrays(_box((4, 0.4, 0.15)).translate((0, 0.2, 0)) + _sum(teeth))


def screw() -> Mesh:
    """A thread of six turns with a six-sided head."""
    profile = manifold3d.CrossSection.circle(0.3, 48).translate((0.08, 0.0))
    thread = profile.extrude(2.4, 288, 6 * 360.0)
    head = manifold3d.CrossSection.circle(0.7, 6).extrude(0.35).translate((0, 0, 2.4))
    return _arrays(thread + head)


def gear() -> Mesh:
    """A wheel of 16 teeth with a bore and five holes."""
    corners = []
    for k in range(16):
        for at, radius in ((-0.3, 0.8), (-0.15, 1.0), (0.15, 1.0), (0.3, 0.8)):
            angle = 2 * np.pi * (k + at) / 16
            corners.append((radius * np.cos(angle), radius * np.sin(angle)))
    wheel = manifold3d.CrossSection([np.array(corners)])
    holes = [manifold3d.CrossSection.circle(0.2, 32)]
    for k in range(5):
        angle = 2 * np.pi * k / 5
        holes.append(
            manifold3d.CrossSection.circle(0.13, 32).translate((0.5 * float(np.cos(angle)), 0.5 * float(np.sin(angle))))
        )
    for hole in holes:
        wheel = wheel - hole
    return _arrays(wheel.extrude(0.3))


def bowl() -> Mesh:
    """Half a ball's shell, 0.06 thick."""
    angle = np.linspace(-np.pi / 2, 0, 40)
    outer = np.column_stack([np.cos(angle), np.sin(angle)])
    outline = np.concatenate([outer, 0.94 * outer[::-1]])
    return _arrays(manifold3d.CrossSection([outline]).revolve(96))


def knot() -> Mesh:
    """A tube round a trefoil."""
    t = 2 * np.pi * np.arange(240) / 240
    middle = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)])
    along = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # One direction across that nowhere runs along the curve: from the axis of the knot outwards.
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(along, across)
    s = 2 * np.pi * np.arange(24) / 24
    ring = np.cos(s)[None, :, None] * across[:, None] + np.sin(s)[None, :, None] * third[:, None]
    V = (middle[:, None] + 0.4 * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(240), np.arange(24), indexing="ij")
    a, b = 24 * i + j, 24 * i + (j + 1) % 24
    c, d = 24 * ((i + 1) % 240) + j, 24 * ((i + 1) % 240) + (j + 1) % 24
    F = np.concatenate([np.stack(x, axis=-1).reshape(-1, 3) for x in ((a, b, c), (b, d, c))])
    return V, F


def sword() -> Mesh:
    """A blade a hundredth as thick as it is long, with a guard and a grip."""
    blade = _box((8, 0.6, 0.1)).translate((4, 0, 0))
    guard, grip = _box((0.25, 1.8, 0.3)), _box((2, 0.3, 0.25)).translate((-1, 0, 0))
    return _arrays(blade + guard + grip)


MESHES = {
    "tray": Hard(tray, 1, 23, 0.6 * (36 - 23 * 0.36)),
    "chain": Hard(chain, 3, 3),
    "hollow box": Hard(hollow_box, 2, 0, 8 - 1.6**3),
    "lattice": Hard(lattice, 1, 28, 27 * 0.3**3 + 54 * 0.7 * 0.3**2),
    "comb": Hard(comb, 1, 0, 4 * 0.4 * 0.15 + 20 * 0.1 * 1.2 * 0.15),
    "screw": Hard(screw, 1, 0),
    "gear": Hard(gear, 1, 6),
    "bowl": Hard(bowl, 1, 0),
    "knot": Hard(knot, 1, 1),
    "sword": Hard(sword, 1, 0, 7.875 * 0.6 * 0.1 + 0.25 * 1.8 * 0.3 + 1.875 * 0.3 * 0.25),
}


def _box(sides: Any) -> Any:
    return manifold3d.Manifold.cube(tuple(map(float, sides)), True)


def _sum(solids: Any) -> Any:
    return manifold3d.Manifold.batch_boolean(list(solids), manifold3d.OpType.Add)


def _arrays(solid: Any) -> Mesh:
    mesh = solid.to_mesh64()
    V, F = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64)
    target = np.arange(len(V))
    target[np.asarray(mesh.merge_from_vert, dtype=np.int64)] = np.asarray(mesh.merge_to_vert, dtype=np.int64)
    used, F = np.unique(target[F], return_inverse=True)
    return V[used], F.reshape(-1, 3)


COLUMNS = ("mesh", "faces", "network", "mean distance %", "volume %", "surfaces", "genus", "processor s", "good")


def row(name: str, budget: float) -> tuple[str, ...]:
    """Fit one of the meshes; return its line of the table."""
    hard = MESHES[name]
    V, F = hard.make()
    start = time.process_time()
    _, report = fit_mesh(V, F, budget=budget)
    seconds = time.process_time() - start
    return (
        name,
        f"{len(F)}",
        f"3 x {WIDTHS.get(report.parameters, '?')}",
        f"{100 * report.mean_distance:.3f}",
        f"{100 * report.volume_error:+.2f}",
        f"{report.components} ({hard.surfaces})",
        f"{report.genus} ({hard.genus})",
        f"{seconds:.0f}",
        "yes" if report.good else "no",
    )


def main() -> None:
    """Fit and print a row for each, as it comes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(MESHES), help="of meshes; all by default")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds for each; default %(default)s")
    arguments = parser.parse_args()
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    for name in arguments.names:
        print("| " + " | ".join(row(name, arguments.budget)) + " |", flush=True)


if __name__ == "__main__":
    main()
