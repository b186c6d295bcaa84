"""The result of a study as a table and as curves."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from compare.files import replace_file
from compare.runs.columns import SIDE_COLOURS, SIDES, column_of, number
from compare.runs.records import Record
from compare.studies.study import Chart, Study, settings_at

# Of a shape; a method has its colour, whatever else is drawn.
MARKERS = "osD^vP*X"
DASHES = ("-", "--", ":", "-.")
DPI = 150


@dataclass(frozen=True)
class Point:
    """One method in one case."""

    record: Record
    side: str

    def value(self, name: str) -> Any:
        """Return a setting of the case or a measured number, by name; None where it has none."""
        column = column_of(name)
        if column is not None:
            return number(self.record.sides[self.side], column)
        from compare.cases.settings import setting_of

        return setting_of(self.record.case, name)


def curves(study: Study, records: Sequence[Record], chart: Chart) -> dict[tuple[str, ...], list[tuple[Any, float]]]:
    """Return the points (x, y) of each curve of a chart, in the order of the grid.

    Returns:
        By the shape, the operation, the side, and the other varied settings as words. Points without x or y (a case
        that failed) are left out; so are zeros of |y|, which an axis in logarithms cannot show.
    """
    axis = study.axis_of(chart.x) if chart.x in study.varied else next(iter(study.grid), "")
    others = [name for name in study.varied if study.axis_of(name) != axis]
    groups: dict[tuple[str, ...], list[Point]] = {}
    for record in records:
        for side in record.sides:
            point = Point(record, side)
            words = (f"{name} {_word(point.value(name))}" for name in others)
            groups.setdefault((record.case.name, record.case.operation, side, *words), []).append(point)
    found = {}
    for name, points in groups.items():
        pairs = [(point.value(chart.x), point.value(chart.y)) for point in points]
        if chart.against_last:
            last = points[-1].value(chart.y) if _is_last(points[-1], study, axis) else None
            pairs = [(x, abs(y - last) / abs(last)) for x, y in pairs[:-1] if y is not None and last]
        pairs = [(x, abs(y)) for x, y in pairs if x is not None and y]
        if pairs:
            found[name] = pairs
    return found


def _is_last(point: Point, study: Study, axis: str) -> bool:
    """Return whether a point is at the end of an axis; what should be there may have failed."""
    return all(point.value(name) == value for name, value in settings_at(axis, study.grid[axis][-1]).items())


def draw_charts(study: Study, records: Sequence[Record], stem: Path) -> None:
    """Write the panels of a study side by side, as stem.png and stem.pdf."""
    figure = Figure(figsize=(5.2 * len(study.charts), 4.4), layout="constrained")
    panels = figure.subplots(1, len(study.charts), squeeze=False)[0]
    for axes, chart in zip(panels, study.charts, strict=True):
        _draw(axes, study, chart, curves(study, records, chart))
    labelled = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if labelled:
        figure.legend(
            labelled.values(), labelled.keys(), loc="outside lower center", ncols=min(len(labelled), 4), fontsize=8
        )
    figure.suptitle(study.title or study.name, fontsize=11)
    for suffix in (".png", ".pdf"):
        content = io.BytesIO()
        # Without the date, so that the same study gives the same bytes.
        figure.savefig(content, format=suffix[1:], dpi=DPI, metadata={"CreationDate": None} if suffix == ".pdf" else {})
        replace_file(stem.with_suffix(suffix), content.getvalue())


def _draw(axes: Axes, study: Study, chart: Chart, lines: dict[tuple[str, ...], list[tuple[Any, float]]]) -> None:
    several = {k: len({name[k] for name in lines}) > 1 for k in (0, 1)}
    shapes = list(dict.fromkeys(name[0] for name in lines))
    variants = list(dict.fromkeys((name[1], *name[3:]) for name in lines))
    for name, pairs in lines.items():
        shape, operation, side, *words = name
        label = [SIDES.get(side, side), *([shape] if several[0] else []), *([operation] if several[1] else []), *words]
        axes.plot(
            *zip(*pairs, strict=True),
            label=", ".join(label),
            color=SIDE_COLOURS.get(side, "#555555"),
            marker=MARKERS[shapes.index(shape) % len(MARKERS)],
            linestyle=DASHES[variants.index((operation, *words)) % len(DASHES)],
            markersize=4,
            linewidth=1.2,
        )
    values = [x for pairs in lines.values() for x, _ in pairs]
    if lines:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(LogFormatter())
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    if values and all(isinstance(x, int | float) and x > 0 for x in values):
        axes.set_xscale("log")
        if chart.x in study.varied:  # those that were run, not powers of ten
            ticks = sorted(set(values))
            axes.set_xticks(ticks, [f"{x:g}" for x in ticks], rotation=0 if len(ticks) < 6 else 45)
            axes.set_xticks([], minor=True)
        else:
            axes.xaxis.set_major_formatter(LogFormatter())
            axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.5)))
    axes.set_xlabel(_axis_label(chart.x))
    axes.set_ylabel(_axis_label(chart.y, chart.against_last))
    axes.grid(alpha=0.3, which="both", linewidth=0.4)


def _axis_label(name: str, against_last: bool = False) -> str:
    column = column_of(name)
    if column is None:
        return name
    title = column.label or column.title
    if against_last:
        return f"{title}: relative difference to the last"
    return f"|{title}|" if name.endswith("_drift") else title


def _word(value: Any) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
