"""Meshes made solid once: what a command, a fit and a comparison each ask for is mended the first time and remembered.

Mending looks for faces that pass through each other, which takes longest of all that comes before the training.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

if TYPE_CHECKING:  # the commands read Mending before anything else, and meshref takes as long as all of them to import
    from meshref import MendReport

Bodies = Literal["keep", "largest", "refuse"]
Mended: TypeAlias = "tuple[Float[ndarray, 'k 3'], Int[ndarray, 'l 3'], MendReport]"

REMEMBERED = 6  # results; each mesh has three: by its file, as it was given, and as it has become, which share arrays

# How sentences begin that tell of the mesh as it is, and are said again of a mesh that is mended already.
OF_THE_RESULT = ("kept", "took", "found")


@dataclass(frozen=True)
class Mending:
    """Choices that mend_mesh leaves to the user, as they stand among the options of a fit."""

    bodies: Bodies = "refuse"
    hole_limit: float = 1.0


_REMEMBERED: OrderedDict[str, Mended] = OrderedDict()
_LOCK = Lock()


def mended(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], how: Mending) -> Mended:
    """Return mend_mesh of a mesh, from memory where the same arrays were mended in the same way before.

    Raises:
        meshref.MeshError: The mesh cannot be mended.
    """
    import meshref

    if not _is_numeric(V) or not _is_numeric(F):
        return meshref.mend_mesh(V, F, bodies=how.bodies, hole_limit=how.hole_limit)  # which says what is wrong
    key = _key(V, F, how)
    with _LOCK:
        if key in _REMEMBERED:
            _REMEMBERED.move_to_end(key)
            return _REMEMBERED[key]
    solid_V, solid_F, report = meshref.mend_mesh(V, F, bodies=how.bodies, hole_limit=how.hole_limit)
    for array in (solid_V, solid_F):
        array.flags.writeable = False  # they are handed out again
    again = replace(
        meshref.MendReport(
            steps=tuple(step for step in report.steps if step.startswith(OF_THE_RESULT)),
            vertex_map=np.arange(len(solid_V)),
        ),
        bodies=report.bodies,
        cavities=report.cavities,
        self_intersections=report.self_intersections,
        hidden_area=report.hidden_area,
    )
    result = solid_V, solid_F, report
    _remember({_key(solid_V, solid_F, how): (solid_V, solid_F, again), key: result})
    return result


def read_mended(path: str | Path, how: Mending) -> Mended:
    """Return the mended mesh of a file, from memory where the file has not been written since.

    Raises:
        meshref.MeshError: It cannot be read or mended.
    """
    import meshref

    try:
        stat = Path(path).stat()
    except OSError:
        return mended(*meshref.read_mesh(path), how)  # which says what is wrong with the file
    key = f"{Path(path).absolute()} {stat.st_mtime_ns} {stat.st_size} {how}"
    with _LOCK:
        if key in _REMEMBERED:
            return _REMEMBERED[key]
    result = mended(*meshref.read_mesh(path), how)
    _remember({key: result})
    return result


def _remember(results: Mapping[str, Mended]) -> None:
    with _LOCK:
        _REMEMBERED.update(results)
        while len(_REMEMBERED) > REMEMBERED:
            _REMEMBERED.popitem(last=False)


def _is_numeric(array: Any) -> bool:
    """Return whether the bytes of an array are its numbers."""
    try:
        return np.asarray(array).dtype.kind in "fiu"
    except (ValueError, TypeError):
        return False


def _key(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], how: Mending) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for array in (V, F):
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype} {array.shape};".encode())
        digest.update(array.tobytes())
    digest.update(repr(how).encode())
    return digest.hexdigest()
