"""Make the surface of a solid out of a mesh as found in the wild, and say what was done.

In this order: merge duplicate vertices, drop faces without area and doubled faces, separate sheets that touch in
an edge or a vertex, orient neighbours alike, close holes, unite parts that overlap, turn faces outwards, choose bodies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from meshref.check import (
    FLATTEST_FACE,
    MeshError,
    as_arrays,
    check_mesh,
    intersecting_faces,
    place,
    relative_heights,
    require_choice,
    require_positive,
)
from meshref.crowded import cut_apart
from meshref.filling import least_area_triangles
from meshref.measures import face_areas
from meshref.printing import counted
from meshref.solids import arrangement, hidden_faces, part_volumes, unite
from meshref.topology import (
    BoolArray,
    FloatArray,
    IntArray,
    boundary_loops,
    corner_fans,
    edge_table,
    flips_to_agree,
    half_edges,
    vertex_components,
)

# What mending takes time for, in order, as its progress is told.
MERGE, CLOSE, CROSSINGS, UNITE, CHOOSE = PARTS = (
    "merging vertices",
    "closing holes",
    "looking for faces that pass through each other",
    "uniting parts that overlap",
    "telling bodies from cavities",
)

Progress = Callable[[int, int, str], None]

# A part with less volume than this, relative to its area to the power 3/2 (0.094 for a ball), is flat.
FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class MendReport:
    """Changes that mend_mesh made, as sentences and as numbers."""

    steps: tuple[str, ...]  # plain sentences, in order; empty if the mesh was fine
    vertex_map: IntArray  # (n,), new number of each vertex given, -1 where it was dropped
    merged_vertices: int = 0
    dropped_vertices: int = 0  # unreferenced, or of dropped bodies
    dropped_faces: int = 0  # without area, doubled, of walls between solids, or of dropped bodies
    split_vertices: int = 0  # where sheets touched in a point or an edge
    turned_faces: int = 0
    holes: tuple[int, ...] = ()  # number of edges of each hole that was closed
    open_holes: tuple[int, ...] = ()  # number of edges of each hole left open (closed=False)
    bodies: int = 1  # connected solids in the result
    cavities: int = 0  # surfaces inside a body, oriented towards its inside
    self_intersections: int = 0  # pairs of faces of one part that pass through each other; they are not mended
    united_parts: int = 0  # that overlapped or touched, and are no longer there one by one
    volume_before_union: float = 0.0  # of these parts, each by itself, added up
    volume_after_union: float = 0.0  # of what has taken their place
    hidden_area: float = 0.0  # share of the surface within the solid, where a part passes through itself

    def __repr__(self) -> str:
        bodies = f"{self.bodies} {'body' if self.bodies == 1 else 'bodies'}"
        lines = [f"MendReport({bodies}, {len(self.vertex_map)} vertices given, changed={self.changed})", *self.steps]
        return "\n  ".join(lines)

    @property
    def changed(self) -> bool:
        """True if the result differs from the mesh that was given."""
        dropped = self.dropped_vertices + self.dropped_faces
        mended = self.merged_vertices + self.split_vertices + self.turned_faces + len(self.holes) + self.united_parts
        return bool(dropped + mended)


def mend_mesh(
    V: ArrayLike,
    F: ArrayLike,
    *,
    merge_distance: float | None = None,
    bodies: Literal["keep", "largest", "refuse"] = "keep",
    hole_limit: float = 1.0,
    closed: bool = True,
    progress: Progress | None = None,
) -> tuple[FloatArray, IntArray, MendReport]:
    """Turn a mesh into the surface of a solid: closed, manifold, oriented outwards.

    Vertices and faces that stay keep their order; faces that close holes come last, and after them those of parts that
    were united. Parts that overlap or touch in faces become one solid, that in which the surface winds round at least
    once; where their faces look in contradicting ways, each part adds what it encloses, and one that lies wholly inside
    another is a cavity. Where no parts overlap, a surface inside an odd number of others is a cavity, however its faces
    look. Faces of one part that pass through each other are counted, not mended.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3).
        merge_distance: Vertices no farther apart than this become one, which also closes seams of texture coordinates.
            None is 1e-8 of the diagonal of the box round the mesh.
        bodies: What to do with several solids that are not connected: "keep" them, keep the one with the "largest"
            area and its cavities, or "refuse".
        hole_limit: Longest boundary of a hole that is closed, in diagonals of the box round the mesh.
        closed: Whether a hole that is longer is refused; otherwise it is left open.
        progress: Called as progress(step, steps, what) when each part of the work begins, a step.

    Returns:
        V, F and the report.

    Raises:
        MeshError: Coordinates are not finite; indices are out of range; there are no faces; more than two faces meet in
            an edge, and solids that touch there cannot be told apart; a surface is one-sided or flat; a hole is too
            long; parts that overlap cannot be united; there are several bodies and they are refused.
    """
    V, F = as_arrays(V, F)
    _require_options(merge_distance, bodies, hole_limit)
    steps: list[str] = []
    size = float(np.linalg.norm(V.max(axis=0) - V.min(axis=0)))
    _tell(progress, MERGE)
    sheets = _sheets(V, F, 1e-8 * size if merge_distance is None else merge_distance, steps)
    _tell(progress, CLOSE)
    closing = _close_holes(
        sheets.V,
        _oriented_alike(sheets.V, sheets.F),
        sheets.F,
        hole_limit * size,
        closed=closed,
        drop=bodies == "largest",
    )
    solid = _as_solid(sheets.V, closing, progress)
    _tell(progress, CHOOSE)
    chosen = _choose_bodies(solid, bodies)
    # A part can pass through itself along edges too, of vertices that were left apart.
    doubtful = (solid.self_intersections or sheets.left_apart) and not closing.left_open
    hidden = _hidden_share(chosen) if doubtful else 0.0
    _say_what_was_done(steps, closing, solid, chosen, hidden)
    V, F = check_mesh(chosen.V, chosen.F, closed=not closing.left_open, oriented=True)
    report = MendReport(
        steps=tuple(steps),
        vertex_map=_renumbered(_renumbered(sheets.vertex_map, solid.vertex_map), chosen.vertex_map),
        merged_vertices=sheets.merged_vertices,
        dropped_vertices=sheets.dropped_vertices + solid.dropped_vertices + chosen.dropped_vertices,
        dropped_faces=sheets.dropped_faces + closing.dropped_faces + chosen.dropped_faces,
        split_vertices=sheets.split_vertices,
        turned_faces=chosen.turned_faces,
        holes=tuple(closing.holes),
        open_holes=tuple(closing.left_open),
        bodies=chosen.bodies,
        cavities=chosen.cavities,
        self_intersections=solid.self_intersections,
        united_parts=solid.united_parts,
        volume_before_union=solid.volume_before,
        volume_after_union=solid.volume_after,
        hidden_area=hidden,
    )
    return V, F, report


def _tell(progress: Progress | None, what: str) -> None:
    if progress is not None:
        progress(PARTS.index(what), len(PARTS), what)


def _say_what_was_done(steps: list[str], closing: _Closing, solid: _Solid, chosen: _Chosen, hidden: float) -> None:
    _say(steps, closing.dropped_parts, "dropped {} {} that cannot be closed", "smaller part", "smaller parts")
    _say(steps, chosen.dropped_bodies, "dropped {} smaller {}", "body", "bodies")
    everywhere = "all " if chosen.turned_faces == len(closing.given) else ""
    _say(steps, chosen.turned_faces, f"turned {everywhere}{{}} {{}} that looked the wrong way", "face", "faces")
    holes, left_open = closing.holes, closing.left_open
    _say(steps, len(holes), f"closed {{}} {{}} (of {', '.join(map(str, holes))} edges)", "hole", "holes")
    _say(steps, len(left_open), f"left {{}} {{}} open (of {', '.join(map(str, left_open))} edges)", "hole", "holes")
    if solid.united_parts:
        steps.append(
            f"united {solid.united_parts} parts that overlap or touch: volume {solid.volume_before:.6g} before, part "
            f"by part, and {solid.volume_after:.6g} after"
        )
    if chosen.bodies > 1:
        steps.append(f"kept {chosen.bodies} bodies that are not connected")
    taken = f": volume {chosen.filled:.6g} without it, {chosen.filled - chosen.hollow:.6g} with it"
    taken = taken.replace(" it", " them") if chosen.cavities > 1 else taken
    _say(steps, chosen.cavities, f"took {{}} {{}} inside another for a cavity{taken}", "surface", "surfaces")
    crossings, within = solid.self_intersections, f"{100 * hidden:.2g} % of the surface lies within the solid"
    found = "found {} {} of faces that pass through each other, and left them so"
    _say(steps, crossings, f"{found}; {within}, and the volume counts it twice" if hidden else found, "pair", "pairs")
    if hidden and not crossings:
        steps.append(f"found that {within}, behind faces that meet in edges, and the volume counts it twice")


def _hidden_share(chosen: _Chosen) -> float:
    """Return the part of the surface that has the solid on both sides."""
    areas = face_areas(chosen.V, chosen.F)
    return float(areas[hidden_faces(chosen.V, chosen.F)].sum() / areas.sum())


def _require_options(merge_distance: float | None, bodies: str, hole_limit: float) -> None:
    require_choice("bodies", bodies, ("keep", "largest", "refuse"))
    if merge_distance is not None:
        require_positive("merge_distance", merge_distance, "length", or_zero=True)
    if not (isinstance(hole_limit, int | float) and hole_limit >= 0):
        raise MeshError(f"hole_limit must be a number of diagonals, at least 0, but is {hole_limit!r}.")


class _Sheets(NamedTuple):
    """Faces with area, each once, at most two at an edge and one fan at a vertex, and what it took to get there."""

    V: FloatArray
    F: IntArray
    vertex_map: IntArray  # of MendReport, as are the counts
    merged_vertices: int
    dropped_vertices: int
    dropped_faces: int
    split_vertices: int
    left_apart: int  # duplicate vertices that were not merged


def _sheets(V: FloatArray, F: IntArray, merge_distance: float, steps: list[str]) -> _Sheets:
    # Vertices that no face uses would be bodies of their own, and would merge with ones that are used.
    V, F, vertex_map, unused = _drop_unused(V, F, np.arange(len(V)))
    _say(steps, unused, "dropped {} unreferenced {}", "vertex", "vertices")
    welded, left_apart = _weld(V, F, merge_distance)
    V, F, vertex_map = V[welded.kept], welded.F, _renumbered(vertex_map, welded.new_number)
    _say(steps, welded.merged, "merged {} duplicate {}", "vertex", "vertices")
    apart = "left {} duplicate {} apart, for more than two faces would meet in an edge"
    _say(steps, left_apart, apart, "vertex", "vertices")
    _say(steps, welded.flat, "removed {} {} without area", "face", "faces")
    _say(steps, welded.doubled, "removed {} doubled {}", "face", "faces")
    _say(steps, welded.walls, "removed {} {} of walls between solids", "face", "faces")
    _say(steps, welded.copies, "cut the surface apart in edges where solids touch, at {} {}", "vertex", "vertices")
    if len(F) == 0:
        raise MeshError("no face of the mesh has area, so there is nothing to mend. Are the coordinates all the same?")
    V, F, vertex_map, left_over = _drop_unused(V, F, vertex_map)
    _say(steps, left_over, "dropped {} {} of removed faces", "vertex", "vertices")
    V, F, split = _split_pinched_vertices(V, F)
    dropped = welded.flat + welded.doubled + welded.walls
    _say(steps, split, "separated sheets that touched in {} {}", "vertex", "vertices")
    return _Sheets(
        V, F, vertex_map, welded.merged, unused + left_over, dropped, split + welded.copies, left_apart + welded.copies
    )


def _oriented_alike(V: FloatArray, F: IntArray) -> IntArray:
    flip, one_sided = flips_to_agree(F, edge_table(F, len(V)))
    if one_sided is not None:
        raise MeshError(
            f"the surface must have two sides, but the part of face {one_sided} near {place(V[F[one_sided, 0]])} has "
            "one, like a Moebius strip: it bounds no solid. Cut it in a mesh editor."
        )
    return _turned(F, flip)


def _say(steps: list[str], count: int, sentence: str, one: str, many: str) -> None:
    if count:
        steps.append(sentence.format(count, one if count == 1 else many))


def _drop_unused(V: FloatArray, F: IntArray, vertex_map: IntArray) -> tuple[FloatArray, IntArray, IntArray, int]:
    used = np.bincount(F.ravel(), minlength=len(V)) > 0
    new = np.where(used, np.cumsum(used) - 1, -1)
    return V[used], new[F], _renumbered(vertex_map, new), int(np.count_nonzero(~used))


def _renumbered(vertex_map: IntArray, new: IntArray) -> IntArray:
    return np.where(vertex_map >= 0, new[vertex_map], -1)


class _Weld(NamedTuple):
    kept: IntArray  # the vertices that stay
    new_number: IntArray  # of every vertex
    F: IntArray  # faces with area, each once
    merged: int  # vertices merged into others
    flat: int  # faces removed, without area
    doubled: int  # faces removed, because they were there already
    walls: int = 0  # faces removed in pairs, for the two look opposite ways
    copies: int = 0  # of vertices, last of those kept, where the surface was cut apart


def _weld(V: FloatArray, F: IntArray, distance: float) -> tuple[_Weld, int]:
    """Merge close vertices and remove what this leaves of faces; return how many vertices are left apart as well.

    Where a closed surface touches itself along an edge, merging would make that edge one of four faces. Such
    vertices were never torn from each other, so if it comes to that, only vertices on open edges are merged. Where
    four faces meet in an edge even so, walls between two solids, there once for each, are taken away, and the surface
    is cut apart along edges in which solids touch.
    """
    attempt = _weld_some(V, F, distance, np.arange(len(V)))
    if _crowded_edge(attempt, V) is None:
        return attempt, 0
    proper = F[~_repeats_a_corner(F)]
    table = edge_table(proper, len(V))
    torn = np.unique(table.edges[table.faces == 1])
    second = _weld_some(V, F, distance, torn)
    complaint = _crowded_edge(second, V)
    if complaint is not None:
        second = _weld_some(V, F, distance, torn, cancel=True)
        if len(second.F) == 0:
            raise MeshError(complaint)
        if _crowded_edge(second, V) is not None:
            cut = cut_apart(V[second.kept], second.F)
            if cut is None:
                raise MeshError(complaint)
            copies = second.kept[cut[1]]
            second = second._replace(F=cut[0], kept=np.concatenate([second.kept, copies]), copies=len(copies))
    return second, attempt.merged - second.merged


def _weld_some(V: FloatArray, F: IntArray, distance: float, candidates: IntArray, *, cancel: bool = False) -> _Weld:
    # Equal ones first: in a pile of k vertices there are k^2 / 2 close pairs.
    points, first, pile = np.unique(V[candidates] + 0.0, axis=0, return_index=True, return_inverse=True)
    pairs = np.zeros((0, 2), dtype=np.int64)
    if distance > 0 and len(points):
        pairs = candidates[first][cKDTree(points).query_pairs(distance, output_type="ndarray")]
    ends = half_edges(F)
    short = ends[np.linalg.norm(V[ends[:, 0]] - V[ends[:, 1]], axis=1) <= distance]  # the ends of an edge always
    links = np.concatenate([pairs, np.stack([candidates, candidates[first][pile.reshape(-1)]], axis=1), short])
    graph = sparse.coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(V), len(V)))
    clusters, cluster = csgraph.connected_components(graph, directed=False)
    earliest = np.full(clusters, len(V))
    np.minimum.at(earliest, cluster, np.arange(len(V)))
    kept = np.sort(earliest)  # the first of each cluster stays where it is
    new_number = np.searchsorted(kept, earliest[cluster])
    faces, flat = _drop_flat_faces(V[kept], new_number[F])
    walls = 0
    if cancel:
        faces, walls = _drop_walls(faces)
    faces, doubled = _drop_doubled_faces(faces)
    return _Weld(kept, new_number, faces, len(V) - len(kept), flat, doubled, walls)


def _crowded_edge(weld: _Weld, V: FloatArray) -> str | None:
    table = edge_table(weld.F, len(weld.kept))
    crowded = np.flatnonzero(table.faces > 2)
    if not crowded.size:
        return None
    i, j = weld.kept[table.edges[crowded[0]]]
    return (
        f"more than two faces meet in {counted(len(crowded), 'edge', 'edges')}, "
        f"first {table.faces[crowded[0]]} in the edge from "
        f"{place(V[i])} to {place(V[j])}: which of them bound the solid cannot be told. Cut them apart "
        "in a mesh editor."
    )


def _repeats_a_corner(F: IntArray) -> BoolArray:
    return np.asarray(np.any(np.roll(F, -1, axis=1) == F, axis=1), dtype=np.bool_)


def _drop_flat_faces(V: FloatArray, F: IntArray) -> tuple[IntArray, int]:
    """Remove faces without area. One with three distinct corners has a corner on its longest side: there the neighbour
    is split at that corner, for otherwise a slit would stay."""
    removed = 0
    for _ in range(100):  # splitting a neighbour can leave a new face without area, of a smaller neighbour
        repeated = _repeats_a_corner(F)
        flat = np.flatnonzero(relative_heights(V, F) <= FLATTEST_FACE)
        if not flat.size and not repeated.any():
            break
        gone: set[int] = set(np.flatnonzero(repeated).tolist())
        touched: set[int] = set()
        added: list[list[int]] = []
        table = edge_table(F, len(V))
        order = np.argsort(table.of_half_edge, kind="stable")
        first = np.cumsum(table.faces) - table.faces
        for f in flat.tolist():
            if f in gone or f in touched:
                continue
            gone.add(f)
            corners = V[F[f]]
            c = int(np.argmax(((np.roll(corners, -1, axis=0) - corners) ** 2).sum(axis=1)))  # starts the longest side
            edge = table.of_half_edge[3 * f + c]
            sharing = order[first[edge] : first[edge] + table.faces[edge]]
            others = [int(h) for h in sharing if h // 3 != f]
            if len(others) != 1:
                continue
            g, k = divmod(others[0], 3)
            if g in gone or g in touched:
                gone.discard(f)  # next time round
                continue
            start, end, apex = np.roll(F[g], -k).tolist()
            middle = int(F[f, (c + 2) % 3])
            touched.update((f, g))
            gone.add(g)
            removed -= 1  # the neighbour comes back, in two
            added += [[start, middle, apex], [middle, end, apex]]
        removed += len(gone)
        keep = np.setdiff1d(np.arange(len(F)), np.fromiter(gone, dtype=np.int64, count=len(gone)))
        F = np.concatenate([F[keep], np.array(added, dtype=np.int64).reshape(-1, 3)])
    return F, removed


def _drop_doubled_faces(F: IntArray) -> tuple[IntArray, int]:
    _, first = np.unique(np.sort(F, axis=1), axis=0, return_index=True)
    return F[np.sort(first)], len(F) - len(first)


def _drop_walls(F: IntArray) -> tuple[IntArray, int]:
    """Remove faces that are there twice, looking opposite ways: they bound nothing together."""
    _, number = np.unique(np.sort(F, axis=1), axis=0, return_inverse=True)
    number = number.reshape(-1)
    start = np.argmin(F, axis=1)
    rows = np.arange(len(F))
    forth = F[rows, (start + 1) % 3] < F[rows, (start + 2) % 3]
    ways = [np.bincount(number[which], minlength=number.max() + 1) for which in (forth, ~forth)]
    keep = (ways[0] != ways[1])[number]
    return F[keep], int(np.count_nonzero(~keep))


def _split_pinched_vertices(V: FloatArray, F: IntArray) -> tuple[FloatArray, IntArray, int]:
    fans, fan = corner_fans(F, edge_table(F, len(V)))
    owner = np.zeros(fans, dtype=np.int64)
    owner[fan] = F.ravel()
    _, first_fan = np.unique(owner, return_index=True)
    extra = np.setdiff1d(np.arange(fans), first_fan)  # every vertex keeps its first fan, the others get a copy of it
    vertex_of_fan = owner.copy()
    vertex_of_fan[extra] = len(V) + np.arange(len(extra))
    pinched = len(np.unique(owner[extra]))
    return np.concatenate([V, V[owner[extra]]]), vertex_of_fan[fan].reshape(-1, 3), pinched


class _Solid(NamedTuple):
    """Faces oriented as those of a solid, and what it took."""

    V: FloatArray
    F: IntArray
    vertex_map: IntArray  # (n,) new number of each vertex, -1 where it is gone
    turned: BoolArray  # (m,) faces that looked the other way when given
    self_intersections: int
    dropped_vertices: int  # of parts that could not be closed
    turned_and_united: int = 0  # faces that were turned of parts that are united
    united_parts: int = 0
    volume_before: float = 0.0
    volume_after: float = 0.0


def _as_solid(V: FloatArray, closing: _Closing, progress: Progress | None) -> _Solid:
    """Unite parts that cross, and orient each part outwards, or inwards where it is a cavity."""
    V, F, number, unused = _drop_unused(V, closing.F, np.arange(len(V)))
    _tell(progress, CROSSINGS)
    crossings = intersecting_faces(V, F)
    found = arrangement(V, F, crossings)
    same = len(crossings) if closing.left_open else int(np.count_nonzero(np.equal(*found.part[crossings].T)))
    to_unite = np.zeros(len(F), dtype=np.bool_)
    united = None
    if found.crosses.any() and not closing.left_open:
        _tell(progress, UNITE)
        group = found.groups()
        to_unite = np.isin(group, group[found.crosses.any(axis=1)])[found.part]
        united = unite(V, F, found)
    flip = _inwards(V, F, found.part, found.cavity)
    oriented = _turned(F, flip)
    turned = np.zeros(len(F), dtype=np.bool_)
    turned[: len(closing.given)] = (oriented[: len(closing.given)] != closing.given).any(axis=1)
    if united is None:
        return _Solid(V, oriented, number, turned, same, unused)
    new = np.zeros(len(united.F) - np.count_nonzero(~to_unite), dtype=np.bool_)
    return _Solid(
        united.V,
        _turned(united.F, np.concatenate([flip[~to_unite], new])),
        _renumbered(number, united.vertex_of),
        np.concatenate([turned[~to_unite], new]),
        same,
        unused,
        united.turned_faces,
        united.parts,
        united.volume_before,
        united.volume_after,
    )


def _inwards(V: FloatArray, F: IntArray, part: IntArray, cavity: BoolArray) -> BoolArray:
    """Return which faces look inwards, (m,), where a cavity's look out of the solid into it."""
    volumes = part_volumes(V, F, part)
    return np.asarray(((volumes < 0) != cavity)[part], dtype=np.bool_)


