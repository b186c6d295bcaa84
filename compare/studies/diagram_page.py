"""A diagram drawn: a panel for each operation and each cost, a curve for each shape, side and method, and a page."""

from __future__ import annotations

import html
import io
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogLocator, NullFormatter

from compare.files import replace_file
from compare.runs.columns import SIDE_COLOURS
from compare.studies.crossing import Comparison, compared, in_short, sentence
from compare.studies.diagram import FIELD, MESH, Diagram, DiagramRow, words_of

COLOURS = {FIELD: SIDE_COLOURS["implicit"], MESH: SIDE_COLOURS["mesh"]}
NAMES = ("the field", "the mesh")
UNITS = {"seconds": "s", "numbers": "numbers"}
LABELS = {"seconds": "seconds: median of the runs, least to most", "numbers": "numbers stored"}
MARKERS = "osD^vP*X"
DASHES = ("-", "--", ":", "-.")
DPI = 150
LEAST = 1e-16  # drawn for an error of nothing


def drawn_error(row: DiagramRow) -> float:
    """Return the error of a row, but no less than that of its reference."""
    if row.error is None:
        raise ValueError(f"{row.key} has no error.")
    return max(row.error, row.floor, LEAST)


def comparisons(rows: Sequence[DiagramRow], panel: str, cost: str) -> dict[str, Comparison]:
    """Return by shape how field and mesh compare in a panel, each side by the best of its methods."""
    found = {}
    for shape in dict.fromkeys(row.shape for row in rows if row.panel == panel):
        sides = []
        for side in (FIELD, MESH):
            of_side = [row for row in rows if (row.panel, row.shape, row.side) == (panel, shape, side)]
            pairs = [(row.cost(cost), drawn_error(row)) for row in of_side if not row.failed]
            sides.append([(c, e) for c, e in pairs if c is not None])
        if all(sides):
            found[shape] = compared(*sides)
    return found


def sentences(diagram: Diagram, rows: Sequence[DiagramRow]) -> list[str]:
    """Return who is cheaper where, a sentence for each panel, cost and shape."""
    return [
        f"{panel.capitalize()}, {shape}, against {cost}: {sentence(NAMES, UNITS[cost], comparison)}"
        for panel in diagram.panels
        for cost in diagram.costs
        for shape, comparison in comparisons(rows, panel, cost).items()
    ]


def write_page(diagram: Diagram, rows: Sequence[DiagramRow], folder: Path) -> None:
    """Write chart.svg, chart.png, chart.pdf and report.html."""
    figure = _drawn(diagram, rows)
    pictures = {}
    for kind in ("svg", "png", "pdf"):
        content = io.BytesIO()
        # Without dates and random names, so that the same rows give the same bytes.
        metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}[kind]
        with rc_context({"svg.hashsalt": diagram.name}):
            figure.savefig(content, format=kind, dpi=DPI, metadata=metadata)
        pictures[kind] = content.getvalue()
        replace_file(folder / f"chart.{kind}", pictures[kind])
    picture = pictures["svg"].decode()
    replace_file(folder / "report.html", _page(diagram, rows, picture[picture.index("<svg") :]).encode())


def _drawn(diagram: Diagram, rows: Sequence[DiagramRow]) -> Figure:
    panels = [panel for panel in diagram.panels if any(row.panel == panel for row in rows)]
    # Costs beside each other; where there is one alone, the panels are.
    across = len(diagram.costs) > 1
    shape = (len(panels), len(diagram.costs)) if across else (1, len(panels))
    figure = Figure(figsize=(5.8 * shape[1], 4.3 * shape[0] + 0.6), layout="constrained")
    every = figure.subplots(*shape, squeeze=False)
    for k, panel in enumerate(panels):
        for j, cost in enumerate(diagram.costs):
            _draw(every[k, j] if across else every[0, k], diagram, rows, panel, cost)
    figure.suptitle(diagram.title, fontsize=11)
    return figure


