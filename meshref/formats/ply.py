"""Stanford .ply: a header that names tables and their columns, then these, as text or binary."""

from __future__ import annotations

import re
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from meshref.formats.polygons import triangulated
from meshref.formats.text import DamageError
from meshref.topology import FloatArray, IntArray

# In a line of its own, which may end as on any system.
END_OF_HEADER = re.compile(rb"(?:\r\n|\n|\r)[ \t]*end_header[ \t]*(?:\r\n|\n|\r)")

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


Property = tuple[str, str, str | None]  # name, type, type of the length if it is a list
Column: TypeAlias = "NDArray[np.generic] | list[list[float]]"
Table: TypeAlias = dict[str, Column]


def read(content: bytes) -> tuple[FloatArray, IntArray]:
    """Return vertices and triangles of a file's content."""
    if not content.startswith(b"ply"):
        raise DamageError("it must begin with the word ply")
    end = END_OF_HEADER.search(content)
    if end is None:
        raise DamageError("its header does not end")
    encoding, elements = _header(content[: end.start()])
    body = content[end.end() :]
    if encoding == "ascii":
        source: Ascii | Binary = Ascii(body)
    else:
        source = Binary(body, "<" if encoding == "binary_little_endian" else ">")
    tables = {name: source.read(name, count, properties) for name, count, properties in elements}
    vertices = tables.get("vertex", {x: np.zeros(0) for x in "xyz"})
    missing = [x for x in "xyz" if x not in vertices]
    if missing:
        raise DamageError(f"its vertices have no property {missing[0]}")
    V = np.stack([np.asarray(vertices[x], dtype=np.float64) for x in "xyz"], axis=1)
    faces = [np.zeros((0, 3), dtype=np.int64)]
    if "face" in tables:
        lists = _corners(tables["face"], "faces")
        if isinstance(lists, np.ndarray):
            faces.append(triangulated(V, lists.astype(np.int64)))
        else:
            faces.append(triangulated(V, [_whole(polygon) for polygon in lists]))
    for name in ("tristrips", "tristrip"):
        if name in tables:
            lists = _corners(tables[name], "strips of triangles")
            faces += [_strips(_whole(list(map(float, strip)))) for strip in lists]
    return V, np.concatenate(faces)


def _corners(table: Table, what: str) -> Column:
    lists = table.get("vertex_indices", table.get("vertex_index"))
    if lists is None:
        raise DamageError(f"its {what} have no property vertex_indices")
    return lists


def _strips(corners: list[int]) -> IntArray:
    """Return the triangles of strips that end with -1: each further corner makes one with the last two, by turns."""
    strip = np.array(corners, dtype=np.int64)
    strip[strip == 2**32 - 1] = -1  # as an unsigned number
    F = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
    place = np.arange(len(strip))
    start = np.maximum.accumulate(np.where(np.roll(strip, 1) == -1, place, 0))  # of the strip that each belongs to
    turned = (place - start)[:-2] % 2 == 1
    F[turned] = F[turned][:, [1, 0, 2]]
    whole = (F >= 0).all(axis=1)
    return F[whole & (np.roll(F, 1, axis=1) != F).all(axis=1)]  # strips turn corners by triangles without area


def _header(header: bytes) -> tuple[str, list[tuple[str, int, list[Property]]]]:
    encoding = ""
    elements: list[tuple[str, int, list[Property]]] = []
    for line, text in enumerate((row.decode("latin-1") for row in header.splitlines()), start=1):
        words = text.split()
        try:
            if words[:1] == ["format"]:
                encoding = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], _count(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1][2].append((words[4], TYPES[words[3]], TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1][2].append((words[2], TYPES[words[1]], None))
        except (IndexError, KeyError, ValueError):
            raise DamageError(f"line {line} of its header is {text[:40]!r}") from None
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise DamageError(f"its format is {encoding!r}")
    return encoding, elements


def _whole(corners: list[float]) -> list[int]:
    if not all(corner.is_integer() for corner in map(float, corners)):
        raise DamageError(f"a face has the corners {corners}, which are no numbers of vertices")
    return [int(corner) for corner in corners]


def _count(word: str) -> int:
    number = int(word)
    if number < 0:
        raise ValueError("a count below zero")
    return number


class Ascii:
    def __init__(self, body: bytes) -> None:
        self._words = body.decode("latin-1").split()
        self._at = 0

    def read(self, name: str, count: int, properties: list[Property]) -> Table:
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
            raise DamageError(f"its {name} table has a list of length {number}")
        return int(number)

    def _take(self, name: str, size: int) -> list[float]:
        words = self._words[self._at : self._at + size]
        self._at += size
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            raise DamageError(f"its {name} table has {' '.join(words)[:40]!r} where numbers should be") from None
        if len(numbers) < size or size < 0:
            raise DamageError(f"it ends in its {name} table")
        return numbers


class Binary:
    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def read(self, name: str, count: int, properties: list[Property]) -> Table:
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
                    raise DamageError(f"its {name} table has a list of length {size}")
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
            raise DamageError(f"it ends in its {name} table")
        return self._read_ragged(name, count, properties)

    def _read_ragged(self, name: str, count: int, properties: list[Property]) -> Table:
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
            raise DamageError(f"it ends in its {name} table")
        return np.frombuffer(self._body, kind, size, at)


def written(V: FloatArray, F: IntArray, quality: FloatArray | None = None) -> bytes:
    """Return the content of a binary file, with a number for each vertex if there is one."""
    names = ["x", "y", "z"] + ([] if quality is None else ["quality"])
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(V)}"]
    header += [f"property double {name}" for name in names]
    header += [f"element face {len(F)}", "property list uchar int vertex_indices", "end_header", ""]
    points = V if quality is None else np.column_stack([V, quality])
    faces = np.empty(len(F), dtype=[("length", "u1"), ("corners", "<i4", (3,))])
    faces["length"], faces["corners"] = 3, F
    return "\n".join(header).encode() + points.astype("<f8").tobytes() + faces.tobytes()
