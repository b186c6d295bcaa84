"""Meshes made solid once: what a command, a fit and a comparison each ask for is mended the first time and remembered.

Mending looks for faces that pass through each other, which takes longest of all that comes before the training. What
one process has mended, others take from the run folder.
"""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal, TypeAlias
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.cases.case import content_of
from compare.errors import Progress, begin
from compare.files import replace_file

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


def mended(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], how: Mending, progress: Progress | None = None) -> Mended:
    """Return mend_mesh of a mesh, from memory where the same arrays were mended in the same way before.

    Args:
        V: Vertices.
        F: Faces.
        how: The choices.
        progress: Called as progress(step, steps, what) when each part of the work begins.

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
    result = meshref.mend_mesh(V, F, bodies=how.bodies, hole_limit=how.hole_limit, progress=progress)
    _remember_as(key, how, result)
    return result


def read_mended(
    path: str | Path, how: Mending, *, folder: Path | None = None, progress: Progress | None = None
) -> Mended:
    """Return the mended mesh of a file, from memory where the file has not been written since.

    Args:
        path: The file.
        how: The choices.
        folder: Where mended meshes are kept for other processes, and looked for; made if it is not there.
        progress: Called as progress(step, steps, what) when each part of the work begins.

    Raises:
        meshref.MeshError: It cannot be read or mended.
        OSError: The folder cannot be written to.
    """
    import meshref

    try:
        stat = Path(path).stat()
    except OSError:
        return mended(*meshref.read_mesh(path), how)  # which says what is wrong with the file
    key = f"{Path(path).absolute()} {stat.st_mtime_ns} {stat.st_size} {how}"
    file = None if folder is None else _file_of(path, how, folder)
    with _LOCK:
        result = _REMEMBERED.get(key)
    kept = file is not None and result is not None and file.is_file()
    if result is None and file is not None:
        result = _read_kept(file)
        if result is not None:
            kept = True
            _remember_as(key, how, result)
    if result is None:
        begin(progress, "reading")
        result = mended(*meshref.read_mesh(path), how, progress)
        _remember({key: result})
    if file is not None and not kept:
        _keep(file, result)
    return result


def _file_of(path: str | Path, how: Mending, folder: Path) -> Path:
    """Return where the mended mesh of a file as it is now is kept in a folder."""
    digest = hashlib.sha256(f"{content_of(str(path))} {how}".encode()).hexdigest()[:16]
    return folder / f"{Path(path).stem}-{digest}-mended.npz"


def _keep(file: Path, result: Mended) -> None:
    V, F, report = result
    row = {name: value for name, value in asdict(report).items() if name != "vertex_map"}
    content = BytesIO()
    np.savez(content, V=V, F=F, vertex_map=report.vertex_map, report=np.array(json.dumps(row)))
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_file(file, content.getvalue())


def _read_kept(file: Path) -> Mended | None:
    """Return what _keep wrote; None where there is none, or one that is damaged or of another version."""
    import meshref

    try:
        with np.load(file, allow_pickle=False) as arrays:
            row = json.loads(str(arrays["report"]))
            row = {name: tuple(value) if isinstance(value, list) else value for name, value in row.items()}
            return arrays["V"], arrays["F"], meshref.MendReport(vertex_map=arrays["vertex_map"], **row)
    except (OSError, ValueError, KeyError, TypeError, BadZipFile):
        return None


def _remember_as(key: str, how: Mending, result: Mended) -> None:
    """Remember a result under a key, and for what has become of the mesh, which is not mended again."""
    import meshref

    V, F, report = result
    for array in (V, F):
        array.flags.writeable = False  # they are handed out again
    again = replace(
        meshref.MendReport(
            steps=tuple(step for step in report.steps if step.startswith(OF_THE_RESULT)),
            vertex_map=np.arange(len(V)),
        ),
        bodies=report.bodies,
        cavities=report.cavities,
        self_intersections=report.self_intersections,
        hidden_area=report.hidden_area,
    )
    _remember({_key(V, F, how): (V, F, again), key: result})


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
