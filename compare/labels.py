"""What to call cases of the same shape and operation: by the settings in which they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from compare.case import Case


def labels(cases: Sequence[Case]) -> dict[str, str]:
    """Of each case, by its key, what tells it from the others of its shape and operation; "" where there is none.

    Settings are named as in a study: "vertices 500, implicit.points 250".
    """
    groups: dict[tuple[str, str], list[Case]] = {}
    for case in cases:
        groups.setdefault((case.name, case.operation), []).append(case)
    words = {}
    for group in groups.values():
        settings = [_settings(case) for case in group]
        names = dict.fromkeys(name for row in settings for name in row)
        differing = [name for name in names if any(row.get(name) != settings[0].get(name) for row in settings)]
        for case, row in zip(group, settings, strict=True):
            words[case.key] = ", ".join(f"{name} {row[name]}" for name in differing if name in row)
    return words


def _settings(case: Case) -> dict[str, Any]:
    row = case.to_dict()
    return flat(row.pop("parameters")) | {name: row[name] for name in ("vertices", "resolution", "seed")}


def flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as one, with dotted names."""
    row: dict[str, Any] = {}
    for key, value in table.items():
        row |= flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return row
