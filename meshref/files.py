"""Read and write triangle meshes: Wavefront .obj, .off, .ply, .stl and .glb; read .gltf, .3mf and .dae too.

A broken file ends in one MeshError that names the line. Writing goes to a side file that takes the place of the old one
at the end, so that an interruption loses nothing.
"""

from __future__ import annotations

import codecs
import os
import secrets
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from meshref.check import MeshError, as_arrays
from meshref.formats import obj, off, ply, scenes, stl
from meshref.formats.text import DamageError
from meshref.topology import FloatArray, IntArray

FORMATS = {".obj": obj, ".off": off, ".ply": ply, ".stl": stl}
# Read by other libraries: a scene of meshes becomes one mesh.
SCENES = {".glb": scenes.read_gltf, ".gltf": scenes.read_gltf, ".3mf": scenes.read_3mf, ".dae": scenes.read_dae}
READABLE = (*FORMATS, *SCENES)


def read_mesh(path: str | os.PathLike[str]) -> tuple[FloatArray, IntArray]:
    """Return vertices V (n, 3) and faces F (m, 3) of a mesh file.

    The order of vertices and faces is that of the file. Polygons are split into triangles within them, concave ones
    too. Texture coordinates, normals and colours are left out, so a seam of texture coordinates in an .obj does not
    tear the surface. An .stl file repeats the corners of every face; those with equal coordinates become one vertex.

    Args:
        path: A file whose name ends in .obj, .off, .ply or .stl, in capitals or not; .ply and .stl text or binary. Also
            .glb and .gltf, and with the packages of the extra "formats" .3mf and .dae; their scenes become one mesh.

    Raises:
        MeshError: The file is missing, empty, of another kind, damaged, or holds no triangle mesh. Coordinates that are
            not finite are let through, for check_mesh to name.
    """
    path = _as_path(path)
    suffix = path.suffix.lower()
    if suffix not in READABLE:
        raise MeshError(f"the file must end in {', '.join(READABLE)}, but is called {path.name!r}. Convert it first.")
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"there is no file {str(path)!r} seen from {os.getcwd()!r}. Check the path.") from None
    except IsADirectoryError:
        raise MeshError(f"{str(path)!r} is a directory. Give the file inside it.") from None
    except OSError as error:
        raise MeshError(f"the file {str(path)!r} cannot be read: {error.strerror}.") from None
    content = _without_mark(content)
    if not content.strip():
        raise MeshError(f"the file {str(path)!r} is empty. Write it again, to the end.")
    try:
        V, F = FORMATS[suffix].read(content) if suffix in FORMATS else SCENES[suffix](path, content)
    except DamageError as damage:
        raise MeshError(
            f"the file {str(path)!r} cannot be read as {suffix}: {damage}. Write it again, or mend that place."
        ) from None
    if len(V) == 0 or len(F) == 0:
        raise MeshError(
            f"the file {str(path)!r} holds no triangle mesh: it has {len(V)} vertices and {len(F)} faces. "
            "Is it a point cloud, or a text of another kind?"
        )
    wrong = np.argwhere((F < 0) | (len(V) <= F))
    if wrong.size:
        f, c = wrong[0]
        raise MeshError(
            f"the file {str(path)!r} is damaged: corner {c} of triangle {f} is vertex {F[f, c]}, counted from 0, but "
            f"the file has {len(V)} vertices. Was it cut short?"
        )
    return V, F


def _without_mark(content: bytes) -> bytes:
    """Return a text without the byte-order mark before it, and in bytes again if it was written in pairs of them."""
    if content.startswith(codecs.BOM_UTF8):
        return content[len(codecs.BOM_UTF8) :]
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            return content.decode("utf-16").encode("latin-1", "replace")
        except UnicodeDecodeError:  # bytes of a binary file, by chance
            return content
    return content


def write_mesh(
    path: str | os.PathLike[str],
    V: ArrayLike,
    F: ArrayLike,
    *,
    quality: ArrayLike | None = None,
    colours: ArrayLike | None = None,
) -> None:
    """Write a mesh; an existing file is replaced only once the new one is complete.

    Coordinates come back exactly, to the last bit, except from .stl, which knows single precision only (and writes
    every corner of every face, so shared vertices are told by equal coordinates) and .glb, in single precision too.

    Args:
        path: Where to; the ending .ply (binary), .obj, .off, .stl (binary) or .glb chooses the format.
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        quality: One number for each vertex, (n,), for .ply only: MeshLab shows it as the vertex quality.
        colours: Red, green and blue of each vertex, (n, 3), from 0 to 1, for .glb only: viewers show them.

    Raises:
        MeshError: The arrays are no mesh, the ending is unknown, or the file cannot be written.
    """
    path = _as_path(path)
    V, F = as_arrays(V, F)
    suffix = path.suffix.lower()
    if suffix not in (*FORMATS, ".glb"):
        raise MeshError(f"the file must end in {', '.join(FORMATS)} or .glb, but is called {path.name!r}.")
    if colours is not None and suffix != ".glb":
        raise MeshError(f"colours need a file ending in .glb, but it is called {path.name!r}.")
    values = None
    if quality is not None:
        try:
            values = np.asarray(quality, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise MeshError(f"quality must be a number for each vertex, but {error}.") from None
        if suffix != ".ply":
            raise MeshError(f"quality needs a file ending in .ply, but it is called {path.name!r}.")
        if values.shape != (len(V),):
            raise MeshError(f"quality must have shape ({len(V)},), a number for each vertex, but has {values.shape}.")
    if suffix == ".glb":
        try:
            content = scenes.written_glb(V, F, _colours(colours, len(V)))
        except DamageError as damage:
            raise MeshError(f"the file {str(path)!r} cannot be written: {damage}. Take another format.") from None
        replace_file(path, content)
        return
    replace_file(path, ply.written(V, F, values) if suffix == ".ply" else FORMATS[suffix].written(V, F))


def _colours(colours: ArrayLike | None, count: int) -> FloatArray | None:
    if colours is None:
        return None
    try:
        given = np.asarray(colours, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"colours must be three numbers for each vertex, but {error}.") from None
    if given.shape != (count, 3) or not bool(((given >= 0) & (given <= 1)).all()):
        raise MeshError(f"colours must be numbers from 0 to 1 of shape ({count}, 3), but have shape {given.shape}.")
    return given


def _as_path(path: str | os.PathLike[str]) -> Path:
    try:
        return Path(path)
    except TypeError:
        raise MeshError(f"path must be the name of a file, but is {path!r}.") from None


def replace_file(path: Path, content: bytes) -> None:
    """Write bytes to a file beside path, then move it there in one step.

    Raises:
        MeshError: The directory is missing, or cannot be written to.
    """
    side = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        try:
            with open(side, "xb") as file:
                _write_all(file, content)
            os.replace(side, path)
        finally:
            side.unlink(missing_ok=True)
    except OSError as error:
        raise MeshError(
            f"the file {str(path)!r} cannot be written: {error.strerror}. Name one in a folder that is there and may "
            "be written to, on a disk with room; what stood there before is untouched."
        ) from None


def _write_all(file: BinaryIO, content: bytes) -> None:
    file.write(content)
    file.flush()
    os.fsync(file.fileno())
