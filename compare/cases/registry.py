"""The operations that a case can name. Each registers itself where it is defined, in `compare.operations`.

The registry stands below the cases and knows of an operation only what a case must: its name, whether it takes handles,
which, and its settings. What edits and judges is in `compare.operations.operation.Operation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol

from jaxtyping import Float
from numpy import ndarray

from compare.cases.handles import HandleSpec


class CaseRules(Protocol):
    """Rules for what a case of an operation holds."""

    name: str
    takes_handles: bool
    settings: tuple[str, ...]  # names of its own settings, which stand at the top of a case's parameters
    full: Mapping[str, Any]  # parameters of a default case
    quick: Mapping[str, Any]  # the same for a first look

    def default_handles(self, V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"]) -> tuple[HandleSpec, ...]:
        """Return the handles for any shape, found from points V on its surface and the outward normals N there."""
        ...


_RULES: dict[str, CaseRules] = {}
OPERATIONS: Mapping[str, CaseRules] = MappingProxyType(_RULES)  # by name, in the order in which they are run and shown


def add_rules(rules: CaseRules) -> None:
    """Let cases name an operation. Called by `compare.operations.register`.

    Raises:
        ValueError: Another operation has the name.
    """
    if _RULES.get(rules.name, rules) is not rules:
        raise ValueError(f"There is an operation {rules.name!r} already. Give the new one another name.")
    _RULES[rules.name] = rules


def own_settings() -> tuple[str, ...]:
    """Return the names of the settings that some operation has of its own."""
    return tuple(dict.fromkeys(name for rules in _RULES.values() for name in rules.settings))
