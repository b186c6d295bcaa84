"""The parts of a report's page as HTML: findings, tables, and for each case its views, curves, files and numbers.

What the browser draws goes into empty canvases, which the script of report.js fills when they scroll into sight.
"""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compare.cases.labels import flat
from compare.files import plain
from compare.operations.operation import Column, operation_of
from compare.reports.charts import Line, chart
from compare.reports.findings import finding, range_of
from compare.reports.table import FILE as TABLE_FILE
from compare.reports.views import drawn_sides, motion_of
from compare.reports.words import handle_in_words, length
from compare.runs.columns import SIDE_COLOURS, SIDES, column_of, columns, duration, number, text
from compare.runs.records import FILE, Record

CHARTS = {
    "volume_drift": "volume, change in %",
    "area_drift": "area, change in %",
    "killing_energy": "Killing energy, length²",
}
HELD = 0.01  # per cent within which a drift is a level line in a chart

HEADS = {"seconds": "time", "peak_memory": "memory"}  # where a unit stands below the title
# Numbers and their estimated errors, which stand below them in small.
ESTIMATES = {"volume_drift": "volume_error", "area_drift": "area_error"}
OTHER_COLOUR = "#777777"
HINT = "Drag to turn, Shift and drag to shift, Ctrl and wheel to zoom; all pictures of a case follow."
WITH_PICTURES = 24  # findings shown at once; the rest one click away
NOTES_OF_A_CARD = 3

# What a record's files are called for a reader, where it is not a side's name.
FILES = {"field": "edited field", "before": "mesh before", "implicit": "mesh of the edited field"}


def summary_of(records: Sequence[Record], base: str, folder: Path) -> str:
    """Return how many cases of how many shapes, when and where, and where the rows are."""
    origin = records[0].provenance
    shapes = {r.case.name for r in records}
    words = f"{_count(len(records), 'case')} on {_count(len(shapes), 'shape')}"
    day = str(origin.get("time", ""))[:16].replace("T", " ")
    threads = origin.get("threads")
    told = [day, origin.get("processor"), None if threads is None else _count(threads, "thread")]
    told += [f"Python {origin['python']}"] if origin.get("python") else []
    words += "".join(f", {one}" for one in told if one)
    files = [FILE, *([TABLE_FILE] if (folder / TABLE_FILE).is_file() else [])]
    links = " and ".join(f'<a href="{_href(base, name)}" download>{name}</a>' for name in files)
    return f"{escape(words)}. All rows: {links}. Lengths, areas and energies are in the units of the shape's file."


def links_of(records: Sequence[Record]) -> str:
    """Return links to the parts of the page."""
    first: dict[str, int] = {}
    for k, record in enumerate(records):
        first.setdefault(record.case.name, k)
    shapes = "".join(f'<a href="#case-{k}">{escape(name)}</a>' for name, k in list(first.items())[:12])
    return f'<a href="#findings">Findings</a><a href="#numbers">Numbers</a>{shapes}'


def charted_of(folder: Path) -> str:
    """Return the charts that a study's folder holds, as pictures in the page."""
    if not (folder / "study.json").is_file():
        return ""
    found: dict[str, Path] = {}
    for path in [*sorted(folder.glob("*.svg")), *sorted(folder.glob("*.png"))]:  # the sharper first
        if path.stat().st_size < 1_000_000:
            found.setdefault(path.stem, path)
    kinds = {".png": "image/png", ".svg": "image/svg+xml"}
    pictures = "".join(
        f'<img alt="{escape(stem.replace("-", " "))} of the study" '
        f'src="data:{kinds[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}">'
        for stem, path in sorted(found.items(), key=lambda item: (item[0] != "chart", item[0]))
    )
    return f'<section class="charted">{pictures}</section>' if pictures else ""


def failures_of(records: Sequence[Record]) -> str:
    """Return the list of failed cases with their reasons, if there are any."""
    rows = "".join(
        f"<li>{escape(r.case.name)}, {escape(r.case.operation)}: {escape(r.status)}</li>" for r in records if r.failed
    )
    return f'<div class="failed"><h3>Failed</h3><ul>{rows}</ul></div>' if rows else ""


