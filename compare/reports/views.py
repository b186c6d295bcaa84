"""The meshes of a record as one looks at them: before, and the result of each method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.operations.operation import operation_of
from compare.runs.records import Record

PANES = {"before": "before", "implicit": "neural field", "mesh": "mesh"}  # of a still picture
ELEVATION = 20.0  # degrees above the horizon, of the first look at a shape

Up = Literal["x", "y", "z"]

# Formats whose coordinates have z upwards, by their specification or by what writes them (printers, CAD).
Z_IS_UP = (".stl", ".3mf")

# Share below which a colour range does not go: of the largest motion, and as a strain. With less, what nobody could
# see of a result would fill the picture with the strongest colours.
FLOOR = 0.01


@dataclass(frozen=True, eq=False)
class View:
    """A mesh with one number a vertex."""

    V: Float[ndarray, "n 3"]
    F: Int[ndarray, "m 3"]
    values: Float[ndarray, " n"]  # NaN where a vertex has none


def load_views(record: Record, folder: Path) -> dict[str, View]:
    """Return the views of a record: "before", then each side whose mesh was kept; empty for a failed record.

    Raises:
        FileNotFoundError: A file that the record names is gone.
    """
    return {name: read_view(folder / record.artefacts[name].path) for name in drawn_sides(record, before=True)}


def drawn_sides(record: Record, *, before: bool = False) -> list[str]:
    """Return the sides of a record whose mesh was kept, in the order of its rows."""
    names = [*(["before"] if before else []), *record.sides]
    return [name for name in names if name in record.artefacts]


def read_view(path: Path) -> View:
    """Return a binary .ply with a vertex quality, as run_case writes it; values are NaN where it has none.

    Raises:
        FileNotFoundError: There is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no {path}, though results.jsonl names it. Run the case again.")
    import meshref

    V, F = meshref.read_mesh(path)
    content = path.read_bytes()
    header, body = content.split(b"end_header\n", 1)
    columns = [line.split()[-1] for line in header.splitlines() if line.startswith(b"property double")]
    if b"quality" not in columns:
        return View(V, F, np.full(len(V), np.nan))
    table = np.frombuffer(body, "<f8", count=len(V) * len(columns)).reshape(len(V), len(columns))
    return View(V, F, table[:, columns.index(b"quality")].copy())


def simplified(view: View, faces: int) -> View:
    """Return the view with at most so many faces; each new vertex takes the number of the nearest old one."""
    if len(view.F) <= faces:
        return view
    from scipy.spatial import cKDTree

    V, F = _simplified(view, faces)
    return View(V, F, view.values[cKDTree(view.V).query(V)[1]])


def simplified_alike(views: Sequence[View], faces: int) -> list[View]:
    """Return views of one and the same mesh, moved, with at most so many faces, whose corners are vertices of it."""
    first = views[0]
    if len(first.F) <= faces:
        return list(views)
    from scipy.spatial import cKDTree

    V, F = _simplified(first, faces)
    kept = cKDTree(first.V).query(V)[1]
    return [View(view.V[kept], F, view.values[kept]) for view in views]


def _simplified(view: View, faces: int) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"]]:
    import igl

    V, F = igl.qslim(view.V, view.F, faces)[:2]
    return np.ascontiguousarray(V), np.ascontiguousarray(F).astype(np.int64)  # libigl gives long long


def up_of(shape: str) -> Up:
    """Return the axis that points up in a shape's file, as its format has it; y where it says nothing."""
    return "z" if Path(shape).suffix.lower() in Z_IS_UP else "y"


def motion_of(record: Record) -> float | None:
    """Return the largest motion of a case, a length: of the mesh, which is where its handles are, or else the field.

    Errors are shown in per cent of it. None where the record has none.
    """
    for side in ("mesh", "implicit"):
        found = record.sides[side].get("displacement_max") if side in record.sides else None
        if found:
            return float(found)
    return None


@dataclass(frozen=True)
class ColourRange:
    """A range of values that the results of a case share."""

    limit: float  # the value of the strongest colour
    one_sided: bool  # from 0 to the limit; or else from minus the limit
    unit: float = 1.0  # value that is a hundred per cent

    @property
    def low(self) -> float:
        """Lower end."""
        return 0.0 if self.one_sided else -self.limit

    @property
    def percent(self) -> float:
        """Strongest colour in per cent."""
        return 100 * self.limit / self.unit


def colour_range(record: Record, views: Sequence[View]) -> ColourRange:
    """Return the range of the colours of some views: about zero, or from it where no value can be below.

    It goes to the 99th percentile of the magnitudes, and no less far than FLOOR. Lengths are shown in per cent of the
    largest motion.
    """
    unit = (motion_of(record) or 1.0) if operation_of(record.case.operation).error_is_length else 1.0
    values = np.concatenate([view.values[np.isfinite(view.values)] for view in views] or [np.zeros(0)])
    limit = max(colour_limit(views), FLOOR * unit) if values.size else FLOOR * unit
    one_sided = not operation_of(record.case.operation).error_is_length and bool((values >= 0).all())
    return ColourRange(limit, one_sided, unit)


def colour_limit(views: Sequence[View]) -> float:
    """Half the width of a colour range about zero that the views share: the 99th percentile of what is there.

    The largest single value is often one vertex at a sharp edge, and would leave the rest without colour.
    """
    values = np.abs(np.concatenate([view.values[np.isfinite(view.values)] for view in views]))
    limit = float(np.quantile(values, 0.99))
    return limit if limit > 0 else float(values.max()) or 1.0


# Of a camera at azimuth 0: what is to the right, what is up, and what is towards the viewer, for each axis that is up.
_BASES = {
    "x": ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
}


@dataclass(frozen=True)
class Camera:
    """A viewpoint that looks at the middle of the shape with one axis up."""

    azimuth: float  # degrees about the axis that is up; with y up, 0 looks along -z
    elevation: float = ELEVATION  # degrees above the horizon
    up: Up = "y"

    def axes(self) -> Float[ndarray, "3 3"]:
        """Right, up and towards the viewer, as rows."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        aside, upwards, towards = np.array(_BASES[self.up])
        back = np.sin(a) * np.cos(e) * aside + np.sin(e) * upwards + np.cos(a) * np.cos(e) * towards
        right = np.cos(a) * aside - np.sin(a) * towards
        return np.stack([right, np.cross(back, right), back])
