"""Line charts as SVG: they need no script, print sharply, and take the page's colours, light or dark."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

WIDTH, HEIGHT = 360, 200
LEFT, RIGHT, TOP, BOTTOM = 54, 12, 26, 34

Place = Callable[[float], float]  # of a step or a value, in the picture


@dataclass(frozen=True)
class Line:
    """Values at steps 0, 1, 2 and so on; None where there is none."""

    name: str
    colour: str
    values: Sequence[float | None]

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return len(self.values) - 1


def chart(title: str, lines: Sequence[Line], *, least_range: float = 0.0) -> str:
    """Return a chart of lines over the steps as SVG.

    A method that solves once is a dashed level, for it has no way from the start.

    Args:
        title: Of the chart, with the unit.
        lines: At least one.
        least_range: Half the height where no value is larger, so that what is held to many digits is a level line, and
            no dip of a millionth that fills the chart.
    """
    last = max(1, *(line.steps for line in lines))
    shown = [line.values if line.steps > 1 else line.values[-1:] for line in lines]
    values = [value for row in shown for value in row if value is not None and math.isfinite(value)]
    held = all(abs(value) < least_range for value in values)
    low, high = (-least_range, least_range) if held and least_range else (min([0.0, *values]), max([0.0, *values]))
    if not low < high:
        high = low + 1.0
    ticks = nice_ticks(low, high)
    low, high = min(low, ticks[0]), max(high, ticks[-1])

    def x(step: float) -> float:
        return LEFT + (WIDTH - LEFT - RIGHT) * step / last

    def y(value: float) -> float:
        return TOP + (HEIGHT - TOP - BOTTOM) * (high - value) / (high - low)

    digits = max(0, -math.floor(math.log10(ticks[1] - ticks[0])))
    grid = "".join(
        f'<line class="{"zero" if tick == 0 else "grid"}" x1="{LEFT}" x2="{WIDTH - RIGHT}" '
        f'y1="{y(tick):.1f}" y2="{y(tick):.1f}"/>'
        f'<text class="tick" text-anchor="end" x="{LEFT - 6}" y="{y(tick) + 3.5:.1f}">{_tick(tick, digits)}</text>'
        for tick in ticks
    )
    every = max(1, math.ceil(last / 8))
    grid += "".join(
        f'<text class="tick" text-anchor="middle" x="{x(step):.1f}" y="{HEIGHT - BOTTOM + 14}">{step}</text>'
        for step in range(0, last + 1, every)
    )
    drawn = "".join(_drawn(line, x, y, last) for line in lines)
    middle = f'text-anchor="middle" x="{(LEFT + WIDTH - RIGHT) / 2:.0f}"'
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape(title)} over the steps">'
        f'<text class="title" {middle} y="15">{escape(title)}</text>'
        f'{grid}{drawn}<text class="tick" {middle} y="{HEIGHT - 5}">step</text></svg>'
    )


def nice_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return round numbers that go from at most low to at least high, evenly."""
    raw = (high - low) / (most - 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1, 2, 2.5, 5, 10) if factor * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [k * step for k in range(first, last + 1)]


def _drawn(line: Line, x: Place, y: Place, last: int) -> str:
    name = f"<title>{escape(line.name)}</title>"
    if line.steps <= 1:
        value = line.values[-1]
        if value is None:
            return ""
        ends = f'x1="{x(0):.1f}" x2="{x(last):.1f}" y1="{y(value):.1f}" y2="{y(value):.1f}"'
        return f'<line class="level" {ends} stroke="{line.colour}">{name}</line>'
    points = [(x(k), y(value)) for k, value in enumerate(line.values) if value is not None]
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
    dots = "".join(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>' for a, b in points) if len(points) <= 40 else ""
    return f'<g class="curve" stroke="{line.colour}" fill="{line.colour}">{name}<polyline points="{path}"/>{dots}</g>'


def _tick(value: float, digits: int) -> str:
    if value == 0:
        return "0"
    if abs(value) >= 1e5 or digits > 5:
        return f"{value:.1e}".replace("-", "\u2212")
    more = round(value, digits) != round(value, digits + 2)  # as 2.5 where the steps are 2.5
    return f"{value:.{digits + more}f}".replace("-", "\u2212")