def findings_of(records: Sequence[Record], drawn: set[str]) -> str:
    """Return a card for each shape and edit, with sentences and a picture.

    Args:
        records: In the order of their sections.
        drawn: Keys of those whose views the page has.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for k, record in enumerate(records):
        groups.setdefault((record.case.name, record.case.operation), []).append(k)
    cards = [_card(records, numbers, drawn) for numbers in groups.values()]
    shown, more = "".join(cards[:WITH_PICTURES]), "".join(cards[WITH_PICTURES:])
    rest = f'<details><summary>{len(cards) - WITH_PICTURES} more</summary><div class="findings">{more}</div></details>'
    return f'<div class="findings">{shown}</div>{rest if more else ""}'


def _card(records: Sequence[Record], numbers: Sequence[int], drawn: set[str]) -> str:
    record, k = records[numbers[0]], numbers[0]
    found, picture = finding(record), ""
    if record.key in drawn:
        pane = next((side for side in drawn_sides(record)), "before")
        said = escape(f"{record.case.name} after the {record.case.operation} edit")
        picture = (
            f'<a href="#case-{k}"><canvas class="thumb" role="img" aria-label="{said}" data-case="{k}" '
            f'data-pane="{escape(pane)}"></canvas></a>'
        )
    came = found.came if len(numbers) == 1 else range_of([records[n] for n in numbers])
    cost = found.cost if len(numbers) == 1 else ""
    notes = "".join(f"<li>{_prose(note)}</li>" for note in found.mind[:NOTES_OF_A_CARD])
    more = len(found.mind) - NOTES_OF_A_CARD
    notes += f'<li><a href="#case-{k}">{_count(more, "further note")}</a></li>' if more > 0 else ""
    return f"""<article class="finding{"" if picture else " bare"}">{picture}<div>
<h3><a href="#case-{k}">{escape(record.case.name)}: {escape(record.case.operation)}</a></h3>
<p class="asked">{_prose(found.asked)}</p><p class="came">{_prose(came)}</p><p class="cost">{_prose(cost)}</p>
{f'<ul class="mind">{notes}</ul>' if notes else ""}</div></article>"""


def tables_of(records: Sequence[Record], settings: Sequence[str]) -> str:
    """Return a sortable table for each kind of edit, with the columns that have numbers there.

    Args:
        records: In the order of their sections.
        settings: Of each, in which it differs from others of its shape and edit.
    """
    kinds = dict.fromkeys(record.case.operation for record in records)
    return "\n".join(
        _table(kind, [(k, r, settings[k]) for k, r in enumerate(records) if r.case.operation == kind]) for kind in kinds
    )


def _table(kind: str, rows: Sequence[tuple[int, Record, str]]) -> str:
    shown = [
        c
        for c in columns()
        if c.name not in ESTIMATES.values()
        and any(number(row, c) is not None for _, r, _ in rows for row in r.sides.values())
    ]
    with_settings = any(setting for _, _, setting in rows)
    words = ["shape", *(["setting"] if with_settings else []), "by"]
    head = "".join(f"<th><button>{word}</button></th>" for word in words)
    head += "".join(
        f'<th class="number" title="{escape(c.explains)}"><button>{escape(_head(c))}'
        f"<small>{escape(c.unit or '1')}</small></button></th>"
        for c in shown
    )
    body = "".join(_row(one, shown, with_settings, side) for one in rows for side in one[1].sides)
    meanings = "".join(
        f"<dt>{escape(_head(c))} [{escape(c.unit or '1')}]</dt><dd>{escape(c.explains)}</dd>" for c in shown
    )
    means = operation_of(kind).error_means
    meanings += f"<dt>colours</dt><dd>{_prose(means)}</dd>" if means else ""
    meanings += "<dt>all others</dt><dd>docs/metrics.md has every number with its formula, unit and source</dd>"
    return f"""<h3 class="edit">{escape(kind)}</h3><div class="table"><p class="more-columns"></p>
