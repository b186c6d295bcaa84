"""The cases that are run where none are named: each operation with its default handles."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.registry import OPERATIONS
from compare.cases.room import within

QUICK_SIZE = {"vertices": 800, "resolution": 32}
QUICK_FIT = {"steps": 600}  # for a shape given as a mesh


def case_of_subject(shape: str, fit: Mapping[str, Any] | None = None, **settings: Any) -> Case:
    """Return a case of a shape for its subject alone, which is the same under all operations.

    Args:
        shape: As for Case.
        fit: Options of the fit, for a shape given as a mesh.
        settings: Further arguments of Case: vertices, resolution, seed.
    """
    operation = next(name for name, rules in OPERATIONS.items() if not rules.takes_handles)
    return Case(shape, operation, parameters={"fit": fit} if fit else {}, **settings)


def default_cases(
    shape: str,
    V: Float[ndarray, "n 3"],
    N: Float[ndarray, "n 3"],
    *,
    operations: Collection[str] = OPERATIONS,
    quick: bool = False,
    fit: Mapping[str, Any] | None = None,
    bounds: Float[ndarray, "2 3"] | None = None,
    **settings: Any,
) -> list[Case]:
    """Return a case for each operation on any shape, with handles found from its surface.

    - geometric: a smooth bump, 6 % of the longest side high, in the middle of a flank; the rest is to stay.
    - smooth: mean-curvature flow that keeps the volume.
    - rigid: along the longest side, the lowest 12 % are held and the uppermost 12 % moved sideways by 15 %.

    Args:
        shape: As for Case.
        V: Points on its surface in the field's coordinates, evenly spread.
        N: Outward unit normals there.
        operations: Which of them, in this order; by default all.
        quick: Whether to spend little: fewer points and steps, for a first look and not for figures.
        fit: Options of the fit, for a shape given as a mesh.
        bounds: Lower and upper corner of the field's bounds. Handles that would leave them, as those of a shape as wide
            as it is long, are moved less far; None leaves them as they are.
        settings: Further arguments of Case: vertices, resolution, seed.

    Raises:
        TypeError: V or N is no array of points.
        ValueError: V or N is not finite, or there is no such operation.
    """
    for name, array in (("V", V), ("N", N)):
        if not isinstance(array, ndarray) or array.dtype.kind != "f" or array.shape != (len(V), 3) or len(V) == 0:
            raise TypeError(f"{name} must be an array (n, 3) of real numbers, a row a point, but is {array!r:.200}.")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, but holds NaN or infinite numbers. Take out those points.")
    if not isinstance(operations, list | tuple | Mapping) or not set(operations) <= set(OPERATIONS):
        raise ValueError(f"operations must be a list of {', '.join(OPERATIONS)}, but are {operations!r}.")
    cases = []
    for name in operations:
        rules = OPERATIONS[name]
        parameters = {**(rules.quick if quick else rules.full), **({"fit": dict(fit)} if fit else {})}
        handles = rules.default_handles(V, N)
        if bounds is not None:
            handles = within(handles, V, N, bounds)
        cases.append(Case(shape, name, handles, parameters, **settings))
    return cases
