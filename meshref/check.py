"""The gate that every mesh passes before it reaches libigl, which checks nothing and crashes the interpreter.

A mesh is V (n, 3) float64, the vertices, and F (m, 3) int64, the corners of each face, counterclockwise seen from
outside: normals point out, and the signed volume is positive.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any, Literal

import igl
import igl.predicates
import numpy as np
from numpy.typing import ArrayLike

from meshref.printing import counted
from meshref.topology import (
    BoolArray,
    FloatArray,
    IntArray,
    corner_fans,
    disagreeing_pairs,
    edge_table,
    vertex_components,
)

# libigl finds cotangents from edge lengths (Heron), which loses everything once the height of a triangle is
# below the square root of the rounding unit times its longest edge: it then returns nan without a word.
FLATTEST_FACE = 1e-8


# Coordinates up to here have finite cubes, and boxes from here on areas and volumes that are not lost to zero.
LARGEST_COORDINATE = 1e100
SMALLEST_SIZE = 1e-100


class MeshError(ValueError):
    """A mesh, a file or a set of handles cannot be used as asked; the message says where and what to do."""


def check_mesh(
    V: ArrayLike,
    F: ArrayLike,
    *,
    closed: bool = False,
    oriented: bool = False,
    degenerate: Literal["refuse", "allow"] = "refuse",
    self_intersections: Literal["refuse", "allow"] = "allow",
) -> tuple[FloatArray, IntArray]:
    """Return V and F as float64 and int64 arrays that are safe to hand on, or refuse them with the reason.

    Always asked: the right shapes, finite coordinates, indices in range, every vertex used by a face.

    Args:
        V: Vertices, (n, 3), in any unit of length.
        F: Faces, (m, 3), whole numbers from 0 to n - 1.
        closed: Also ask for the surface of a solid: every edge between two faces of opposite direction, one fan
            of faces round each vertex, faces oriented outwards (signed volume > 0). Implies oriented.
        oriented: Also ask that an edge has at most two faces, and that these run along it in opposite directions.
        degenerate: Whether faces without area are let through (their height is below 1e-8 of their longest edge).
        self_intersections: Whether faces that pass through each other are let through. The test is exact.

    Returns:
        V and F, C-contiguous; the arrays given where they already were, copies otherwise.

    Raises:
        MeshError: Something asked for is not so. The message names the first place.
    """
    require_choice("degenerate", degenerate, ("refuse", "allow"))
    require_choice("self_intersections", self_intersections, ("refuse", "allow"))
    V, F = as_arrays(V, F)
    _require_every_vertex_used(len(V), F)
    if degenerate == "refuse":
        _require_area(V, F)
    if oriented or closed:
        _require_oriented(V, F, closed=closed)
    if closed:
        _require_solid(V, F)
    if self_intersections == "refuse":
        pairs = intersecting_faces(V, F)
        if len(pairs):
            raise MeshError(
                f"faces must not pass through each other, but {counted(len(pairs), 'pair does', 'pairs do')}, "
                f"first faces {pairs[0, 0]} and "
                f"{pairs[0, 1]} near {place(V[F[pairs[0, 0], 0]])}. Separate them in a mesh editor, or remesh."
            )
    return V, F


def as_arrays(V: ArrayLike, F: ArrayLike) -> tuple[FloatArray, IntArray]:
    """Return V and F with the right shapes and number types, finite coordinates, and indices in range."""
    vertices = finite_points(V, "V", "vertices")
    faces = _as_int64(F)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshError(
            f"F must have shape (m, 3), a row a triangle, but has shape {faces.shape}. Split polygons into triangles."
        )
    if len(vertices) == 0 or len(faces) == 0:
        raise MeshError(
            f"a mesh needs vertices and faces, but V has {len(vertices)} and F has {len(faces)} rows. "
            "Was the file a point cloud, or empty?"
        )
    wrong = np.argwhere((faces < 0) | (faces >= len(vertices)))
    if wrong.size:
        f, c = wrong[0]
        raise MeshError(
            f"F must index the {len(vertices)} rows of V, from 0 to {len(vertices) - 1}, but F[{f}, {c}] = "
            f"{faces[f, c]}. Files that count from 1 need F - 1."
        )
    size = float((vertices.max(axis=0) - vertices.min(axis=0)).max())
    if size < SMALLEST_SIZE:
        raise MeshError(
            f"V must span a box, but its longest side is {size:.3g}. Are all vertices in one place? Otherwise take "
            "another unit of length."
        )
    return vertices, faces


def finite_points(points: ArrayLike, name: str, what: str) -> FloatArray:
    """Return points as a float64 array of shape (k, 3), all finite."""
    try:
        array = np.asarray(points)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"its numbers are {array.dtype}")
        array = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{name} must be an array of real numbers, the {what}, but {error}.") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"{name} must have shape (k, 3), a row for each of the {what}, but has shape {array.shape}.")
    wrong = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if wrong.size:
        raise MeshError(
            f"{name} must be finite, but {counted(len(wrong), 'row is', 'rows are')} not, first {name}[{wrong[0]}] = "
            f"{place(array[wrong[0]])}. Repair the program or the file that wrote them; they cannot be guessed."
        )
    if np.abs(array).max(initial=0.0) > LARGEST_COORDINATE:
        raise MeshError(
            f"{name} must stay below {LARGEST_COORDINATE:g}, so that volumes are finite numbers, but goes up to "
            f"{np.abs(array).max():.3g}. Take another unit of length."
        )
    return array


def vertex_indices(indices: ArrayLike, n_vertices: int, name: str = "handles") -> IntArray:
    """Return distinct vertex numbers as an int64 array of shape (h,)."""
    array = _as_int64(indices, name)
    if array.ndim != 1 or len(array) == 0:
        raise MeshError(f"{name} must be a list of one or more vertex numbers, but has shape {array.shape}.")
    wrong = np.flatnonzero((array < 0) | (array >= n_vertices))
    if wrong.size:
        raise MeshError(
            f"{name} must be vertex numbers from 0 to {n_vertices - 1}, but {name}[{wrong[0]}] = {array[wrong[0]]}."
        )
    values, first, count = np.unique(array, return_index=True, return_counts=True)
    if len(values) < len(array):
        i = int(np.argmax(count > 1))
        raise MeshError(
            f"{name} must name each vertex once, but vertex {values[i]} appears {count[i]} times, first at "
            f"{name}[{first[i]}]. Where handles overlap, decide which displacement counts."
        )
    return array


def handle_vectors(vectors: ArrayLike, handles: IntArray, name: str) -> FloatArray:
    """Return one finite vector for each handle vertex, (h, 3)."""
    array = finite_points(vectors, name, "handles")
    if len(array) != len(handles):
        raise MeshError(f"{name} must have a row for each of the {len(handles)} handles, but has {len(array)} rows.")
    return array


def vertex_field(field: ArrayLike, V: FloatArray, name: str = "D") -> FloatArray:
    """Return one finite vector for each vertex, (n, 3)."""
    array = finite_points(field, name, "vertices")
    if len(array) != len(V):
        raise MeshError(f"{name} must have a row for each of the {len(V)} vertices, but has {len(array)} rows.")
    return array


def require_handle_on_each_part(V: FloatArray, F: IntArray, handles: IntArray) -> None:
    """Refuse handles that leave a connected part of the mesh without any.

    Raises:
        MeshError: A part has no handle; the message names one of its vertices.
    """
    parts, part = vertex_components(F, len(V))
    without = np.setdiff1d(np.arange(parts), part[handles])
    if without.size:
        vertex = int(np.argmax(part == without[0]))
        raise MeshError(
            f"every connected part of the mesh needs a handle vertex, but {len(without)} of {parts} have none, first "
            f"the part of vertex {vertex} at {place(V[vertex])}. Hold a vertex there, or drop the part with mend_mesh."
        )


def intersecting_faces(V: FloatArray, F: IntArray) -> IntArray:
    """Return pairs of faces that pass through each other, (k, 2); those that only touch in corners do not count."""
    # libigl knows by the vertex numbers alone that neighbours may touch, so one place must have one number.
    places, number = np.unique(V + 0.0, axis=0, return_inverse=True)
    faces = number.reshape(-1)[F].astype(np.int64)
    found = igl.predicates.find_self_intersections(places, faces)[1]
    pairs = np.asarray(found, dtype=np.int64).reshape(-1, 2)
    # Of two in one plane that share an edge and run along it the same way, libigl takes those on different sides of it
    # for folded, as where two boxes touch in an edge, and not those on the same side.
    pairs = pairs[~_beside(places, faces, pairs, -1.0)]
    doubtful = _running_the_same_way(faces)
    doubtful = doubtful[_beside(places, faces, doubtful, 1.0)]
    if len(doubtful):
        a, b, c = (np.ascontiguousarray(places[faces[doubtful[:, 0], k]]) for k in range(3))
        _, _, _, apex = _on_their_edge(places, faces, doubtful)
        flat = np.asarray(igl.predicates.orient3d(a, b, c, np.ascontiguousarray(apex))).reshape(-1) == 0
        pairs = np.unique(np.sort(np.concatenate([pairs, doubtful[flat]]), axis=1), axis=0)
    return pairs


def _beside(places: FloatArray, faces: IntArray, pairs: IntArray, side: float) -> BoolArray:
    """Return which pairs of faces (k, 2) share an edge and lie on one side of it (1), or on different ones (-1)."""
    shared = (faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None, :]).any(axis=2).sum(axis=1) == 2
    start, end, first, second = _on_their_edge(places, faces, pairs[shared])
    normals = (np.cross(end - start, apex - start) for apex in (first, second))
    found = np.zeros(len(pairs), dtype=np.bool_)
    found[shared] = side * np.multiply(*normals).sum(axis=1) > 0
    return found


def _on_their_edge(
    places: FloatArray, faces: IntArray, pairs: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the ends of the edge that each of the pairs (k, 2) shares, and the corner off it of both faces."""
    A, B = faces[pairs[:, 0]], faces[pairs[:, 1]]
    same = A[:, :, None] == B[:, None, :]
    rows = np.arange(len(pairs))
    a, b = np.argmin(same.any(axis=2), axis=1), np.argmin(same.any(axis=1), axis=1)
    return places[A[rows, (a + 1) % 3]], places[A[rows, (a + 2) % 3]], places[A[rows, a]], places[B[rows, b]]


