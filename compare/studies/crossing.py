"""Points where two curves of cost over error cross, and a sentence that says who is cheaper where.

A curve is the best to be had: at an error e the least cost of any of its points with an error of at most e, with
straight lines between these in logarithms. Curves are compared at the errors that both come to: from the larger of the
two that are reached at the least cost, where the other curve costs what its cheapest point does, to the larger of the
two least ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Errors at which two curves are compared, evenly spaced in logarithms; and what is as good as equal.
SAMPLES = 400
EQUAL = 1.1


@dataclass(frozen=True)
class Comparison:
    """Two curves over the errors that both reach.

    Attributes:
        reached: Least and largest of these errors.
        crossings: Pairs (error, cost) where they cross.
        ratios: Costs of the second over those of the first at the largest and at the least of the errors.
        best: Least error that each reaches.
    """

    reached: tuple[float, float]
    crossings: tuple[tuple[float, float], ...]
    ratios: tuple[float, float]
    best: tuple[float, float]


def frontier(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return those (cost, error) pairs that no other beats in both, the cheapest first."""
    kept: list[tuple[float, float]] = []
    for cost, error in sorted(points):
        if not kept or error < kept[-1][1]:
            kept.append((cost, error))
    return kept


def compared(first: Sequence[tuple[float, float]], second: Sequence[tuple[float, float]]) -> Comparison:
    """Return how two sets of (cost, error) pairs, both positive, compare.

    Raises:
        ValueError: One of them is empty.
    """
    if not first or not second:
        raise ValueError("There is nothing to compare: each curve needs a point (cost, error).")
    curves = frontier(first), frontier(second)
    best = curves[0][-1][1], curves[1][-1][1]
    least, most = max(best), max(curves[0][0][1], curves[1][0][1])
    errors = np.geomspace(most, least, SAMPLES)
    costs = [_cost(curve, errors) for curve in curves]
    ratio = np.log(costs[1] / costs[0])
    crossings = []
    for k in np.flatnonzero(np.sign(ratio[:-1]) * np.sign(ratio[1:]) < 0):
        share = ratio[k] / (ratio[k] - ratio[k + 1])
        error = float(np.exp(np.log(errors[k]) * (1 - share) + np.log(errors[k + 1]) * share))
        crossings.append((error, float(_cost(curves[0], np.array([error]))[0])))
    ends = float(np.exp(ratio[0])), float(np.exp(ratio[-1]))
    return Comparison((float(least), float(most)), tuple(crossings), ends, best)


def _cost(curve: Sequence[tuple[float, float]], errors: np.ndarray) -> np.ndarray:
    """Return the least costs at which a frontier comes to errors; above its largest, the cost of that."""
    cost, error = np.log(np.array(curve)).T
    return np.asarray(np.exp(np.interp(np.log(errors), error[::-1], cost[::-1])))


def sentence(names: tuple[str, str], unit: str, comparison: Comparison) -> str:
    """Return what a comparison comes to.

    Args:
        names: Of the two curves, as in "the field".
        unit: Of the cost, as in "s" or "numbers".
        comparison: Of them.
    """
    a, b = names
    cheaper = {"s": "quicker", "numbers": "smaller"}.get(unit, "cheaper")
    parts = []
    least, most = comparison.reached
    span = f"errors of {most:.1e} to {least:.1e}" if most > 1.001 * least else f"an error of {least:.1e}"
    start, end = comparison.ratios
    if not comparison.crossings:
        if max(start, end) < EQUAL and min(start, end) > 1 / EQUAL:
            parts.append(f"At {span} both cost the same")
        else:
            first = start * end >= 1
            times = sorted((start, end) if first else (1 / start, 1 / end))
            factor = f"{_times(times[0])} to {_times(times[1])}" if times[1] > EQUAL * times[0] else _times(times[1])
            parts.append(f"At {span} {a if first else b} is {cheaper}, {factor} times")
    else:
        ahead = [a, b] if start >= 1 else [b, a]
        at, cost = comparison.crossings[-1]
        final = a if end >= 1 else b
        other = b if final == a else a
        if len(comparison.crossings) == 1:
            parts.append(
                f"The curves cross at an error of {at:.1e}, at {cost:.2g} {unit}: above it {ahead[0]} is {cheaper} "
                f"(at {most:.1e} by {_times(max(start, 1 / start))}), below it {final} "
                f"(at {least:.1e} by {_times(max(end, 1 / end))})"
            )
        else:
            parts.append(
                f"The curves cross {len(comparison.crossings)} times, last at an error of {at:.1e} and {cost:.2g} "
                f"{unit}; below it {final} is {cheaper} than {other}"
            )
    if max(comparison.best) > 1.5 * min(comparison.best):
        ahead_name = a if comparison.best[0] < comparison.best[1] else b
        parts.append(f"{ahead_name} alone comes below {max(comparison.best):.1e}, to {min(comparison.best):.1e}")
    said = "; ".join(parts) + "."
    return said[0].upper() + said[1:]


def _times(factor: float) -> str:
    return f"{factor:,.0f}" if factor >= 9.5 else f"{factor:.2g}"


def in_short(names: tuple[str, str], unit: str, comparison: Comparison) -> str:
    """Return the same as a sentence does, as short as a chart has room for."""
    a, b = names
    cheaper = {"s": "quicker", "numbers": "smaller"}.get(unit, "cheaper")
    start, end = comparison.ratios
    if not comparison.crossings:
        ahead = a if start * end >= 1 else b
        times = sorted(max(ratio, 1 / ratio) for ratio in (start, end))
        return f"{ahead} {cheaper}, {_times(times[0])} to {_times(times[1])} x"
    at, cost = comparison.crossings[-1]
    return f"{a if end >= 1 else b} {cheaper} below {at:.1e} ({cost:.2g} {unit})"
