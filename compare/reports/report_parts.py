"""The parts of a report's page as HTML: the table, and for each case its views, curves, files, numbers and settings.

What the browser draws goes into empty boxes, which the script of report.html fills when they scroll into sight.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compare.cases.labels import labels
from compare.files import plain
from compare.runs.columns import SIDE_COLOURS, SIDES, columns, error_label, lines, text
from compare.runs.records import FILE, Record

CHARTS = {"volume_drift": "volume, change in %", "area_drift": "area, change in %", "killing_energy": "Killing energy"}

# What a record's files are called for a reader.
FILES = {
    "field": "edited field",
    "before": "mesh before",
    "implicit": "mesh of the edited field",
    "mesh": "edited mesh",
}


def table_of(records: Sequence[Record]) -> str:
    """Return the sortable table: a line for each side of each record, in the order of their sections.

    Where cases have shape and edit in common, as in a study, a column says in which settings they differ.
    """
    differ = labels([record.case for record in records])
    words_of = ["shape", "edit", *(["setting"] if any(differ) else []), "by", "method"]
    names = "".join(f"<th><button>{name}</button></th>" for name in words_of)
    head = "".join(
        f'<th class="number" title="{html.escape(c.explains)}"><button>{html.escape(c.title)}</button></th>'
        for c in columns()
    )
    body = []
    for number, (record, setting) in enumerate(zip(records, differ, strict=True)):
        for shape, operation, side, method, values in lines(record):
            link = f'<a href="#case-{number}">{html.escape(shape)}</a>'
            settings = [setting] if any(differ) else []
            words = "".join(f"<td>{html.escape(word)}</td>" for word in (operation, *settings, side, method))
            cells = "".join(
                f'<td class="number" data-value="{"" if value is None else repr(float(value))}">{text(value, c)}</td>'
                for value, c in zip(values, columns(), strict=True)
            )
            body.append(f"<tr><td>{link}</td>{words}{cells}</tr>")
    return f'<table id="results"><thead><tr>{names}{head}</tr></thead><tbody>{"".join(body)}</tbody></table>'


def section_of(record: Record, number: int, setting: str, base: str, drawn: bool) -> str:
    """Return the section of a case.

    Args:
        record: It, not a failed one.
        number: Of the section.
        setting: In what it differs from others of the same shape and edit.
        base: The run folder as seen from the page.
        drawn: Whether the page has its views.
    """
    case = record.case
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in [record.status, *record.notes])
    return f"""<section class="case" id="case-{number}" data-case="{number}">
<h2>{html.escape(case.name)}: {html.escape(case.operation)}{html.escape(f", {setting}" if setting else "")}</h2>
{_views(record) if drawn else _without_views(record)}
{_charts(record)}
<ul>{notes}</ul>
{_files(record, base)}
<details><summary>All numbers</summary>{_numbers(record)}</details>
<details><summary>Settings and origin</summary>{_settings(record)}</details>
</section>"""


def failures_of(records: Sequence[Record]) -> str:
    """Return the list of failed cases with their reasons, if there are any."""
    rows = "".join(
        f"<li>{html.escape(r.case.name)}, {html.escape(r.case.operation)}: {html.escape(r.status)}</li>"
        for r in records
        if r.failed
    )
    return f"<h2>Failed</h2><ul>{rows}</ul>" if rows else ""


def summary_of(records: Sequence[Record], base: str) -> str:
    """Return how many cases of how many shapes, when and where, and where the rows are."""
    origin = records[0].provenance
    shapes = {r.case.name for r in records}
    words = f"{len(records)} case{'s' * (len(records) != 1)} on {len(shapes)} shape{'s' * (len(shapes) != 1)}; "
    words += f"{origin.get('time', '')}, {origin.get('processor', '')}, "
    words += f"threads: {origin.get('threads', '')}, Python {origin.get('python', '')}."
    return f'{html.escape(words)} All rows: <a href="{_href(base, FILE)}" download>{FILE}</a>.'


def curves_of(record: Record) -> list[dict[str, Any]]:
    """Return what the charts of a record show, a line for each side; drifts in percent."""
    lines = []
    for side, row in record.sides.items():
        rows = row.get("curve", [])
        if rows:
            values = {
                name: [None if at[name] is None else at[name] * (100 if name.endswith("drift") else 1) for at in rows]
                for name in CHARTS
            }
            lines.append({"name": SIDES.get(side, side), "colour": SIDE_COLOURS.get(side, "#555555"), "values": values})
    return lines


def seen_from(page: Path, folder: Path) -> str:
    """Return the folder's address relative to that of the page; absolute where there is none, as on another drive."""
    try:
        return Path(os.path.relpath(folder, page.absolute().parent)).as_posix()
    except ValueError:
        return folder.absolute().as_uri()


