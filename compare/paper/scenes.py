"""Ready-made rigid edits of known shapes: which part is held, which is moved, and by how much.

The bunny's is that of the mesh notebook which the paper's author published: the tip of an ear is moved, the base held.
The paper does not say which handles its cactus has; ours moves an arm. On every other shape the two ends of the longest
side are taken, as by `default_cases`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.cases.handles import HandleSpec
from compare.cases.registry import OPERATIONS
from compare.cases.subject import Subject

# Energies of the paper's section 4.3, neural and mesh. The shape's name tells the scene.
PAPER = {"bunny": (320.0, 254.0), "cactus": (6.0, 11.0)}


def rigid_scene(shape: str, subject: Subject, *, quick: bool = False, **settings: Any) -> Case:
    """Return the rigid edit that belongs to a shape.

    Args:
        shape: As for Case; a file is known by its name.
        subject: The shape made ready, whose coordinates the handles are in.
        quick: Whether to spend little on it.
        settings: Further arguments of Case: vertices, resolution, seed.
    """
    make = SCENES.get(Path(shape).stem)
    if make is None:
        (case,) = default_cases(shape, subject.V, subject.N, operations=("rigid",), quick=quick, **settings)
        return case
    rules = OPERATIONS["rigid"]
    return Case(shape, "rigid", make(subject), rules.quick if quick else rules.full, **settings)


def pulled_less(case: Case, part: float) -> Case:
    """Return the same scene with its vectors a part as long, for motions so small that both editors are linear.

    Raises:
        ValueError: A handle moves otherwise than by a vector.
    """
    handles = []
    for number, handle in enumerate(case.handles, start=1):
        if handle.motion["kind"] != "vector":
            raise ValueError(
                f"Only motions by a vector can be shortened, but handle {number} moves by {handle.motion['kind']!r}."
            )
        handles.append(replace(handle, motion=_vector(part * np.asarray(handle.motion["vector"]))))
    return replace(case, handles=tuple(handles))


def _bunny(subject: Subject) -> tuple[HandleSpec, ...]:
    scale, offset = subject.scale, np.asarray(subject.field.units.offset)
    ear = (np.array([-0.02, 0.17, -0.015]) - offset) / scale  # in the units of the file, metres
    base = subject.V.min(axis=0) + np.array([0.0, 0.002, 0.0]) / scale
    return (
        HandleSpec(_half_space(base, np.array([0.0, -1.0, 0.0])), _vector(np.zeros(3))),
        HandleSpec(
            {"kind": "ball", "center": ear.tolist(), "radius": 0.03 / scale},
            _vector(np.array([0.01, 0.0, 0.01]) / scale),
        ),
    )


def _cactus(subject: Subject) -> tuple[HandleSpec, ...]:
    low, high = subject.V.min(axis=0), subject.V.max(axis=0)
    thin, wide, up = np.argsort(high - low)
    axes = np.eye(3)
    foot = low + 0.1 * (high - low)[up] * axes[up]
    arm = high - 0.2 * (high - low)[wide] * axes[wide]
    shift = 0.15 * (high - low)[up] * axes[thin]
    return (
        HandleSpec(_half_space(foot, -axes[up]), _vector(np.zeros(3))),
        HandleSpec(_half_space(arm, axes[wide]), _vector(shift)),
    )


SCENES: dict[str, Callable[[Subject], tuple[HandleSpec, ...]]] = {"bunny": _bunny, "cactus": _cactus}


def _half_space(point: Float[ndarray, " 3"], normal: Float[ndarray, " 3"]) -> dict[str, Any]:
    return {"kind": "halfspace", "point": point.tolist(), "normal": normal.tolist()}


def _vector(vector: Float[ndarray, " 3"]) -> dict[str, Any]:
    return {"kind": "vector", "vector": vector.tolist()}
