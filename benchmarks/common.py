"""Parts that the benchmarks share: fields and meshes of one shape, rules to leave some out, counted evaluations."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from unittest import mock

import numpy as np
import torch

import implicit
from compare.paper.rigidity import mesh_of
from implicit import shapes

DEVICES = ("cpu", "cuda")
VERTICES = (3_500, 35_000, 140_000)


def sizes(*lists: Sequence[object]) -> tuple[list[object], ...]:
    """The values of the parameters of a benchmark; with BENCHMARKS_QUICK set, the first of each alone."""
    return tuple(list(values[:1] if is_quick() else values) for values in lists)


def leave_out_if_slow() -> None:
    """For the setup of what takes long at any size: with BENCHMARKS_QUICK set, asv skips it."""
    if is_quick():
        raise NotImplementedError("BENCHMARKS_QUICK is set")


def is_quick() -> bool:
    return bool(os.environ.get("BENCHMARKS_QUICK"))


def require(device: str) -> None:
    """For the setup of what runs on a device: where there is none, asv skips it."""
    if device == "cuda" and not torch.cuda.is_available():
        raise NotImplementedError("no CUDA device")


def spot(dtype: str = "float32", device: str = "cpu") -> implicit.Field:
    """The bundled cow, a network of P = 2273 parameters."""
    require(device)
    return shapes.bundled("spot").to(getattr(torch, dtype), device)


@cache
def spot_meshes() -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Even meshes of the same surface, by about how many vertices they have."""
    field = spot("float64")
    return {n: mesh_of(field, n) for n in VERTICES if n == VERTICES[0] or not is_quick()}


def pull(V: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Handles at the feet and on the head of the cow, (h,), and their displacements: held, and moved sideways."""
    low, high = np.quantile(V[:, 1], [0.1, 0.9])
    handles = np.flatnonzero((V[:, 1] < low) | (V[:, 1] > high))
    return handles, np.where(V[handles, 1:2] > high, [[0.1, 0.0, 0.0]], 0.0)


@contextmanager
def evaluations() -> Iterator[list[int]]:
    """Points at which a field is evaluated inside the block, with and without its gradient: a list to sum."""
    counts: list[int] = []
    with (
        mock.patch.object(implicit.Field, "value", _counting(implicit.Field.value, counts)),
        mock.patch.object(implicit.Field, "value_and_gradient", _counting(implicit.Field.value_and_gradient, counts)),
    ):
        yield counts


def _counting(method, counts):
    def counted(self, points, **options):
        counts.append(len(points))
        return method(self, points, **options)

    return counted
