"""How a row is timed and printed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

clock = time.perf_counter  # or process_time, see side_by_side.main


def best(*tasks: Callable[[], object], repeats: int = 3) -> list[tuple[float, Any]]:
    """Seconds and result of each task, the tasks in turn so that a slow moment hits all."""
    times: list[list[float]] = [[] for _ in tasks]
    results: list[Any] = [None] * len(tasks)
    for _ in range(repeats):
        for k, task in enumerate(tasks):
            start = clock()
            results[k] = task()
            times[k].append(clock() - start)
    return [(min(t), r) for t, r in zip(times, results, strict=True)]


def row(name: str, theirs: float, ours: float, accuracy: str, good: bool) -> None:
    """Print a row; without its times where the accuracy is missed, for then they compare nothing."""
    seconds = f"{theirs:.3g} | {ours:.3g} | {theirs / ours:.2g} x" if good else "- | - | missed its accuracy"
    print(f"| {name} | {seconds} | {accuracy} |", flush=True)