def _running_the_same_way(faces: IntArray) -> IntArray:
    """Return pairs of faces, (k, 2), that run along an edge in the same direction."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    key = ends[:, 0] * (faces.max(initial=0) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    pairs = []
    for step in range(1, len(order)):
        same = key[order[step:]] == key[order[:-step]]
        if not same.any():
            break
        pairs.append(np.stack([order[:-step][same] // 3, order[step:][same] // 3], axis=1))
    return np.concatenate([*pairs, np.zeros((0, 2), dtype=np.int64)])


def relative_heights(V: FloatArray, F: IntArray) -> FloatArray:
    """Return the height of each face over its longest side, as a part of it, (m,): 0.87 if equilateral, 0 if flat."""
    sides = V[F] - V[np.roll(F, -1, axis=1)]
    longest = (sides**2).sum(axis=2).max(axis=1)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(np.divide(twice_area, longest, out=np.zeros(len(F)), where=longest > 0))


def require_whole(name: str, value: Any, least: int = 1, most: int | None = None) -> None:
    """Refuse an option that is not a whole number within its limits."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if isinstance(value, bool) or number < least or (most is not None and number > most):
        limits = f"at least {least}" if most is None else f"from {least} to {most}"
        raise MeshError(f"{name} must be a whole number, {limits}, but is {value!r}.")