<div class="scroll"><table class="results" data-kind="{escape(kind)}">
<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>
<details class="meanings"><summary>What the columns mean</summary>
<dl class="definitions">{meanings}</dl></details></div>"""


def _row(one: tuple[int, Record, str], shown: Sequence[Column], with_settings: bool, side: str) -> str:
    k, record, setting = one
    row, first = record.sides[side], next(iter(record.sides)) == side
    link = f'<td{"" if first else " class=again"}><a href="#case-{k}">{escape(record.case.name)}</a></td>'
    words = [f'<td class="words">{escape(setting)}</td>'] if with_settings else []
    title = escape(f"{row.get('method', '')}. {row.get('status', '')}")
    words.append(f'<td title="{title}">{_swatch(side)}{escape(SIDES.get(side, side))}</td>')
    cells = "".join(
        f'<td class="number" data-value="{"" if value is None else repr(float(value))}"'
        f'{"" if value is None else f""" title="{value:.6g}" """}>'
        f"{escape(_in_column(value, c))}{_known_to(row, c)}</td>"
        for c in shown
        for value in [number(row, c)]
    )
    return f"<tr{' class=new' if first else ''}>{link}{''.join(words)}{cells}</tr>"


def _known_to(row: Mapping[str, Any], column: Column) -> str:
    """Return the estimated error of a number, in small below it; nothing where there is none."""
    estimate = column_of(ESTIMATES.get(column.name, ""))
    error = None if estimate is None else number(row, estimate)
    return "" if error is None or estimate is None else f"<small>±{escape(_in_column(error, estimate))}</small>"


def _head(column: Column) -> str:
    return HEADS.get(column.name, column.title)


def _in_column(value: float | None, column: Column) -> str:
    """Return a number without its unit, which the head of the column says."""
    return text(value, column).removesuffix(" %").replace("-", "\u2212")


def _swatch(side: str) -> str:
    colour = SIDE_COLOURS.get(side, OTHER_COLOUR)
    return f'<i class="swatch {escape(side.split(",")[0])}" style="border-color:{colour}"></i>'


def section_of(
    record: Record, number: int, setting: str, base: str, scene: Mapping[str, Any] | None, *, in_full: bool = True
) -> str:
    """Return the section of a case.

    Args:
        record: It, with a side at least.
        number: Of the section.
        setting: In what it differs from others of the same shape and edit.
        base: The run folder as seen from the page.
        scene: What the page has to draw of it; None if nothing.
        in_full: Whether all numbers and settings are listed.
    """
    case, found = record.case, finding(record)
    statuses = "".join(
        f"<li>{escape(SIDES.get(side, side))}: {escape(str(row.get('status', '')))}</li>"
        for side, row in record.sides.items()
    )
    notes = "".join(f"<li>{_prose(note)}</li>" for note in found.mind)
    details = f"""<details><summary>All numbers</summary>{_numbers(record)}</details>
<details><summary>Settings and origin</summary>{_settings(record)}</details>"""
    return f"""<section class="case" id="case-{number}" data-case="{number}">
<h2>{escape(case.name)}: {escape(case.operation)}{escape(f", {setting}" if setting else "")}</h2>
<p>{_prose(found.asked)} {_prose(found.came)}</p>
{_views(record, number, scene) if scene is not None else _without_views(record)}
{_charts(record)}
{f'<ul class="mind">{notes}</ul>' if notes else ""}
<details class="ended"><summary>How each method ended</summary><ul>{statuses}</ul></details>
{_files(record, base)}
{details if in_full else ""}
</section>"""


def curves_of(record: Record) -> dict[str, list[Line]]:
    """Return what the charts of a record show, a line for each side; drifts in per cent."""
    found: dict[str, list[Line]] = {name: [] for name in CHARTS}
    for side, row in record.sides.items():
        rows = row.get("curve", [])
        if rows:
            for name, lines in found.items():
                unit = 100 if name.endswith("drift") else 1
                values = [None if at.get(name) is None else at[name] * unit for at in rows]
                lines.append(Line(SIDES.get(side, side), SIDE_COLOURS.get(side, OTHER_COLOUR), values))
    return {name: lines for name, lines in found.items() if lines}


def seen_from(page: Path, folder: Path) -> str:
    """Return the folder's address relative to that of the page; absolute where there is none, as on another drive."""
    try:
        return Path(os.path.relpath(folder, page.absolute().parent)).as_posix()
    except ValueError:
        return folder.absolute().as_uri()