class _Chosen(NamedTuple):
    V: FloatArray
    F: IntArray
    vertex_map: IntArray
    bodies: int
    cavities: int
    filled: float  # volume without the cavities
    hollow: float  # volume of the cavities
    turned_faces: int
    dropped_faces: int = 0
    dropped_vertices: int = 0
    dropped_bodies: int = 0


def _choose_bodies(solid: _Solid, bodies: Literal["keep", "largest", "refuse"]) -> _Chosen:
    V, F = solid.V, solid.F
    found = arrangement(V, F, np.zeros((0, 2), dtype=np.int64))
    volumes = part_volumes(V, F, found.part)
    outer = np.flatnonzero(~found.cavity)
    if bodies == "refuse" and len(outer) > 1:
        i, j = (int(F[found.part == k].min()) for k in outer[:2])
        raise MeshError(
            f"the mesh must be one body, but it has {len(outer)} that are not connected, first those of vertices "
            f"{i} at {place(V[i])} and {j} at {place(V[j])}. Pass bodies='largest' or bodies='keep'."
        )
    keep = np.ones(len(volumes), dtype=np.bool_)
    if bodies == "largest":
        areas = np.bincount(found.part, weights=face_areas(V, F), minlength=len(volumes))
        largest = outer[np.argmax(areas[outer])]
        # Its cavities, not what is in them.
        keep = found.inside[:, largest] & (found.inside.sum(axis=1) == found.inside[largest].sum() + 1)
        keep[largest] = True
    kept_faces = keep[found.part]
    new_V, new_F, number, _ = _drop_unused(V, F[kept_faces], np.arange(len(V)))
    filled, hollow = (float(np.abs(volumes[keep & which]).sum()) for which in (~found.cavity, found.cavity))
    return _Chosen(
        new_V,
        new_F,
        number,
        bodies=int(np.count_nonzero(keep & ~found.cavity)),
        cavities=int(np.count_nonzero(keep & found.cavity)),
        filled=filled,
        hollow=hollow,
        turned_faces=int(np.count_nonzero(solid.turned & kept_faces)) + solid.turned_and_united,
        dropped_faces=int(np.count_nonzero(~kept_faces)),
        dropped_vertices=len(V) - len(new_V),
        dropped_bodies=len(outer) - int(np.count_nonzero(keep & ~found.cavity)),
    )


