"""Handles whose motion stays inside the bounds of a field, beyond which it has no surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.handles import HandleSpec, rounded

MARGIN = 0.03  # of the longest side of the bounds, for what bulges beyond the handles


def within(
    handles: tuple[HandleSpec, ...],
    V: Float[ndarray, "n 3"],
    N: Float[ndarray, "n 3"],
    bounds: Float[ndarray, "2 3"],
) -> tuple[HandleSpec, ...]:
    """Return handles that move what they hold no farther than the bounds allow; those with room are as they were.

    Args:
        handles: By vectors or along normals; others are left as they are.
        V: Points on the surface.
        N: Outward unit normals there.
        bounds: Lower and upper corner.
    """
    return tuple(_shortened(handle, V, N, np.asarray(bounds, dtype=np.float64)) for handle in handles)


def _shortened(
    handle: HandleSpec, V: Float[ndarray, "n 3"], N: Float[ndarray, "n 3"], bounds: Float[ndarray, "2 3"]
) -> HandleSpec:
    import torch

    kind = handle.motion["kind"]
    weights = handle.build().weights(torch.from_numpy(V)).numpy()[:, None]
    if kind == "vector":
        motion = weights * np.asarray(handle.motion["vector"], dtype=np.float64)
    elif kind == "along":
        motion = weights * handle.motion["distance"] * N
    else:
        return handle
    margin = MARGIN * float((bounds[1] - bounds[0]).max())
    ends = V + motion
    beyond = np.maximum(ends - (bounds[1] - margin), (bounds[0] + margin) - ends)
    # A point that is beyond the margin already may stay where it is.
    started = np.maximum(V - (bounds[1] - margin), (bounds[0] + margin) - V)
    outward = (beyond > 0) & (beyond > started)
    if not outward.any():
        return handle
    share = np.clip(-started[outward] / (beyond - started)[outward], 0, 1).min()
    if kind == "vector":
        return replace(handle, motion={"kind": kind, "vector": rounded(share * np.asarray(handle.motion["vector"]))})
    return replace(handle, motion={"kind": kind, "distance": round(float(share * handle.motion["distance"]), 6)})