def _views(record: Record, number: int, scene: Mapping[str, Any]) -> str:
    names = drawn_sides(record, before=True)
    panes = "".join(
        f'<figure><canvas class="pane" tabindex="0" role="img" aria-label="{escape(_pane_title(name))} of '
        f'{escape(record.case.name)} in 3D" data-case="{number}" data-pane="{escape(name)}"></canvas>'
        f"<figcaption>{_caption(record, name)}</figcaption></figure>"
        for name in names
    )
    across = 4 if len(names) in (4, 7, 8) else min(len(names), 3)
    narrow = 2 if len(names) in (2, 4) else 3
    ups = "".join(f'<button data-up="{axis}" aria-pressed="false">{axis}</button>' for axis in "xyz")
    return f"""<div class="tools"><span>{HINT}</span>
<button class="reset">Reset the view</button><span>Up is {ups}</span><span class="said" role="status"></span></div>
<div class="panes{" four" if across == 4 else ""}" style="--across:{across};--across-narrow:{narrow}">{panes}</div>
{_keys(record)}{_bar(record, scene)}"""


def _pane_title(name: str) -> str:
    return {"before": "Before", "implicit": "Neural field"}.get(
        name, SIDES.get(name, name)[:1].upper() + SIDES.get(name, name)[1:]
    )


def _caption(record: Record, name: str) -> str:
    if name == "before":
        return "<b>Before</b><span>the handles, and where they pull</span>" if record.case.handles else "<b>Before</b>"
    row = record.sides[name]
    told = [str(row.get("method", ""))]
    missed = row.get("handle_error_relative")
    if missed is not None:
        column = next(c for c in columns() if c.name == "handle_error_relative")
        told.append(f"missed {text(missed, column)}")
    if row.get("seconds") is not None:
        told.append(f"{duration(row['seconds'])} s")
    return f"<b>{_swatch(name)}{escape(_pane_title(name))}</b><span>{_prose(', '.join(filter(None, told)))}</span>"


def _keys(record: Record) -> str:
    handles = record.case.handles
    moved, held = any(not handle.holds for handle in handles), any(handle.holds for handle in handles)
    said = ['<span><i style="background:#4c72b0"></i>held</span>'] if held else []
    if moved:
        said.append('<span><i style="background:#dd8452"></i>moved</span>')
        said.append('<span><i class="arrow">→</i>where to, to scale</span>')
    said.append('<span><i class="outline"></i>outline of the shape before</span>')
    return f'<div class="keys">{"".join(said)}</div>'


def _bar(record: Record, scene: Mapping[str, Any]) -> str:
    from compare.reports.figures import ABOUT_ZERO, FROM_ZERO, css_gradient

    one_sided, is_length = scene["oneSided"], scene["isLength"]
    percent, limit = 100 * scene["limit"] / scene["unit"], scene["limit"]
    low, middle = ("0", f"{_plain(percent / 2)} %") if one_sided else (f"\u2212{_plain(percent)} %", "0")
    motion, means = motion_of(record), f"{record.subject.get('error_means', '')}."
    strongest = f"{_plain(percent)} %"
    if is_length and motion:
        means += f" A hundred per cent is the largest motion, {length(motion)}."
        strongest += f" ({length(limit)})"
    means += f" The strongest colour is {strongest} and all beyond; no range is narrower than 1 %, so pale is small."
    gradient = css_gradient(FROM_ZERO if one_sided else ABOUT_ZERO)
    high = f"{'' if one_sided else '+'}{_plain(percent)} %"
    ends = f'<span class="low">{low}</span><span>{middle}</span><span class="high">{high}</span>'
    return f"""<div class="bar"><div><div class="gradient" style="background:{gradient}"></div>
<div class="ends">{ends}</div></div><span class="means">Colours: {_prose(means)}</span></div>"""


def _plain(value: float) -> str:
    return f"{float(f'{value:.2g}'):.10g}"


def _without_views(record: Record) -> str:
    if record.artefacts:
        return '<p class="aside">Not drawn, or the page would grow too large; the files below open in any viewer.</p>'
    return '<p class="aside">No meshes were kept of this case.</p>'


def _charts(record: Record) -> str:
    curves = curves_of(record)
    if not curves:
        return ""
    drawn = "".join(
        f'<div data-chart="{name}">{chart(CHARTS[name], lines, least_range=HELD * name.endswith("drift"))}</div>'
        for name, lines in curves.items()
    )
    keys = "".join(
        f'<span><i class="swatch" style="border-color:{line.colour};'
        f'border-top-style:{"solid" if line.steps > 1 else "dashed"}">'
        f"</i>{escape(line.name)}{'' if line.steps > 1 else ', one solve'}</span>"
        for line in next(iter(curves.values()))
    )
    return f'<div class="charts">{drawn}</div><div class="keys">Over the steps: {keys}</div>'


