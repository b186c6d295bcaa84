"""The three meshes of a record as one looks at them: before, the neural result, the mesh result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import cKDTree

import meshref
from compare.runs.records import Record

PANES = {"before": "before", "implicit": "neural field", "mesh": "mesh"}
ELEVATION = 20.0  # degrees above the horizon, of the first look at a shape


@dataclass(frozen=True, eq=False)
class View:
    """A mesh with one number a vertex."""

    V: Float[ndarray, "n 3"]
    F: Int[ndarray, "m 3"]
    values: Float[ndarray, " n"]


def load_views(record: Record, folder: Path) -> dict[str, View]:
    """Return the views of a record, in the order of PANES; empty for a failed record.

    Raises:
        FileNotFoundError: A file that the record names is gone.
    """
    return {name: read_view(folder / record.artefacts[name].path) for name in PANES if name in record.artefacts}


def read_view(path: Path) -> View:
    """Return a binary .ply with a vertex quality, as run_case writes it.

    Raises:
        FileNotFoundError: There is no such file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"There is no {path}, though results.jsonl names it. Run the case again.")
    V, F = meshref.read_mesh(path)
    content = path.read_bytes()
    header, body = content.split(b"end_header\n", 1)
    columns = [line.split()[-1] for line in header.splitlines() if line.startswith(b"property double")]
    table = np.frombuffer(body, "<f8", count=len(V) * len(columns)).reshape(len(V), len(columns))
    return View(V, F, table[:, columns.index(b"quality")].copy())


def simplified(view: View, faces: int) -> View:
    """Return the view with at most so many faces; each new vertex takes the number of the nearest old one."""
    if len(view.F) <= faces:
        return view
    import igl

    V, F = igl.qslim(view.V, view.F, faces)[:2]
    V, F = np.ascontiguousarray(V), np.ascontiguousarray(F).astype(np.int64)  # libigl gives long long
    return View(V, F, view.values[cKDTree(view.V).query(V)[1]])


def azimuth_of(records: Sequence[Record], folder: Path) -> float:
    """Degrees about the y axis (0 looks along -z) from where most of what moves is seen, and a little from the side."""
    seen = np.zeros(24)
    angles = np.radians(15 * np.arange(24))
    for record in records:
        moves = [0, *(0 if handle.holds else 1 for handle in record.case.handles)]
        if any(moves):
            view = read_view(folder / record.artefacts["before"].path)
            face = np.array(moves)[view.values.astype(int)][view.F].all(axis=1)
            corners = view.V[view.F[face]]
            areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            towards = np.stack([np.sin(angles), np.zeros(24), np.cos(angles)])
            seen += np.clip(areas @ towards, 0, None).sum(axis=0)
    return float(15 * np.argmax(seen) + 30)


def colour_limit(views: list[View]) -> float:
    """Half the width of a colour range about zero that the views share: the 99th percentile of what is there.

    The largest single value is often one vertex at a sharp edge, and would leave the rest without colour.
    """
    values = np.abs(np.concatenate([view.values for view in views]))
    limit = float(np.quantile(values, 0.99))
    return limit if limit > 0 else float(values.max()) or 1.0


@dataclass(frozen=True)
class Camera:
    """A viewpoint that looks at the middle of the shape with the y axis up."""

    azimuth: float  # degrees about the y axis, 0 looks along -z
    elevation: float = ELEVATION  # degrees above the horizon

    def axes(self) -> Float[ndarray, "3 3"]:
        """Right, up and towards the viewer, as rows."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
        right = np.array([np.cos(a), 0.0, -np.sin(a)])
        return np.stack([right, np.cross(back, right), back])
