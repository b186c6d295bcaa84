"""One HTML file that shows a run: it opens offline and holds all it needs.

Each case has three views in 3D, before, neural field and mesh, whose cameras move together, with one colour range
about zero. A browser keeps about 16 drawing contexts, so views are made when they scroll into sight and dropped when
they leave it.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from compare.records import Record, plain, replace_file
from compare.table import COLUMNS, lines, text

# Bytes of a face with its share of vertices, all three views of a case, in base64; and what a report may use of them.
BYTES_PER_FACE = 45
BUDGET = 4_000_000

# The page has one light, from the upper front, so shapes are turned to show it the side that counts.
AZIMUTH = 25.0


def report(records: Sequence[Record], path: str | PathLike[str], *, folder: str | PathLike[str] | None = None) -> Path:
    """Write the report of some records.

    Args:
        records: Of a run, failed ones among them.
        path: The HTML file, replaced if it is there.
        folder: The run folder that holds their meshes; None is where the report goes.

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
    drawn = [r for r in records if r.artefacts]
    faces = int(np.clip(BUDGET / BYTES_PER_FACE / max(len(drawn), 1), 1000, 20_000))
    scenes = [_scene(record, folder, faces, arrays, azimuth) for record, azimuth in _looks(drawn, folder)]
    content = page.substitute(
        plotly=_plotly(),
        summary=_summary(records),
        table=_table(records),
        cases="\n".join(_section(record, k) for k, record in enumerate(drawn)),
        failures=_failures(records),
        data=_script_json({"scenes": scenes, "arrays": arrays, "colours": _colour_scale()}),
    )
    replace_file(path, content.encode("utf-8"))
    return path


def _looks(records: Sequence[Record], folder: Path) -> list[tuple[Record, float]]:
    """Each record with the direction to look from, the same for all of one shape."""
    from compare.views import azimuth_of

    of_shape = {name: [r for r in records if r.case.name == name] for name in {r.case.name for r in records}}
    azimuth = {name: azimuth_of(group, folder) for name, group in of_shape.items()}
    return [(record, azimuth[record.case.name]) for record in records]


def _scene(record: Record, folder: Path, faces: int, arrays: dict[str, str], azimuth: float) -> dict[str, Any]:
    """What the browser needs to draw a case."""
    from compare.views import View, colour_limit, load_views, simplified

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


def _section(record: Record, number: int) -> str:
    case, scale = record.case, record.subject["scale"]
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in [record.status, *record.notes])
    settings = html.escape(json.dumps(plain(case.to_dict()), indent=1))
    origin = html.escape(json.dumps(plain(record.provenance), indent=1))
    panes = "".join(
        f'<figure><div class="pane" data-pane="{name}"></div><figcaption>{html.escape(title)}</figcaption></figure>'
        for name, title in _pane_titles(record).items()
    )
    means = html.escape(record.subject["error_means"])
    unit = "a pure number" if case.operation == "rigid" else "in the shape's unit of length"
    return f"""<section class="case" id="case-{number}" data-case="{number}">
<h2>{html.escape(case.name)}: {html.escape(case.operation)}</h2>
<div class="panes">{panes}</div>
<div class="bar"><span class="low"></span><span class="gradient"></span><span class="high"></span>
<span class="means">{means}, {unit}</span></div>
<ul>{notes}</ul>
<details><summary>Settings and origin</summary>
<p>Handles are in the field's coordinates; one unit of them is {scale:.6g} of the shape's own.</p>
<pre>{settings}</pre><pre>{origin}</pre></details>
</section>"""


def _pane_titles(record: Record) -> dict[str, str]:
    held = any(handle.holds for handle in record.case.handles)
    before = "before" if not record.case.handles else f"before; orange moves{', blue is held' if held else ''}"
    return {
        "before": before,
        "implicit": f"neural field: {record.sides['implicit']['method']}",
        "mesh": f"mesh: {record.sides['mesh']['method']}",
    }


def _table(records: Sequence[Record]) -> str:
    head = "".join(f'<th class="number" title="{html.escape(c.explains)}">{html.escape(c.title)}</th>' for c in COLUMNS)
    body = []
    for record in records:
        for shape, operation, side, method, values in lines(record):
            words = "".join(f"<td>{html.escape(word)}</td>" for word in (shape, operation, side, method))
            numbers = "".join(
                f'<td class="number" data-value="{"" if value is None else repr(float(value))}">{text(value, c)}</td>'
                for value, c in zip(values, COLUMNS, strict=True)
            )
            body.append(f"<tr>{words}{numbers}</tr>")
    names = "<th>shape</th><th>edit</th><th>by</th><th>method</th>"
    return f'<table id="results"><thead><tr>{names}{head}</tr></thead><tbody>{"".join(body)}</tbody></table>'


def _failures(records: Sequence[Record]) -> str:
    failed = [r for r in records if r.failed]
    rows = "".join(
        f"<li>{html.escape(r.case.name)}, {html.escape(r.case.operation)}: {html.escape(r.status)}</li>" for r in failed
    )
    return f"<h2>Failed</h2><ul>{rows}</ul>" if failed else ""


def _summary(records: Sequence[Record]) -> str:
    origin = records[0].provenance
    shapes = {r.case.name for r in records}
    words = f"{len(records)} cases on {len(shapes)} shapes; {origin.get('time', '')}, {origin.get('processor', '')}, "
    words += f"{origin.get('threads', '')} threads, Python {origin.get('python', '')}."
    return html.escape(words)


def _colour_scale() -> list[tuple[float, str]]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    from compare.figures import COLOURS

    return [(float(t), to_hex(colormaps[COLOURS](t))) for t in np.linspace(0, 1, 17)]


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _script_json(value: Any) -> str:
    """JSON that may stand in a script element, whatever it holds."""
    return json.dumps(plain(value), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