def _views(record: Record) -> str:
    panes = "".join(
        f'<figure><div class="pane" data-pane="{name}"></div><figcaption>{html.escape(title)}</figcaption></figure>'
        for name, title in _pane_titles(record).items()
    )
    return f"""<div class="panes">{panes}</div>
<div class="bar"><span class="low"></span><span class="gradient"></span><span class="high"></span>
<span class="means">{html.escape(error_label(record))}</span></div>"""


def _without_views(record: Record) -> str:
    if record.artefacts:
        return '<p class="aside">Not drawn, or the page would grow too large; the files below open in any viewer.</p>'
    return '<p class="aside">No meshes were kept of this case.</p>'


def _pane_titles(record: Record) -> dict[str, str]:
    held = any(handle.holds for handle in record.case.handles)
    before = "before" if not record.case.handles else f"before; orange moves{', blue is held' if held else ''}"
    return {
        "before": before,
        "implicit": f"neural field: {record.sides['implicit'].method}",
        "mesh": f"mesh: {record.sides['mesh'].method}",
    }


def _charts(record: Record) -> str:
    curves = curves_of(record)
    if not curves:
        return ""
    boxes = "".join(f'<div class="chart" data-chart="{name}"></div>' for name in CHARTS)
    keys = "".join(
        f'<span><i style="border-color:{line["colour"]};border-top-style:{"solid" if _steps(line) > 1 else "dashed"}">'
        f"</i>{html.escape(line['name'])}{'' if _steps(line) > 1 else ', one solve'}</span>"
        for line in curves
    )
    return f'<div class="charts">{boxes}</div><div class="key">Over the steps: {keys}</div>'


def _steps(line: Mapping[str, Any]) -> int:
    return len(line["values"]["killing_energy"]) - 1


def _files(record: Record, base: str) -> str:
    links = ", ".join(
        f'<a href="{_href(base, artefact.path)}" download>{FILES[name]}</a> ({Path(artefact.path).suffix})'
        for name, artefact in record.artefacts.items()
    )
    return f'<p class="files">Files: {links}.</p>' if links else ""


def _href(base: str, path: str) -> str:
    # A colon would read as a scheme and a percent sign as an escape, whatever the folders are called.
    return html.escape(f"{base}/{quote(path)}" if base.startswith("file:") else quote(f"{base}/{path}"))


def _numbers(record: Record) -> str:
    numbers = {
        side: {
            **{k: v for k, v in row.items() if _is_number(v)},
            **{f"seconds, {phase}": v for phase, v in row.get("seconds_by_phase", {}).items()},
        }
        for side, row in record.sides.items()
    }
    names = list(dict.fromkeys(name for column in numbers.values() for name in column))
    head = "".join(f'<th class="number">{html.escape(SIDES.get(side, side))}</th>' for side in numbers)
    body = "".join(
        f"<tr><td>{html.escape(name)}</td>"
        + "".join(f'<td class="number">{_figure(column.get(name))}</td>' for column in numbers.values())
        + "</tr>"
        for name in names
    )
    both = "".join(
        f'<tr><td>{html.escape(name)}</td><td class="number">{_figure(v)}</td></tr>'
        for name, v in record.between.items()
    )
    shared = "".join(
        f'<tr><td>{html.escape(name)}</td><td class="number">{_figure(v)}</td></tr>'
        for name, v in record.seconds.items()
    )
    return f"""<div class="tables"><table><thead><tr><th>of each</th>{head}</tr></thead><tbody>{body}</tbody></table>
<table><thead><tr><th>neural and mesh result</th><th></th></tr></thead><tbody>{both}</tbody>
<thead><tr><th>seconds of what they share</th><th></th></tr></thead><tbody>{shared}</tbody></table></div>
<p class="aside">Lengths, areas, volumes and energies are in the shape's own units; docs/metrics.md defines each.</p>"""


def _settings(record: Record) -> str:
    settings = html.escape(json.dumps(plain(record.case.to_dict()), indent=1))
    origin = html.escape(json.dumps(plain(record.provenance), indent=1))
    return f"""<p>Handles are in the field's coordinates; one unit of them is {record.subject.scale:.6g} of the
shape's own.</p><pre>{settings}</pre><pre>{origin}</pre>"""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _figure(value: float | None) -> str:
    return "" if value is None else str(value) if isinstance(value, int) else f"{value:.4g}"
