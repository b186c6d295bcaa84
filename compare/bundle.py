"""Fit the fields that come with the package again, from scratch: python -m compare.bundle [--meshes DIR] [names].

Each is written to implicit/data as NAME.safetensors with its report beside it, NAME.json. The analytic shapes need
nothing; spot needs spot.obj (Keenan Crane, public domain) in DIR.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import implicit
import meshref
from compare.fit import FitReport, fit_mesh
from implicit import shapes
from implicit.field import Field
from implicit.files import replace_file

RESOLUTION = 192  # cells along the cube for the mesh of an analytic shape; its vertices lie on the surface


def bundle(name: str, meshes: Path | None = None) -> tuple[Field, FitReport]:
    """Fit one of `implicit.shapes.BUNDLED` anew.

    Args:
        name: Which.
        meshes: The folder that holds spot.obj, needed for spot.
    """
    if name in ("cactus", "bracket"):
        V, F = implicit.extract_mesh(getattr(shapes, name)(), RESOLUTION)
    else:
        if meshes is None or not (meshes / f"{name}.obj").is_file():
            raise FileNotFoundError(f"{name} is fitted to {name}.obj, which is not in {meshes}. Say where: --meshes DIR.")
        V, F = meshref.read_mesh(meshes / f"{name}.obj")
    return fit_mesh(V, F)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m compare.bundle", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=shapes.BUNDLED, help="default: all")
    parser.add_argument("--meshes", type=Path, help="folder with spot.obj")
    parser.add_argument("--to", type=Path, default=Path(shapes.__file__).parent / "data", help="default: the package")
    chosen = parser.parse_args(arguments)
    for name in chosen.names:
        try:
            field, report = bundle(name, chosen.meshes)
        except (OSError, ValueError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        implicit.save_field(field, chosen.to / f"{name}.safetensors")
        replace_file(chosen.to / f"{name}.json", (json.dumps(report.to_dict(), indent=1) + "\n").encode())
        print(f"{name}: {report.verdict} {report.seconds:.0f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