def _turned(F: IntArray, flip: BoolArray) -> IntArray:
    return np.where(flip[:, None], F[:, [0, 2, 1]], F)


class _Closing(NamedTuple):
    F: IntArray  # faces oriented alike, those given first
    given: IntArray  # the faces given as they were, without those of dropped parts
    holes: list[int]  # edges of each hole that was closed
    left_open: list[int]
    dropped_parts: int = 0
    dropped_faces: int = 0


def _close_holes(V: FloatArray, F: IntArray, given: IntArray, limit: float, *, closed: bool, drop: bool) -> _Closing:
    """Close the holes, and drop or refuse parts that cannot be closed or are flat.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3), oriented alike.
        given: The same as they were given.
        limit: Longest boundary of a hole that is closed.
        closed: Whether a longer one is refused, or left open.
        drop: Whether parts other than that of the largest area are dropped where they would be refused.
    """
    parts, part = vertex_components(F, len(V))
    largest = int(np.argmax(np.bincount(part[F[:, 0]], weights=face_areas(V, F), minlength=parts)))
    table = edge_table(F, len(V))
    existing = set(map(tuple, table.edges.tolist()))
    holes, left_open, filled = [], [], [F]
    dropped: set[int] = set()
    for loop in sorted(boundary_loops(F, table), key=len):
        of = int(part[loop[0]])
        try:
            patch = _patch(V, loop, limit, existing, closed=closed)
        except MeshError:
            if not drop or of == largest:
                raise
            dropped.add(of)
            continue
        if patch is None:
            left_open.append((of, len(loop)))
            continue
        filled.append(patch)
        existing |= set(map(tuple, np.sort(half_edges(patch), axis=1).tolist()))
        holes.append((of, len(loop)))
    every = np.concatenate(filled)
    dropped |= _flat_parts(V, every, part[every[:, 0]], None if not drop else largest) - dropped
    keep = ~np.isin(part[every[:, 0]], list(dropped))
    return _Closing(
        every[keep],
        given[keep[: len(F)]],
        [size for of, size in holes if of not in dropped],
        [size for of, size in left_open if of not in dropped],
        len(dropped),
        int(np.count_nonzero(~keep[: len(F)])),
    )


