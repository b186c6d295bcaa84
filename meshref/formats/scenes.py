"""Scenes of several meshes, each in its place: .glb, which is written too, and .gltf, .3mf, .dae.

Read by trimesh, and .dae by pycollada with polygons split as those of all formats. What these would pass over without
a word is refused first: compressed, sparse or normalised coordinates of glTF, and primitives that are no triangles.
"""

from __future__ import annotations

import importlib
import json
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np

from meshref.formats.polygons import triangulated
from meshref.formats.stl import merge_equal
from meshref.formats.text import DamageError
from meshref.topology import FloatArray, IntArray

Part = tuple[FloatArray, IntArray]

TRIANGLES, STRIP = 4, 5  # modes of glTF


def read_gltf(path: Path, content: bytes) -> Part:
    """Return vertices and triangles of all meshes of a .glb or .gltf, where its nodes put them."""
    expected = _require_plain(_header(content))
    scene = _by_trimesh(path, skip_materials=True)
    found = sum(len(g.faces) for g in scene.geometry.values() if hasattr(g, "faces"))
    if found != expected:
        raise DamageError(f"trimesh reads {found} of its {expected} triangles")
    return _joined(_placed(scene))


def read_3mf(path: Path, content: bytes) -> Part:
    """Return vertices and triangles of all objects of a .3mf, where its build puts them."""
    _require("lxml", ".3mf")
    _require_plain_objects(content)
    return _joined(_placed(_by_trimesh(path)))


def read_dae(path: Path, content: bytes) -> Part:
    """Return vertices and triangles of all geometries of a .dae, where its scene puts them."""
    _require("lxml", ".dae")
    collada: Any = _require("collada", ".dae")
    if b"<ph>" in content:  # which the reader leaves out
        raise DamageError("it has polygons with holes in them. Write triangles")
    scene = _foreign(lambda: collada.Collada(str(path)).scene)
    if scene is None:
        raise DamageError("it holds no scene that says where its geometries are")
    return _joined(_foreign(lambda: list(_collada_parts(scene))))


def written_glb(V: FloatArray, F: IntArray, colours: FloatArray | None) -> bytes:
    """Return a .glb of one mesh, with a colour a vertex if given; what it says it holds is looked at again."""
    trimesh = importlib.import_module("trimesh")
    # By whole numbers, for trimesh takes what is not above 1 for them too.
    colour = None if colours is None else np.round(255 * np.column_stack([colours, np.ones(len(V))])).astype(np.uint8)
    content = bytes(trimesh.Trimesh(V, F, vertex_colors=colour, process=False).export(file_type="glb"))
    found = _require_plain(_header(content))
    if found != len(F):
        raise DamageError(f"trimesh writes {found} of {len(F)} triangles")
    return content


def _collada_parts(scene: Any) -> Iterator[Part]:
    if next(iter(scene.objects("controller")), None) is not None:
        raise DamageError("a skeleton or targets move its geometries. Apply their pose and write it without")
    for geometry in scene.objects("geometry"):
        mirrored = np.linalg.det(np.asarray(geometry.matrix, dtype=np.float64)[:3, :3]) < 0
        for primitive in geometry.primitives():
            corners = np.asarray(getattr(primitive, "vertex_index", ()))
            V = np.asarray(primitive.vertex, dtype=np.float64)
            if hasattr(primitive, "polyindex"):
                flat = corners.ravel().tolist()
                F = triangulated(V, [flat[start:end] for start, end in np.asarray(primitive.polyindex).tolist()])
            elif corners.ndim == 2 and corners.shape[1] == 3:
                F = corners.astype(np.int64)
            else:
                continue  # lines and points
            yield V, F[:, ::-1] if mirrored else F  # a mirror turns faces round


def _header(content: bytes) -> dict[str, Any]:
    if content[:4] == b"glTF":
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    try:
        header = json.loads(content)
    except (ValueError, RecursionError):
        raise DamageError("it holds no description in JSON") from None
    if not isinstance(header, dict):
        raise DamageError("its description is no object of JSON")
    return header


