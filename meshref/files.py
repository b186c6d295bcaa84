"""Read and write triangle meshes: Wavefront .obj, .off, .ply and .stl.

The readers are our own, for libigl returns empty arrays for a text that is no mesh, and crashes on wrong indices;
a broken file ends in one MeshError that names the line. Writing goes to a side file that takes the place of the
old one at the end, so that an interruption loses nothing.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshref.check import MeshError, as_arrays, place
from meshref.topology import FloatArray, IntArray


def read_mesh(path: str | os.PathLike[str]) -> tuple[FloatArray, IntArray]:
    """Vertices V (n, 3) and faces F (m, 3) of a mesh file.

    The order of vertices and faces is that of the file. Polygons are split into a fan of triangles. Texture
    coordinates, normals and colours are left out, so a seam of texture coordinates in an .obj does not tear the
    surface. An .stl file repeats the corners of every face; those with equal coordinates become one vertex.

    Args:
        path: A file whose name ends in .obj, .off, .ply or .stl, in capitals or not; .ply and .stl text or binary.

    Raises:
        MeshError: The file is missing, empty, of another kind, damaged, or holds no triangle mesh. Coordinates that are
            not finite are let through, for check_mesh to name.
    """
    path = _as_path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise MeshError(f"the file must end in {', '.join(_READERS)}, but is called {path.name!r}. Convert it first.")
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise MeshError(f"there is no file {str(path)!r} seen from {os.getcwd()!r}. Check the path.") from None
    except IsADirectoryError:
        raise MeshError(f"{str(path)!r} is a directory. Give the file inside it.") from None
    except OSError as error:
        raise MeshError(f"the file {str(path)!r} cannot be read: {error.strerror}.") from None
    if not content.strip():
        raise MeshError(f"the file {str(path)!r} is empty. Write it again, to the end.")
    try:
        V, F = reader(content)
    except _DamageError as damage:
        raise MeshError(
            f"the file {str(path)!r} is no {path.suffix.lower()} mesh: {damage}. Write it again, or mend that place."
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


def write_mesh(path: str | os.PathLike[str], V: ArrayLike, F: ArrayLike, *, quality: ArrayLike | None = None) -> None:
    """Write a mesh; an existing file is replaced only once the new one is complete.

    Coordinates come back exactly, to the last bit, except from .stl, which knows single precision only (and writes
    every corner of every face, so shared vertices are told by equal coordinates).

    Args:
        path: Where to; the ending .ply (binary), .obj, .off or .stl (binary) chooses the format.
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        quality: One number for each vertex, (n,), for .ply only: MeshLab shows it as the vertex quality.

    Raises:
        MeshError: The arrays are no mesh, the ending is unknown, or the file cannot be written.
    """
    path = _as_path(path)
    V, F = as_arrays(V, F)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise MeshError(f"the file must end in {', '.join(_READERS)}, but is called {path.name!r}.")
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
    if suffix == ".ply":
        content = _ply_bytes(V, F, values)
    elif suffix == ".stl":
        content = _stl_bytes(V, F)
    else:
        content = _text_bytes(V, F, suffix)
    replace_file(path, content)


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


class _DamageError(Exception):
    """What is wrong inside a file; read_mesh adds the name of the file."""


def _lines(content: bytes) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(content.decode("latin-1").splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if words:
            yield number, words


def _numbers(words: list[str], line: int, kind: Callable[[str], float]) -> list[float]:
    try:
        return [kind(word) for word in words]
    except ValueError:
        raise _DamageError(f"line {line} has {' '.join(words)[:40]!r} where numbers should be") from None


def _as_mesh(vertices: list[list[float]], polygons: list[list[int]]) -> tuple[FloatArray, IntArray]:
    V = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    fans = [[p[0], p[k], p[k + 1]] for p in polygons for k in range(1, len(p) - 1)]
    try:
        return V, np.array(fans, dtype=np.int64).reshape(-1, 3)
    except OverflowError:
        raise _DamageError("a face names a vertex whose number has more than 18 digits") from None


def _read_obj(content: bytes) -> tuple[FloatArray, IntArray]:
    plain = _read_plain_obj(content)
    if plain is not None:
        return plain
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line, words in _lines(content):
        if words[0] == "v":
            point = _numbers(words[1:4], line, float)
            if len(point) < 3:
                raise _DamageError(f"line {line} has {len(point)} coordinates instead of 3")
            vertices.append(point)
        elif words[0] == "f":
            if len(words) < 4:
                raise _DamageError(f"line {line} has a face with {len(words) - 1} corners")
            corners = [int(i) for i in _numbers([word.split("/", 1)[0] for word in words[1:]], line, int)]
            # Counted from 1, or backwards from the last vertex so far.
            polygon = [i - 1 if i > 0 else len(vertices) + i for i in corners]
            if 0 in corners or min(polygon) < 0:
                raise _DamageError(f"line {line} names vertex {min(corners)}, but they are counted from 1")
            polygons.append(polygon)
    return _as_mesh(vertices, polygons)


def _read_plain_obj(content: bytes) -> tuple[FloatArray, IntArray] | None:
    """The usual file, of triangles counted from 1 with no more at their corners, in a fifth of the time; else None.

    Whatever is out of the ordinary, damage included, is left to the reader that goes line by line.
    """
    lines = content.splitlines()
    arrays: list[Any] = []
    for letter, kind in ((b"v", np.float64), (b"f", np.int64)):
        words = b" ".join([line for line in lines if line.startswith(letter + b" ")]).split()
        if len(words) % 4 or any(word != letter for word in words[::4]) or not words:
            return None
        try:
            arrays.append(np.array(words).reshape(-1, 4)[:, 1:].astype(kind))
        except (ValueError, OverflowError):
            return None
    V, F = arrays
    known = (b"v ", b"f ", b"#", b"vn", b"vt", b"o ", b"g ", b"s ", b"usemtl", b"mtllib")
    if F.min() < 1 or not all(line.startswith(known) for line in lines if line):
        return None
    return V, F - 1


def _read_off(content: bytes) -> tuple[FloatArray, IntArray]:
    lines = _lines(content)
    line, words = next(lines, (1, [""]))
    if words[0] not in ("OFF", "COFF", "NOFF", "CNOFF", "STOFF"):
        raise _DamageError(f"it must begin with the word OFF, but begins with {words[0][:20]!r}")
    words = words[1:]
    if words[:1] == ["BINARY"]:
        raise _DamageError("it is in the binary variant, which few programs read; save it as text")
    if not words:
        line, words = next(lines, (line, []))
    if len(words) < 2:
        raise _DamageError("the numbers of vertices and faces are missing")
    n, m = (int(i) for i in _numbers(words[:2], line, int))
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line, words in lines:
        if len(vertices) < n:
            point = _numbers(words[:3], line, float)
            if len(point) < 3:
                raise _DamageError(f"line {line} has {len(point)} coordinates instead of 3")
            vertices.append(point)
        elif len(polygons) < m:
            size = int(_numbers(words[:1], line, int)[0])
            if size < 3 or len(words) < 1 + size:
                raise _DamageError(f"line {line} has a face with {min(size, len(words) - 1)} corners")
            polygons.append([int(i) for i in _numbers(words[1 : 1 + size], line, int)])
        else:
            break
    if len(vertices) < n or len(polygons) < m:
        raise _DamageError(f"it ends after {len(vertices)} of {n} vertices and {len(polygons)} of {m} faces")
    return _as_mesh(vertices, polygons)


_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def _read_ply(content: bytes) -> tuple[FloatArray, IntArray]:
    if not content.startswith(b"ply"):
        raise _DamageError("it must begin with the word ply")
    end = content.find(b"end_header")
    body_at = content.find(b"\n", end) + 1
    if end < 0 or body_at == 0:
        raise _DamageError("its header does not end")
    encoding, elements = _ply_header(content[:end].decode("latin-1"))
    body = content[body_at:]
    if encoding == "ascii":
        source: _PlyAscii | _PlyBinary = _PlyAscii(body)
    else:
        source = _PlyBinary(body, "<" if encoding == "binary_little_endian" else ">")
    vertices, polygons = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    for name, count, properties in elements:
        table = source.read(name, count, properties)
        if name == "vertex":
            missing = [x for x in "xyz" if x not in table]
            if missing:
                raise _DamageError(f"its vertices have no property {missing[0]}")
            vertices = np.stack([np.asarray(table[x], dtype=np.float64) for x in "xyz"], axis=1)
        elif name == "face":
            lists = table.get("vertex_indices", table.get("vertex_index"))
            if lists is None:
                raise _DamageError("its faces have no property vertex_indices")
            if isinstance(lists, np.ndarray):
                k = lists.shape[1]
                fans = [lists[:, [0, i, i + 1]] for i in range(1, k - 1)]
                polygons = np.stack(fans, axis=1).reshape(-1, 3).astype(np.int64) if fans else polygons
            else:
                polygons = _as_mesh([], [_whole(p) for p in lists])[1]
    return vertices, polygons


_PlyProperty = tuple[str, str, str | None]  # name, type, type of the length if it is a list
_PlyTable = dict[str, "NDArray[np.generic] | list[list[float]]"]


def _ply_header(header: str) -> tuple[str, list[tuple[str, int, list[_PlyProperty]]]]:
    encoding = ""
    elements: list[tuple[str, int, list[_PlyProperty]]] = []
    for line, text in enumerate(header.splitlines(), start=1):
        words = text.split()
        try:
            if words[:1] == ["format"]:
                encoding = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], _count(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], _PLY_TYPES[words[1]], None))
        except (IndexError, KeyError, ValueError):
            raise _DamageError(f"line {line} of its header is {text[:40]!r}") from None
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise _DamageError(f"its format is {encoding!r}")
    return encoding, elements


def _whole(corners: list[float]) -> list[int]:
    if not all(corner.is_integer() for corner in map(float, corners)):
        raise _DamageError(f"a face has the corners {corners}, which are no numbers of vertices")
    return [int(corner) for corner in corners]


def _count(word: str) -> int:
    number = int(word)
    if number < 0:
        raise ValueError("a count below zero")
    return number


class _PlyAscii:
    def __init__(self, body: bytes) -> None:
        self._words = body.decode("latin-1").split()
        self._at = 0

    def read(self, name: str, count: int, properties: list[_PlyProperty]) -> _PlyTable:
        table: dict[str, list[list[float]]] = {p: [] for p, _, _ in properties}
        for _ in range(count):
            for p, _, length in properties:
                size = 1 if length is None else self._length(name)
                table[p].append(self._take(name, size))
        return {
            p: np.array(table[p], dtype=np.float64).reshape(-1) if length is None else table[p]
            for p, _, length in properties
        }

    def _length(self, name: str) -> int:
        (number,) = self._take(name, 1)
        if not 0 <= number <= len(self._words):
            raise _DamageError(f"its {name} table has a list of length {number}")
        return int(number)

    def _take(self, name: str, size: int) -> list[float]:
        words = self._words[self._at : self._at + size]
        self._at += size
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise _DamageError(f"its {name} table has {' '.join(words)[:40]!r} where numbers should be") from None
        if len(numbers) < size or size < 0:
            raise _DamageError(f"it ends in its {name} table")
        return numbers


class _PlyBinary:
    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def read(self, name: str, count: int, properties: list[_PlyProperty]) -> _PlyTable:
        if count == 0:
            return {p: np.zeros(0) for p, _, length in properties if length is None}
        # Lists mostly have one length throughout: then the table is one array. Its first row says which.
        fields, at = [], self._at
        for p, kind, length in properties:
            if length is None:
                fields.append((p, self._order + kind))
                at += np.dtype(kind).itemsize
            else:
                size = int(self._array(name, at, self._order + length, 1)[0])
                if not 0 <= size <= len(self._body):
                    raise _DamageError(f"its {name} table has a list of length {size}")
                fields += [(p + " length", self._order + length), (p, self._order + kind, (size,))]  # type: ignore[list-item]
                at += np.dtype(length).itemsize + size * np.dtype(kind).itemsize
        lists = [p for p, _, length in properties if length is not None]
        row = np.dtype(fields)
        if self._at + count * row.itemsize <= len(self._body):
            table = np.frombuffer(self._body, row, count, self._at)
            if all((table[p + " length"] == table[p + " length"][0]).all() for p in lists):
                self._at += count * row.itemsize
                return {p: table[p] for p, _, _ in properties}
        elif not lists:
            raise _DamageError(f"it ends in its {name} table")
        return self._read_ragged(name, count, properties)

    def _read_ragged(self, name: str, count: int, properties: list[_PlyProperty]) -> _PlyTable:
        table: dict[str, list[list[float]]] = {p: [] for p, _, _ in properties}
        for _ in range(count):
            for p, kind, length in properties:
                size = 1
                if length is not None:
                    size = int(self._array(name, self._at, self._order + length, 1)[0])
                    self._at += np.dtype(length).itemsize
                table[p].append(self._array(name, self._at, self._order + kind, size).tolist())
                self._at += size * np.dtype(kind).itemsize
        return {
            p: np.array(table[p], dtype=np.float64).reshape(-1) if length is None else table[p]
            for p, _, length in properties
        }

    def _array(self, name: str, at: int, kind: str, size: int) -> NDArray[np.generic]:
        if size < 0 or at + size * np.dtype(kind).itemsize > len(self._body):
            raise _DamageError(f"it ends in its {name} table")
        return np.frombuffer(self._body, kind, size, at)


_STL_ROW = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def _read_stl(content: bytes) -> tuple[FloatArray, IntArray]:
    count = int.from_bytes(content[80:84], "little")
    # The length decides: binary files beginning with the word "solid" are common.
    if len(content) >= 84 and len(content) == 84 + count * _STL_ROW.itemsize:
        corners = np.frombuffer(content, _STL_ROW, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    elif content.lstrip()[:5].lower() == b"solid":
        points = [_numbers(words[1:4], line, float) for line, words in _lines(content) if words[0].lower() == "vertex"]
        if any(len(p) != 3 for p in points) or len(points) % 3:
            raise _DamageError(f"it has {len(points)} corners, which make no whole triangles. Was it cut short")
        corners = np.array(points, dtype=np.float64).reshape(-1, 3)
    else:
        raise _DamageError(f"it has {len(content)} bytes, which fits neither text nor binary. Was it cut short")
    if len(corners) == 0:
        return corners, np.zeros((0, 3), dtype=np.int64)
    return merge_equal(corners, np.arange(len(corners)).reshape(-1, 3))


def merge_equal(V: FloatArray, F: IntArray) -> tuple[FloatArray, IntArray]:
    """One vertex for all that have equal coordinates, in the order of their first appearance."""
    _, first, of_vertex = np.unique(V + 0.0, axis=0, return_index=True, return_inverse=True)  # -0 becomes 0
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return V[first[order]], rank[of_vertex.reshape(-1)][F].astype(np.int64)


def _text_bytes(V: FloatArray, F: IntArray, suffix: str) -> bytes:
    # repr is the shortest text that comes back to the last bit.
    points = [" ".join(map(repr, p)) for p in V.tolist()]
    if suffix == ".off":
        corners = [f"3 {a} {b} {c}" for a, b, c in F.tolist()]
        return "\n".join(["OFF", f"{len(V)} {len(F)} 0", *points, *corners, ""]).encode()
    corners = [f"f {a} {b} {c}" for a, b, c in (F + 1).tolist()]
    return "\n".join([*(f"v {p}" for p in points), *corners, ""]).encode()


def _ply_bytes(V: FloatArray, F: IntArray, quality: FloatArray | None) -> bytes:
    names = ["x", "y", "z"] + ([] if quality is None else ["quality"])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(V)}"]
    header += [f"property double {name}" for name in names]
    header += [f"element face {len(F)}", "property list uchar int vertex_indices", "end_header", ""]
    points = V if quality is None else np.column_stack([V, quality])
    faces = np.empty(len(F), dtype=[("length", "u1"), ("corners", "<i4", (3,))])
    faces["length"], faces["corners"] = 3, F
    return "\n".join(header).encode() + points.astype("<f8").tobytes() + faces.tobytes()


def _stl_bytes(V: FloatArray, F: IntArray) -> bytes:
    largest = np.abs(V).max()
    if largest > np.finfo(np.float32).max:
        far = V[np.abs(V).max(axis=1).argmax()]
        raise MeshError(f"the point {place(far)} is too far away for the single precision of .stl. Write .ply instead.")
    rows = np.zeros(len(F), dtype=_STL_ROW)
    rows["corners"] = V[F]
    normal = np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    return b"written by meshref".ljust(80) + len(F).to_bytes(4, "little") + rows.tobytes()


_READERS: dict[str, Callable[[bytes], tuple[FloatArray, IntArray]]] = {
    ".obj": _read_obj, ".off": _read_off, ".ply": _read_ply, ".stl": _read_stl
}  # fmt: skip