def _files(record: Record, base: str) -> str:
    links = ", ".join(
        f'<a href="{_href(base, artefact.path)}" download>'
        f"{escape(FILES.get(name, f'{SIDES.get(name, name)}, edited'))}</a>"
        f" ({Path(artefact.path).suffix})"
        for name, artefact in record.artefacts.items()
    )
    return f'<p class="files">Files: {links}.</p>' if links else ""


def _href(base: str, path: str) -> str:
    # A colon would read as a scheme and a percent sign as an escape, whatever the folders are called.
    return escape(f"{base}/{quote(path)}" if base.startswith("file:") else quote(f"{base}/{path}"))


def _numbers(record: Record) -> str:
    numbers = {
        side: {
            **{k: v for k, v in row.items() if _is_number(v)},
            **{f"seconds, {phase}": v for phase, v in row.get("seconds_by_phase", {}).items()},
        }
        for side, row in record.sides.items()
    }
    names = list(dict.fromkeys(name for column in numbers.values() for name in column))
    head = "".join(f'<th class="number">{escape(SIDES.get(side, side))}</th>' for side in numbers)
    body = "".join(
        f"<tr><td>{escape(name)}</td><td>{_unit(name)}</td>"
        + "".join(f'<td class="number">{_figure(column.get(name))}</td>' for column in numbers.values())
        + "</tr>"
        for name in names
    )
    both, shared = (
        "".join(
            f'<tr><td>{escape(name)}</td><td>{unit or _unit(name)}</td><td class="number">{_figure(v)}</td></tr>'
            for name, v in rows.items()
        )
        for rows, unit in ((record.between, ""), (record.seconds, "s"))
    )
    return f"""<div class="tables">
<table><thead><tr><th>of each</th><th>unit</th>{head}</tr></thead><tbody>{body}</tbody></table>
<table><thead><tr><th>neural and mesh result</th><th>unit</th><th></th></tr></thead><tbody>{both}</tbody>
<thead><tr><th>time of what they share</th><th></th><th></th></tr></thead><tbody>{shared}</tbody></table></div>
<p class="aside">Units are those of the shape's file; docs/metrics.md defines each number.</p>"""


def _unit(name: str) -> str:
    """Return the unit of a number of a record by its name, as docs/metrics.md has it."""
    if name.endswith(("_drift", "_relative", "_notebook")) or name in ("iou", "normal_consistency", "bodies"):
        return "1"
    for start, unit in (
        ("seconds", "s"),
        ("peak_memory", "MB"),
        ("volume", "length³"),
        ("area", "length²"),
        ("killing", "length²"),
        ("arap", "length²"),
        ("strain", "1"),
    ):
        if name.startswith(start):
            return unit
    return "length"


def _settings(record: Record) -> str:
    case = record.case.to_dict()
    scale, offset = record.subject.get("scale") or 1.0, record.subject.get("offset") or (0.0, 0.0, 0.0)
    handles = "".join(f"<li>{escape(handle_in_words(h, float(scale), offset))}</li>" for h in record.case.handles)
    settings = flat(case["parameters"]) | {name: case[name] for name in ("vertices", "resolution", "seed")}
    rows = {"shape": case["shape"], **settings, **flat(plain(record.provenance))}
    listed = "".join(f"<dt>{escape(name)}</dt><dd>{escape(_said(value))}</dd>" for name, value in rows.items())
    field = f"One unit of the field's own coordinates is {length(scale)} of the file's."
    listed_handles = f"<p>Handles, in the coordinates of the file:</p><ol>{handles}</ol>" if handles else ""
    return f"""{listed_handles}<p class="aside">{field}</p>
<dl class="definitions">{listed}</dl>
<p class="aside">The case as it can be run again, its handles in the field's coordinates:</p>
<pre>{escape(json.dumps(plain(case)))}</pre>"""


def _said(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(plain(value))


def _prose(text: str) -> str:
    """Return text for a page in which no line ends between a number and its unit."""
    return re.sub(r"(?<=\d) (?=(%|s|MB)(?![a-z]))", "\u00a0", escape(text))


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _figure(value: float | None) -> str:
    return "" if value is None else str(value) if isinstance(value, int) else f"{value:.4g}".replace("-", "\u2212")
