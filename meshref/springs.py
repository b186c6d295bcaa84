"""Springs that hold handle vertices: the weights of their squared distances from where they are sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError
from meshref.topology import FloatArray, IntArray


def spring_weights(handles: IntArray, areas: FloatArray, given: ArrayLike | None) -> FloatArray:
    """Return the weight of each handle, (h,): those given, or the areas that belong to them.

    Args:
        handles: Numbers of the vertices, (h,).
        areas: Of all vertices, (n,).
        given: Weights, (h,), or None.

    Raises:
        MeshError: The weights are not as many positive numbers as there are handles.
    """
    if given is None:
        return areas[handles]
    try:
        weights = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"handle_weights must be {len(handles)} positive numbers, but {error}.") from None
    if weights.shape != handles.shape or not (np.isfinite(weights).all() and (weights > 0).all()):
        raise MeshError(
            f"handle_weights must be {len(handles)} positive numbers, one for each handle, but have shape "
            f"{weights.shape} and least {weights.min(initial=np.inf):.3g}."
        )
    return weights