def require_positive(name: str, value: Any, what: str = "number", *, or_zero: bool = False) -> None:
    """Refuse an option that is not a positive, finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not (0 < number < np.inf or (or_zero and number == 0)):
        raise MeshError(f"{name} must be a positive {what}{' or zero' if or_zero else ''}, but is {value!r}.")


def require_choice(name: str, value: Any, options: Sequence[object]) -> None:
    """Refuse an option that is none of the words there are."""
    if not isinstance(value, str | None) or value not in options:
        raise MeshError(f"{name} must be one of {', '.join(map(repr, options))}, but is {value!r}.")


def place(point: FloatArray) -> str:
    """Return a point in words for an error message."""
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ")"


def _as_int64(indices: ArrayLike, name: str = "F") -> IntArray:
    try:
        array = np.asarray(indices)
    except ValueError:  # rows of several lengths
        raise MeshError(f"{name} must be an array of whole numbers, but its rows have several lengths.") from None
    if array.size == 0 and array.dtype.kind == "f":  # what np.asarray makes of an empty list
        return np.ascontiguousarray(array, dtype=np.int64)
    if array.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            whole = array.astype(np.int64)
        wrong = np.argwhere(whole != array)
        if wrong.size:
            at = ", ".join(str(i) for i in wrong[0])
            raise MeshError(
                f"{name} must hold whole numbers, but {name}[{at}] = {array[tuple(wrong[0])]}. Are V and F swapped?"
            )
        return np.ascontiguousarray(whole)
    if array.dtype.kind not in "iu":
        raise MeshError(f"{name} must hold whole numbers, but its numbers are {array.dtype}.")
    return np.ascontiguousarray(array, dtype=np.int64)


def _require_every_vertex_used(n: int, F: IntArray) -> None:
    unused = np.flatnonzero(np.bincount(F.ravel(), minlength=n) == 0)
    if unused.size:
        raise MeshError(
            f"every vertex must belong to a face, but {counted(len(unused), 'is', 'are')} unreferenced, "
            f"first vertex {unused[0]}. Drop them with mend_mesh."
        )


def _require_area(V: FloatArray, F: IntArray) -> None:
    heights = relative_heights(V, F)
    wrong = np.flatnonzero(heights <= FLATTEST_FACE)
    if wrong.size:
        f = wrong[0]
        raise MeshError(
            f"every face must have area, but {counted(len(wrong), 'is', 'are')} degenerate, "
            f"first face {f} with corners {F[f].tolist()} "
            f"near {place(V[F[f, 0]])} (height {heights[f]:.2g} of its longest side). Remove them with mend_mesh."
        )


def _require_oriented(V: FloatArray, F: IntArray, *, closed: bool) -> None:
    table = edge_table(F, len(V))
    crowded = np.flatnonzero(table.faces > 2)
    if crowded.size:
        i, j = table.edges[crowded[0]]
        raise MeshError(
            f"an edge must have at most two faces, but {counted(len(crowded), 'edge is', 'edges are')} not manifold, "
            f"first the edge of vertices {i} and {j} near {place(V[i])} with {table.faces[crowded[0]]} "
            "faces. mend_mesh removes doubled faces; anything else has to be cut apart in a mesh editor."
        )
    against = disagreeing_pairs(F, table)
    if len(against):
        f, g = against[0] // 3
        raise MeshError(
            f"neighbouring faces must be oriented alike, but {counted(len(against), 'pair is', 'pairs are')} not, "
            f"first faces {f} and {g} "
            f"near {place(V[F[f, 0]])}. Turn them with mend_mesh."
        )
    open_edges = np.flatnonzero(table.faces == 1)
    if closed and open_edges.size:
        i, j = table.edges[open_edges[0]]
        raise MeshError(
            f"the mesh must be closed, but {counted(len(open_edges), 'edge has', 'edges have')} a face on one side "
            f"only, first the edge of vertices {i} and {j} near {place(V[i])}. Close holes with mend_mesh."
        )


def _require_solid(V: FloatArray, F: IntArray) -> None:
    fans, fan = corner_fans(F, edge_table(F, len(V)))
    if fans > len(V):
        pairs = np.unique(np.stack([F.ravel(), fan], axis=1), axis=0)
        pinched = np.flatnonzero(np.bincount(pairs[:, 0], minlength=len(V)) > 1)
        raise MeshError(
            "the faces round a vertex must form one fan, but "
            f"{counted(len(pinched), 'vertex joins', 'vertices join')} several sheets, first "
            f"vertex {pinched[0]} at {place(V[pinched[0]])}. Separate the sheets with mend_mesh."
        )
    enclosed = signed_volume(V, F)
    if enclosed <= 0:
        raise MeshError(
            f"faces must be oriented outwards, but the signed volume is {enclosed:.6g}. Turn them with mend_mesh, or "
            "pass F[:, ::-1]."
        )


def signed_volume(V: FloatArray, F: IntArray) -> float:
    """Return the volume inside closed, consistently oriented faces: V . (V x V) / 6 summed over the faces.

    The mean of the vertices is subtracted first: at a distance of 1e6 sizes from the origin the plain sum
    is wrong by a factor of 1e5, the centred one by no more than the rounding of the coordinates themselves.
    """
    A, B, C = (V - V.mean(axis=0))[F].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", A, np.cross(B, C)) / 6)
