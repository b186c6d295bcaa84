"""One HTML file that shows a run or a study: it opens offline and holds all it needs.

It begins with findings in sentences, then numbers by kind of edit, then for each case its meshes in 3D, before and by
every method, with the outline of what was before, on one colour range, and its curves. All views of the page share one
drawing context and one camera a case. Vertices are sent as 16-bit whole numbers within the box of their mesh, values as
16-bit ones of the largest. The files of the run folder are linked beside each case.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from html import escape
from os import PathLike
from pathlib import Path
from string import Template
from typing import Any, cast

import numpy as np

from compare.cases.labels import labels
from compare.files import plain, replace_file
from compare.operations.operation import operation_of
from compare.reports.arrows import arrows_of, with_handles_in_field
from compare.reports.report_parts import (
    charted_of,
    failures_of,
    findings_of,
    links_of,
    section_of,
    seen_from,
    summary_of,
    tables_of,
)
from compare.runs.records import Record

# Bytes of a face in all views of a case, in base64: half a vertex of 6 bytes and a value of 2 for each method, 3
# corners of 2 bytes for each of the two meshes; and what a report may use of them.
BYTES_PER_FACE = 56
BUDGET = 6_000_000

# Faces of a view: more cannot be told apart in a pane, and with fewer a shape is no longer itself.
MOST_FACES, LEAST_FACES = 12_000, 1000

# Beyond so many cases a section has no list of all numbers and settings, or the page would grow too large.
MOST_IN_FULL = 150

NO_VALUE = -32768  # of a vertex that has none, among 16-bit values


def report(
    records: Sequence[Record],
    path: str | PathLike[str],
    *,
    folder: str | PathLike[str] | None = None,
    title: str | None = None,
    up: str = "auto",
) -> Path:
    """Write the report of some records.

    The page stays below 10 MB: views get coarser the more cases there are, and beyond a hundred cases the later ones
    have their row, curves and files, but no views. Cases without meshes have a row and curves.

    Args:
        records: Of a run or a study, failed ones among them.
        path: The HTML file, replaced if it is there.
        folder: The run folder that holds their meshes; None is where the report goes. Files are linked relative to the
            page, so the two are to be moved together. Charts in the folder of a study are shown on top.
        title: Of the page; None is the title of the study that the folder holds, or that of any run.
        up: Axis that points up: "x", "y", "z", or "auto", which is z for .stl and .3mf and y for all else. The page
            has buttons to change it.

    Returns:
        The path.

    Raises:
        FileNotFoundError: A mesh that a record names is gone.
        ValueError: There are no records, or up is another word.
    """
    if not records or not isinstance(records, list | tuple):
        raise ValueError(f"A report needs at least one record, but records are {records!r:.100}. Run a case first.")
    if not all(isinstance(record, Record) for record in records):
        raise TypeError(f"records must be Records, as run_cases gives them, but are {records!r:.100}.")
    if up not in ("auto", "x", "y", "z"):
        raise ValueError(f'up must be "auto", "x", "y" or "z", but is {up!r}.')
    records = [with_handles_in_field(record) for record in records]
    path = Path(path)
    folder = path.parent if folder is None else Path(folder)
    place = Path(__file__).parent
    page, style, script = ((place / f"report.{kind}").read_text(encoding="utf-8") for kind in ("html", "css", "js"))
    arrays: dict[str, str] = {}
    done = [r for r in records if r.sides]  # of a failed one, the sides that have numbers
    drawn = [r for r in done if _can_be_drawn(r)][: BUDGET // (BYTES_PER_FACE * LEAST_FACES)]
    faces = int(np.clip(BUDGET / BYTES_PER_FACE / max(len(drawn), 1), LEAST_FACES, MOST_FACES))
    scenes = {r.key: _scene(r, folder, faces, arrays, azimuth, axis) for r, azimuth, axis in _looks(drawn, folder, up)}
    base, settings = seen_from(path, folder), labels([r.case for r in done])
    found = title or _study_title(folder) or "Neural field and mesh, side by side"
    content = Template(page).substitute(
        title=escape(found),
        style=style,
        summary=summary_of(records, base, folder),
        links=links_of(done),
        charts=charted_of(folder),
        failures=failures_of(records),
        findings=findings_of(done, set(scenes)),
        tables=tables_of(done, settings),
        cases="\n".join(
            section_of(record, k, setting, base, scenes.get(record.key), in_full=len(done) <= MOST_IN_FULL)
            for k, (record, setting) in enumerate(zip(done, settings, strict=True))
        ),
        data=_script_json({"cases": [scenes.get(r.key) for r in done], "arrays": arrays, "colours": _colour_scales()}),
        script=script,
    )
    replace_file(path, content.encode("utf-8"))
    return path


def _can_be_drawn(record: Record) -> bool:
    return "before" in record.artefacts and any(side in record.artefacts for side in record.sides)


def _study_title(folder: Path) -> str | None:
    """Return the title of the study that a folder holds."""
    try:
        study = json.loads((folder / "study.json").read_text(encoding="utf-8"))["study"]
        return str(study.get("title") or study.get("name") or "") or None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # a run, which has no title


def _looks(records: Sequence[Record], folder: Path, up: str) -> list[tuple[Record, float, Any]]:
    """Return each record with the direction to look from and the axis that is up.

    A case without handles is seen as the others of its shape.
    """
    from compare.reports.azimuth import azimuth_of
    from compare.reports.views import Up, up_of

    found, of_shape = [], {}
    for record in records:
        shape = record.case.shape
        axis = up_of(shape) if up == "auto" else cast(Up, up)
        if not record.case.handles and shape not in of_shape:
            group = [other for other in records if other.case.shape == shape and other.case.handles]
            of_shape[shape] = azimuth_of(group[:1], folder, axis)
        azimuth = azimuth_of([record], folder, axis) if record.case.handles else of_shape[shape]
        found.append((record, azimuth, axis))
    return found


def _scene(record: Record, folder: Path, faces: int, arrays: dict[str, str], azimuth: float, up: Any) -> dict[str, Any]:
    """Return what the browser needs to draw a case."""
    from compare.reports.views import ELEVATION, colour_range, load_views, simplified, simplified_alike

    loaded = load_views(record, folder)
    arrows = arrows_of(record, loaded["before"])
    # Methods of the mesh move one and the same mesh, and are drawn with the same faces.
    alike = [name for name, view in loaded.items() if np.array_equal(view.F, loaded["before"].F)]
    views = dict(zip(alike, simplified_alike([loaded[name] for name in alike], faces), strict=True))
    views = {name: views[name] if name in views else simplified(view, faces) for name, view in loaded.items()}
    results = [view for name, view in views.items() if name != "before"]
    colours = colour_range(record, results)
    every = np.concatenate([view.V for view in views.values()])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    radius = float(np.linalg.norm(every - middle, axis=1).max())
    top = max((float(np.nanmax(np.abs(v.values))) for v in results if np.isfinite(v.values).any()), default=0.0) or 1.0
    panes = {}
    for name, view in views.items():
        lower, size = view.V.min(axis=0), np.maximum(np.ptp(view.V, axis=0), 1e-300)
        wide = len(view.V) > 65535
        values = view.values if name == "before" else 32767 * view.values / top
        panes[name] = {
            "points": _keep(arrays, np.round(65535 * (view.V - lower) / size).astype("<u2")),
            "faces": _keep(arrays, view.F.astype("<u4" if wide else "<u2")),
            "wide": wide,
            "values": _keep(arrays, np.round(np.where(np.isfinite(values), values, NO_VALUE)).astype("<i2")),
            "lower": ((lower - middle) / radius).tolist(),
            "size": (size / radius).tolist(),
        }
    return {
        "shape": record.case.shape,
        "panes": panes,
        "limit": colours.limit,
        "oneSided": colours.one_sided,
        "unit": colours.unit,
        "isLength": operation_of(record.case.operation).error_is_length,
        "top": top,
        "holds": [handle.holds for handle in record.case.handles],
        "arrows": [[((end - middle) / radius).tolist() for end in pair] for pair in arrows],
        "azimuth": azimuth,
        "elevation": ELEVATION,
        "up": up,
    }


def _keep(arrays: dict[str, str], array: np.ndarray) -> str:
    """Store an array once, however many views use it, and return its name."""
    content = np.ascontiguousarray(array).tobytes()
    name = hashlib.sha256(content).hexdigest()[:12]
    arrays[name] = base64.b64encode(content).decode()
    return name


def _colour_scales() -> dict[str, list[list[float]]]:
    """Return the colours of the two kinds of range, from the low end to the high one."""
    from compare.reports.figures import ABOUT_ZERO, FROM_ZERO, colours_of

    steps = np.linspace(0, 1, 33)
    return {
        "about zero": colours_of(ABOUT_ZERO, steps).round(4).tolist(),
        "from zero": colours_of(FROM_ZERO, steps).round(4).tolist(),
    }


def _script_json(value: Any) -> str:
    """JSON that may stand in a script element, whatever it holds."""
    return json.dumps(plain(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
