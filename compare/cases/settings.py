"""Settings of a case by name, as studies vary them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from compare.cases.case import Case
from compare.cases.registry import OPERATIONS
from compare.errors import InputError

OF_A_CASE = ("vertices", "resolution", "seed")
OF_A_PART = ("implicit", "mesh", "fit")


def with_settings(case: Case, settings: Mapping[str, Any]) -> Case:
    """Return the case with settings by their dotted names; those for another operation are passed over."""
    fields: dict[str, Any] = {}
    parameters = json.loads(json.dumps(case.parameters))
    for name, value in settings.items():
        parts = parts_of(name, case.operation)
        if parts is None:
            continue
        if parts[0] in OF_A_CASE:
            fields[parts[0]] = value
        elif len(parts) == 1:
            parameters[parts[0]] = value
        else:
            parameters.setdefault(parts[0], {})[parts[1]] = value
    try:
        return replace(case, parameters=parameters, **fields)
    except (ValueError, TypeError) as error:
        raise InputError(f"The study asks for a case that makes no sense: {error}") from error


def setting_of(case: Case, name: str) -> Any:
    """Return the value of a setting in a case, None where its editor chooses."""
    parts = parts_of(name, case.operation)
    if parts is None:
        return None
    if parts[0] in OF_A_CASE:
        return getattr(case, parts[0])
    value: Any = case.parameters
    for part in parts:
        value = value.get(part) if value is not None else None
    return value


def parts_of(name: str, operation: str) -> list[str] | None:
    """Return the parts of the dotted name without the operation before it; None if it is for another."""
    parts = name.split(".")
    if parts[0] not in OPERATIONS:
        return parts
    return parts[1:] if parts[0] == operation else None