def _draw(axes: Axes, diagram: Diagram, rows: Sequence[DiagramRow], panel: str, cost: str) -> None:
    own = [row for row in rows if row.panel == panel and row.cost(cost) is not None]
    shapes = list(dict.fromkeys(row.shape for row in rows))
    curves = dict.fromkeys((row.shape, row.side, row.method) for row in own)
    methods = {side: list(dict.fromkeys(row.method for row in own if row.side == side)) for side in (FIELD, MESH)}
    for shape, side, method in curves:
        line = [row for row in own if (row.shape, row.side, row.method) == (shape, side, method)]
        x, y = [row.cost(cost) or 0.0 for row in line], [drawn_error(row) for row in line]
        style: dict[str, Any] = {
            "color": COLOURS[side],
            "marker": MARKERS[shapes.index(shape) % len(MARKERS)],
            "markersize": 4.5,
        }
        dash = DASHES[methods[side].index(method) % len(DASHES)]
        axes.plot(x, y, label=f"{side}: {method}, {shape}", linestyle=dash, linewidth=1.3, **style)
        if cost == "seconds":
            spans = [(min(row.seconds), max(row.seconds)) for row in line]
            axes.hlines(
                y, [low for low, _ in spans], [high for _, high in spans], color=COLOURS[side], linewidth=3, alpha=0.3
            )
    for shape in shapes:
        floor = max((row.floor for row in own if row.shape == shape), default=0.0)
        if floor > 1e-12 and any(drawn_error(row) < 10 * floor for row in own if row.shape == shape):
            axes.axhline(floor, color="#888888", linewidth=0.8, linestyle=":")
            where: dict[str, Any] = {
                "xycoords": ("axes fraction", "data"),
                "textcoords": "offset points",
                "ha": "right",
            }
            axes.annotate(f"reference, {shape}", (0.99, floor), (0, 2), **where, fontsize=6.5, color="#666666")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    low, high = axes.get_ylim()
    # Within a decade there may be no power of ten to read from.
    axes.yaxis.set_minor_formatter(NullFormatter() if high > 20 * low else LogFormatter(minor_thresholds=(2, 0.5)))
    axes.tick_params(axis="y", which="minor", labelsize=6.5)
    axes.set_ylabel(diagram.panels[panel], fontsize=8.5)
    said = [
        f"{shape}: {in_short(('field', 'mesh'), UNITS[cost], c)}" for shape, c in comparisons(rows, panel, cost).items()
    ]
    axes.set_xlabel("\n".join([LABELS[cost], *said]), fontsize=8.5)
    axes.set_title(panel, fontsize=10)
    axes.grid(alpha=0.3, which="major", linewidth=0.4)
    if own:
        axes.legend(fontsize=6.5, framealpha=0.7)


def _page(diagram: Diagram, rows: Sequence[DiagramRow], picture: str) -> str:
    said = "".join(f"<li>{html.escape(line)}</li>" for line in sentences(diagram, rows))
    panels = "".join(
        f"<li><b>{html.escape(name)}</b>: {html.escape(what)}</li>" for name, what in diagram.panels.items()
    )
    titles = "panel,shape,curve,at,numbers,error,error of the reference,seconds (least to most; runs),status"
    head = "".join(f"<th>{word}</th>" for word in titles.split(","))
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in _cells(row))}</tr>" for row in rows)
    machine = next((row.provenance for row in rows if row.provenance), {})
    where = ", ".join(f"{machine[key]}" for key in ("processor", "platform", "time") if machine.get(key))
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{html.escape(diagram.title)}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem; padding: 0 1rem; color: #222; }}
svg {{ max-width: 100%; height: auto; }}
table {{ border-collapse: collapse; font-size: 12.5px; font-variant-numeric: tabular-nums; }}
td, th {{ padding: .15rem .6rem; text-align: left; border-bottom: 1px solid #ddd; vertical-align: top; }}
</style>
<h1>{html.escape(diagram.title)}</h1>
<ul>{said}</ul>
{picture}
<h2>Errors</h2><ul>{panels}</ul>
<p>Each side at an error is the cheapest of its points that come to it. Seconds are of the operation alone, from a field
or a mesh that is there, on {html.escape(where)}; numbers stored are the parameters of a network, or three coordinates a
vertex.</p>
<h2>All points</h2><table><tr>{head}</tr>{body}</table>
</html>
"""


def _cells(row: DiagramRow) -> list[str]:
    time = ""
    if row.seconds:
        least, most = min(row.seconds), max(row.seconds)
        time = f"{statistics.median(row.seconds):.3g} ({least:.3g} to {most:.3g}, {len(row.seconds)})"
    number = "" if row.numbers is None else f"{row.numbers:,}"
    error = "" if row.error is None else f"{row.error:.2e}"
    floor = f"{row.floor:.0e}" if row.floor else ""
    return [row.panel, row.shape, f"{row.side}, {row.method}", words_of(row.at), number, error, floor, time, row.status]
