"""One HTML file that shows a run: it opens offline and holds all it needs.

Each case has three views in 3D, before, neural field and mesh, whose cameras move together, with one colour range
about zero, and its curves over the steps. A browser keeps about 16 drawing contexts, so views are made when they scroll
into sight, for the nearest few cases at a time, and dropped when they leave it. The files of the run folder are linked
beside each case.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from compare.cases.labels import labels
from compare.files import plain, replace_file
from compare.reports.report_parts import CHARTS, curves_of, failures_of, section_of, seen_from, summary_of, table_of
from compare.runs.records import Record

# Bytes of a face in all three views of a case: 3 corners of 2 bytes, half a vertex of 12 and a value of 4, in base64;
# and what a report may use of them.
BYTES_PER_FACE = 56
BUDGET = 3_600_000

# Faces of a view: more cannot be told apart in a pane, and with fewer a shape is no longer itself.
MOST_FACES, LEAST_FACES = 20_000, 1000

# The page has one light, from the upper front, so shapes are turned to show it the side that counts.
AZIMUTH = 25.0


def report(records: Sequence[Record], path: str | PathLike[str], *, folder: str | PathLike[str] | None = None) -> Path:
    """Write the report of some records.

    The page stays below 10 MB: views get coarser the more cases there are, and beyond 64 cases the later ones have
    their row, curves and files, but no views. Cases without meshes have a row and curves.

    Args:
        records: Of a run, failed ones among them.
        path: The HTML file, replaced if it is there.
        folder: The run folder that holds their meshes; None is where the report goes. Files are linked relative to the
            page, so the two are to be moved together.

    Returns:
        The path.

    Raises:
        FileNotFoundError: A mesh that a record names is gone.
        ValueError: There are no records.
    """
    if not records or not isinstance(records, list | tuple):
        raise ValueError(f"A report needs at least one record, but records are {records!r:.100}. Run a case first.")
    if not all(isinstance(record, Record) for record in records):
        raise TypeError(f"records must be Records, as run_cases gives them, but are {records!r:.100}.")
    path = Path(path)
    folder = path.parent if folder is None else Path(folder)
    page = Template((Path(__file__).parent / "report.html").read_text(encoding="utf-8"))
    arrays: dict[str, str] = {}
    done = [r for r in records if r.sides]  # of a failed one, the side that has numbers
    drawn = [r for r in done if {"implicit", "mesh"} <= set(r.artefacts)][: BUDGET // (BYTES_PER_FACE * LEAST_FACES)]
    faces = int(np.clip(BUDGET / BYTES_PER_FACE / max(len(drawn), 1), LEAST_FACES, MOST_FACES))
    views = {r.key: _scene(r, folder, faces, arrays, azimuth) for r, azimuth in _looks(drawn, folder)}
    base = seen_from(path, folder)
    content = page.substitute(
        plotly=_plotly(),
        summary=summary_of(records, base),
        table=table_of(done),
        cases="\n".join(
            section_of(record, k, setting, base, record.key in views)
            for k, (record, setting) in enumerate(zip(done, labels([r.case for r in done]), strict=True))
        ),
        failures=failures_of(records),
        data=_script_json(
            {
                "cases": [{"views": views.get(r.key), "curves": curves_of(r)} for r in done],
                "charts": CHARTS,
                "arrays": arrays,
                "colours": _colour_scale(),
            }
        ),
    )
    replace_file(path, content.encode("utf-8"))
    return path


def _looks(records: Sequence[Record], folder: Path) -> list[tuple[Record, float]]:
    """Return each record with the direction to look from, the same for all of one shape."""
    from compare.reports.views import azimuth_of

    of_shape = {name: [r for r in records if r.case.name == name] for name in {r.case.name for r in records}}
    azimuth = {name: azimuth_of(group, folder) for name, group in of_shape.items()}
    return [(record, azimuth[record.case.name]) for record in records]


def _scene(record: Record, folder: Path, faces: int, arrays: dict[str, str], azimuth: float) -> dict[str, Any]:
    """Return what the browser needs to draw a case."""
    from compare.reports.views import View, colour_limit, load_views, simplified

    views = {name: simplified(view, faces) for name, view in load_views(record, folder).items()}
    turn = _about_y(AZIMUTH - azimuth)
    views = {name: View(view.V @ turn.T, view.F, view.values) for name, view in views.items()}
    limit = colour_limit([views["implicit"], views["mesh"]])
    every = np.concatenate([view.V for view in views.values()])
    lower, upper = every.min(axis=0), every.max(axis=0)
    middle, side = (lower + upper) / 2, (upper - lower).max()
    panes = {}
    for name, view in views.items():
        # Relative to the middle of the scene, so that single precision is enough wherever the mesh lies.
        points = ((view.V - middle) / side).astype("<f4")
        panes[name] = {
            "points": _keep(arrays, points.T),
            "faces": _keep(arrays, view.F.T.astype("<u4" if len(view.V) > 65535 else "<u2")),
            "wide": len(view.V) > 65535,
            "values": _keep(arrays, view.values.astype("<f4")),
        }
    holds = [handle.holds for handle in record.case.handles]
    half = (upper - lower) / side / 2 * 1.04
    return {"panes": panes, "limit": limit, "holds": holds, "half": half.tolist()}


def _about_y(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _keep(arrays: dict[str, str], array: np.ndarray) -> str:
    """Store an array once, however many views use it, and return its name."""
    content = np.ascontiguousarray(array).tobytes()
    name = hashlib.sha256(content).hexdigest()[:12]
    arrays[name] = base64.b64encode(content).decode()
    return name


def _colour_scale() -> list[tuple[float, str]]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    from compare.reports.figures import COLOURS

    return [(float(t), to_hex(colormaps[COLOURS](t))) for t in np.linspace(0, 1, 17)]


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _script_json(value: Any) -> str:
    """JSON that may stand in a script element, whatever it holds."""
    return json.dumps(plain(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
