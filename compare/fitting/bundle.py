"""Fit the fields that come with the package again: python -m compare.fitting.bundle [--meshes DIR] [names].

Each is written to implicit/data as NAME.safetensors with its report beside it, NAME.json. The shapes given by formulas
need nothing; spot needs spot.obj (Keenan Crane, public domain) in DIR.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import implicit
import meshref
from compare.files import replace_file
from compare.fitting.fit import FitReport, fit_mesh
from implicit import shapes
from implicit.field.field import Field

# A formula's f is no distance near its blends, so its shape is fitted like any other: through the exact distance to a
# mesh, whose vertices lie on the surface. With this many cells along the cube it is 2e-5 off between them.
RESOLUTION = 192
FROM_FORMULA = ("cactus", "bracket")
STEPS = 12_000  # three times the default of a fit: it is done once


def bundle(name: str, meshes: Path | None = None, *, steps: int = STEPS) -> tuple[Field, FitReport]:
    """Fit one of `implicit.shapes.BUNDLED` anew.

    Args:
        name: Which.
        meshes: The folder that holds spot.obj, needed for spot.
        steps: Steps of training.

    Raises:
        ValueError: There is no such shape.
        FileNotFoundError: The mesh is not in the folder.
    """
    if name not in shapes.BUNDLED:
        raise ValueError(f"there is no bundled field of that name; there are {', '.join(shapes.BUNDLED)}.")
    if name in FROM_FORMULA:
        V, F = implicit.extract_mesh(getattr(shapes, name)(), RESOLUTION)
    else:
        file = f"{name}.obj"
        if meshes is None or not (meshes / file).is_file():
            where = "no folder was named" if meshes is None else f"{meshes} does not hold it"
            raise FileNotFoundError(f"it is fitted to {file}, but {where}. Say where it is: --meshes DIR.")
        V, F = meshref.read_mesh(meshes / file)
    return fit_mesh(V, F, steps=steps)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m compare.fitting.bundle", description=str(__doc__).partition("\n")[0]
    )
    parser.add_argument("names", nargs="*", default=shapes.BUNDLED, help="default: all")
    parser.add_argument("--meshes", type=Path, help="folder that holds spot.obj")
    parser.add_argument("--to", type=Path, default=Path(implicit.__file__).parent / "data", help="default: the package")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of training; default %(default)s")
    chosen = parser.parse_args(arguments)
    for name in chosen.names:
        try:
            field, report = bundle(name, chosen.meshes, steps=chosen.steps)
        except (OSError, ValueError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        implicit.save_field(field, chosen.to / f"{name}.safetensors")
        replace_file(chosen.to / f"{name}.json", (json.dumps(report.to_dict(), indent=1) + "\n").encode())
        print(f"{name}: {report.verdict} {report.seconds:.0f} s")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