def _require_plain(header: dict[str, Any]) -> int:
    """Return the number of triangles of all meshes, and refuse what would be read wrong."""
    required = [name for name in header.get("extensionsRequired", []) if "mesh" in name or "draco" in name]
    if required:
        raise DamageError(f"it needs {required[0]}, coordinates in a compressed form. Write it without")
    accessors = header.get("accessors", [])
    count = 0
    try:
        _require_at_rest(header)
        for primitive in (p for mesh in header.get("meshes", []) for p in mesh["primitives"]):
            mode, position = primitive.get("mode", TRIANGLES), accessors[primitive["attributes"]["POSITION"]]
            if mode not in (TRIANGLES, STRIP):
                raise DamageError(f"it has primitives of mode {mode}, which are no triangles. Write triangles")
            used = [position, *([accessors[primitive["indices"]]] if "indices" in primitive else [])]
            if any("sparse" in accessor or "bufferView" not in accessor for accessor in used):
                raise DamageError("it has sparse coordinates or indices. Write them in full")
            if position.get("componentType") != 5126:  # float
                raise DamageError("its coordinates are whole numbers. Write it without quantisation")
            corners = int(used[-1]["count"])
            count += corners // 3 if mode == TRIANGLES else max(corners - 2, 0)
    except (KeyError, IndexError, TypeError, AttributeError):
        raise DamageError("its description names parts that are not there") from None
    return count


def _require_at_rest(header: dict[str, Any]) -> None:
    """Refuse glTF whose meshes are elsewhere than their coordinates and their nodes say."""
    nodes = [node for node in header.get("nodes", []) if "mesh" in node]
    if any("skin" in node for node in nodes):
        raise DamageError("a skeleton moves its meshes. Apply its pose and write it without")
    if any(any(owner.get("weights", ())) for owner in (*nodes, *header.get("meshes", []))):
        raise DamageError("targets move its meshes (morphing). Apply them and write it without")
    if any("EXT_mesh_gpu_instancing" in node.get("extensions", {}) for node in nodes):
        raise DamageError("its nodes are repeated by EXT_mesh_gpu_instancing. Write each as a node of its own")


def _require_plain_objects(content: bytes) -> None:
    """Refuse a .3mf that has objects which are no part of the shape, or in several files under one number, which the
    reader takes for each other."""
    owners: dict[str, str] = {}
    built = 0
    with _foreign(lambda: ZipFile(BytesIO(content))) as files:
        for name in files.namelist():
            if not name.lower().endswith(".model"):
                continue
            for element in _foreign(partial(_elements, files, name)):
                tag = element.tag.rpartition("}")[2]
                built += tag == "item"
                if tag != "object":
                    continue
                kind, number = element.get("type", "model"), element.get("id", "")
                if kind != "model":
                    raise DamageError(f"its object {number} is of the type {kind}. Write the model alone")
                if owners.setdefault(number, name) != name:
                    raise DamageError(f"both {owners[number]} and {name} in it have an object {number}. Write one file")
    if built == 0:
        raise DamageError("it has no items to be built, so no shape")


def _elements(files: ZipFile, name: str) -> list[ElementTree.Element]:
    return list(ElementTree.fromstring(files.read(name)).iter())


def _by_trimesh(path: Path, **options: Any) -> Any:
    trimesh = importlib.import_module("trimesh")
    return _foreign(lambda: trimesh.load_scene(path, process=False, **options))


def _foreign(read: Callable[[], Any]) -> Any:
    """Return what another library reads; whatever it raises of a damaged file is a DamageError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PendingDeprecationWarning)  # pycollada's use of numpy.matrix
            return read()
    except DamageError:
        raise
    except Exception as error:
        words = " ".join(str(error).split())
        raise DamageError(f"its reader says {type(error).__name__}{f': {words[:120]}' if words else ''}") from None


def _placed(scene: Any) -> Iterator[Part]:
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces"):
            continue  # lines and points
        V = np.asarray(geometry.vertices, dtype=np.float64) @ transform[:3, :3].T + transform[:3, 3]
        F = np.asarray(geometry.faces, dtype=np.int64)
        yield V, F[:, ::-1] if np.linalg.det(transform[:3, :3]) < 0 else F  # a mirror turns faces round


def _joined(parts: Any) -> Part:
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for V, F in parts:
        if F.size and (F.min() < 0 or F.max() >= len(V)):
            raise DamageError(f"a face names vertex {F.max()}, counted from 0, but its mesh has {len(V)}")
        V, F = merge_equal(V, F)  # seams of normals and of texture coordinates do not tear the surface
        vertices.append(V)
        faces.append(F + count)
        count += len(V)
    return np.concatenate(vertices), np.concatenate(faces)


def _require(library: str, suffix: str) -> Any:
    try:
        return importlib.import_module(library)
    except ImportError:
        raise DamageError(
            f'a {suffix} file needs {library}, which is not installed: pip install ".[formats]"'
        ) from None