def _patch(
    V: FloatArray, loop: IntArray, limit: float, existing: set[tuple[int, int]], *, closed: bool
) -> IntArray | None:
    length = float(np.linalg.norm(V[loop] - V[np.roll(loop, -1)], axis=1).sum())
    if length <= limit:
        return least_area_triangles(V, loop[::-1], existing)  # the other way round than the faces beside it
    if closed:
        raise MeshError(
            f"the mesh has a hole of {len(loop)} edges at {place(V[loop[0]])}, {length:.4g} round, longer than "
            f"the limit of {limit:.4g}. Raise hole_limit to close it, or pass closed=False to leave it open."
        )
    return None


def _flat_parts(V: FloatArray, F: IntArray, part: IntArray, largest: int | None) -> set[int]:
    """Return the parts that enclose no volume.

    Raises:
        MeshError: There is one, and none may be dropped or it is the largest.
    """
    # Each about its own middle, so that the sign means something for a part that has been left open.
    volumes = part_volumes(V, F, part)
    areas = np.bincount(part, weights=face_areas(V, F), minlength=len(volumes))
    flat = np.flatnonzero((np.abs(volumes) <= FLAT * areas**1.5) & (areas > 0))
    if flat.size and (largest is None or largest in flat):
        faces = F[part == (flat[0] if largest is None else largest)]
        raise MeshError(
            f"the part of vertex {faces.min()} at {place(V[faces.min()])} with {len(faces)} faces is flat: it bounds "
            "no solid. Remove it in a mesh editor, or pass bodies='largest' if there are others."
        )
    return set(flat.tolist())
