"""Names for cases of the same shape and operation: the settings in which they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from compare.cases.case import Case


def labels(cases: Sequence[Case]) -> list[str]:
    """Return of each case what tells it from the others of its shape and operation; "" where nothing does.

    Settings are named as in a study: "vertices 500, implicit.points 250".
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for k, case in enumerate(cases):
        groups.setdefault((case.name, case.operation), []).append(k)
    words = [""] * len(cases)
    for group in groups.values():
        settings = [_settings(cases[k]) for k in group]
        names = dict.fromkeys(name for row in settings for name in row)
        differing = [name for name in names if any(row.get(name) != settings[0].get(name) for row in settings)]
        for k, row in zip(group, settings, strict=True):
            words[k] = ", ".join(f"{name} {row[name]}" for name in differing if name in row)
    return words


def _settings(case: Case) -> dict[str, Any]:
    row = case.to_dict()
    return flat(row.pop("parameters")) | {name: row[name] for name in ("vertices", "resolution", "seed")}


def flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return nested tables as one, with dotted names."""
    row: dict[str, Any] = {}
    for key, value in table.items():
        row |= flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return row
