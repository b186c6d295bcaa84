"""Closed parts of a mesh against each other: which cross, which lie in others, and the one surface round them all.

A part is a connected closed surface. Two parts cross where faces of one pass through faces of the other, or lie on
them, or where their edges meet and one is partly inside the other; a part that crosses no other lies wholly inside or
outside each of them, by the winding number on its faces.

    parts that cross none         a surface inside an odd number of others is a cavity, however its faces look
    parts that cross              united by manifold3d: the solid is where the winding number is at least 1

The union is believed only where winding numbers agree with it on both sides of the faces given.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import igl
import manifold3d
import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from meshref.check import FLATTEST_FACE, MeshError, place, relative_heights, signed_volume
from meshref.measures import doubled_area_vectors, face_areas, unit_or_zero
from meshref.topology import (
    BoolArray,
    FloatArray,
    IntArray,
    edge_table,
    half_edges,
    paired_half_edges,
    vertex_components,
)

# Faces at which winding numbers are looked at, on both sides, spread evenly over those of a group of parts: at most so
# many, and for large meshes fewer, so that points times faces stay within what takes a quarter of a second.
PROBED_FACES = 20_000
LEAST_PROBED_FACES = 200
PAIRS_OF_POINT_AND_FACE = 100_000_000

# The first where only a part that is inside out is looked for.
INVERTED_PROBES = 1_000

# Parts that touch are made larger by this share to be united, and their corners put back where they were.
OVERLAP = 1e-12

# Where on a face: its middle would lie in the planes of other faces too often.
PLACE_IN_FACE = np.array([0.29417, 0.38146, 0.32437])

# How far beside a face, as a part of the size: well above rounding, and well below the thickness of any plate.
BESIDE = 1e-9

HIDDEN_BESIDE = 1e-4  # the same where faces are told to lie within the solid

# Faces by which a part that crosses none is said to be inside another.
PROBED_PLACES = 60

# Share of the area of a group of parts on which winding numbers may speak against an answer: slivers along the curves
# in which parts cross, where a probe meets the rounding of new corners.
DISAGREEING_AREA = 1e-5


class Arrangement(NamedTuple):
    """Connected parts of a mesh and how they lie to each other, for k parts."""

    part: IntArray  # (m,) of each face
    crosses: BoolArray  # (k, k) symmetric: faces pass through each other, or lie on each other
    inside: BoolArray  # (k, k): a lies wholly inside b

    @property
    def cavity(self) -> BoolArray:
        """Tell for each part, (k,), if it lies inside an odd number of others."""
        return np.asarray(self.inside.sum(axis=1) % 2 == 1)

    def groups(self) -> IntArray:
        """Return the group of each part, (k,): parts whose insides have a point in common, directly or by others."""
        rows, columns = np.nonzero(self.crosses | self.inside)
        touching = sparse.coo_array((np.ones(len(rows)), (rows, columns)), shape=self.crosses.shape)
        return np.asarray(csgraph.connected_components(touching, directed=False)[1], dtype=np.int64)


class United(NamedTuple):
    """A mesh whose parts cross no longer."""

    V: FloatArray
    F: IntArray
    vertex_of: IntArray  # (n,) new number of each vertex given, -1 where it is gone
    parts: int  # that were united
    volume_before: float  # their own volumes, added up
    volume_after: float  # of the union
    turned_faces: int  # of parts that were taken the other way round than their faces look


def arrangement(V: FloatArray, F: IntArray, crossing_faces: IntArray) -> Arrangement:
    """Return how the connected parts of a mesh lie to each other.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3), oriented alike in each part.
        crossing_faces: Pairs of faces that pass through each other, (c, 2).
    """
    parts, of_vertex = vertex_components(F, len(V))
    part = of_vertex[F[:, 0]]
    crosses = np.zeros((parts, parts), dtype=np.bool_)
    a, b = part[crossing_faces].T if len(crossing_faces) else (part[:0], part[:0])
    crosses[a, b] = crosses[b, a] = True
    np.fill_diagonal(crosses, False)
    meeting = _meet_in_edges(V, F, part, crosses) if parts > 1 else []
    patch = _patches(V, F, part) if meeting else np.zeros(len(F), dtype=np.int64)
    faces_of = _members(part, parts)
    for a, b in meeting:
        if not crosses[a, b]:
            within = _inside_by_patch(V, F, faces_of[a], faces_of[b], patch)
            crosses[a, b] = crosses[b, a] = within.any() and not within.all()
    return Arrangement(part, crosses, _containment(V, F, parts, of_vertex, faces_of, crosses))


def _meet_in_edges(V: FloatArray, F: IntArray, part: IntArray, crosses: BoolArray) -> list[tuple[int, int]]:
    """Return pairs of parts, each way round, that have an edge in one place; those with a face in one place cross.

    Surfaces whose curve of crossing runs along edges of both have no faces that pass through each other.
    """
    places = _places(V, F)
    for rows, lie_on_each_other in ((np.sort(places, axis=1), True), (np.sort(half_edges(places), axis=1), False)):
        owner = part if lie_on_each_other else np.repeat(part, 3)
        _, number = np.unique(rows, axis=0, return_inverse=True)
        once = np.unique(np.stack([number.reshape(-1), owner], axis=1), axis=0)
        # Parts in one place follow each other; of more than two there, each is paired with all others by steps.
        pairs: set[tuple[int, int]] = set()
        for step in range(1, int(np.bincount(once[:, 0]).max())):
            same = once[step:, 0] == once[:-step, 0]
            pairs |= set(zip(once[:-step][same, 1].tolist(), once[step:][same, 1].tolist()))
        if lie_on_each_other:
            for a, b in pairs:
                crosses[a, b] = crosses[b, a] = True
    return [pair for a, b in pairs for pair in ((a, b), (b, a))]


def _places(V: FloatArray, F: IntArray) -> IntArray:
    """Return the faces by places, (m, 3): vertices with equal coordinates have one number."""
    return np.asarray(np.unique(V + 0.0, axis=0, return_inverse=True)[1].reshape(-1)[F], dtype=np.int64)


def _patches(V: FloatArray, F: IntArray, part: IntArray) -> IntArray:
    """Return the patch of each face, (m,): what hangs together without passing over an edge where parts meet."""
    _, number = np.unique(np.sort(half_edges(_places(V, F)), axis=1), axis=0, return_inverse=True)
    owner = np.repeat(part, 3)
    lowest, highest = np.full(number.max() + 1, len(F)), np.full(number.max() + 1, -1)
    np.minimum.at(lowest, number.reshape(-1), owner)
    np.maximum.at(highest, number.reshape(-1), owner)
    table = edge_table(F, len(V))
    first, second = paired_half_edges(table).T
    alone = (lowest == highest)[number.reshape(-1)[first]]
    graph = sparse.coo_array((np.ones(alone.sum()), (first[alone] // 3, second[alone] // 3)), shape=(len(F), len(F)))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)


def _inside_by_patch(V: FloatArray, F: IntArray, own: IntArray, other: IntArray, patch: IntArray) -> BoolArray:
    """Return for each patch of a part's faces if it lies inside another part."""
    largest = own[np.argsort(face_areas(V, F[own]), kind="stable")[::-1]]
    probes = largest[np.unique(patch[largest], return_index=True)[1]]
    points = np.einsum("c,kcx->kx", PLACE_IN_FACE, V[F[probes]])
    return np.asarray(np.abs(winding_numbers(V, F[other], points)) > 0.5)


def _containment(
    V: FloatArray, F: IntArray, parts: int, of_vertex: IntArray, faces_of: list[IntArray], crosses: BoolArray
) -> BoolArray:
    inside = np.zeros((parts, parts), dtype=np.bool_)
    if parts == 1:
        return inside
    lower, upper = np.full((parts, 3), np.inf), np.full((parts, 3), -np.inf)
    np.minimum.at(lower, of_vertex, V)
    np.maximum.at(upper, of_vertex, V)
    for b in range(parts):
        within = (lower >= lower[b]).all(axis=1) & (upper <= upper[b]).all(axis=1) & ~crosses[b]
        within[b] = False
        candidates = np.flatnonzero(within)
        if candidates.size == 0:
            continue
        chosen = [_spread(faces_of[a], PROBED_PLACES) for a in candidates]
        points = np.einsum("c,kcx->kx", PLACE_IN_FACE, V[F[np.concatenate(chosen)]])
        winding = winding_numbers(V, F[faces_of[b]], points)
        votes = np.split(np.abs(winding) > 0.5, np.cumsum([len(c) for c in chosen])[:-1])
        inside[candidates, b] = [2 * np.count_nonzero(vote) > len(vote) for vote in votes]
    return inside


def part_volumes(V: FloatArray, F: IntArray, part: IntArray) -> FloatArray:
    """Return the signed volume of each part, (k,), measured about the middle of its own corners."""
    corners = np.repeat(part, 3)
    count = np.maximum(np.bincount(corners), 1)
    middle = np.stack([np.bincount(corners, weights=x) / count for x in V[F].reshape(-1, 3).T], axis=1)
    A, B, C = (V[F] - middle[part][:, None]).transpose(1, 0, 2)
    return np.asarray(np.bincount(part, weights=np.einsum("ij,ij->i", A, np.cross(B, C)) / 6))


def winding_numbers(V: FloatArray, F: IntArray, points: FloatArray) -> FloatArray:
    """Return how often the faces wind round each of the points (k, 3), (k,)."""
    middle = V[F[0, 0]]  # near the origin they keep more digits
    used, faces = np.unique(F, return_inverse=True)
    # Summed over all faces: the quick trees of libigl are in single precision, and thin plates lie within its rounding.
    vertices, faces = np.ascontiguousarray(V[used] - middle), faces.reshape(-1, 3).astype(np.int64)
    winding = igl.winding_number(vertices, faces, np.ascontiguousarray(points - middle))
    return np.asarray(winding, dtype=np.float64).reshape(-1)


def unite(V: FloatArray, F: IntArray, found: Arrangement) -> United:
    """Return the mesh with every group of parts that cross in place of them as one solid.

    Args:
        V: Vertices, (n, 3).
        F: Faces, (m, 3), each part closed, and oriented as it was given.
        found: How its parts lie to each other.

    Raises:
        MeshError: A union cannot be made, or the winding numbers do not say which.
    """
    group = found.groups()
    crossing = np.unique(group[found.crosses.any(axis=1)])
    replaced = np.isin(group, crossing)
    kept = ~replaced[found.part]
    pieces_V, pieces_F, before, after, turned = [V], [F[kept]], 0.0, 0.0, 0
    count = len(V)
    for g in crossing.tolist():
        members = np.flatnonzero(group == g)
        new_V, new_F, volume, turned_faces = _one_solid(V, F, found, members)
        pieces_V.append(new_V)
        pieces_F.append(new_F + count)
        count += len(new_V)
        before, after = before + volume, after + signed_volume(new_V, new_F)
        turned += turned_faces
    all_V, all_F = np.concatenate(pieces_V), np.concatenate(pieces_F)
    return United(*_without_copies(all_V, all_F, len(V)), int(np.count_nonzero(replaced)), before, after, turned)


def _without_copies(V: FloatArray, F: IntArray, given: int) -> tuple[FloatArray, IntArray, IntArray]:
    """Drop what is unused; new vertices in the place of ones that were given are these, where only the new are used."""
    used = np.bincount(F.ravel(), minlength=len(V)) > 0
    places: dict[bytes, int] = {V[i].tobytes(): i for i in np.flatnonzero(~used[:given]).tolist()}
    target = np.arange(len(V))
    for i in range(given, len(V)):
        target[i] = places.pop(V[i].tobytes(), i)
    F = target[F]
    used = np.bincount(F.ravel(), minlength=len(V)) > 0
    number = np.where(used, np.cumsum(used) - 1, -1)
    return V[used], number[F], number[:given]


def _one_solid(
    V: FloatArray, F: IntArray, found: Arrangement, members: IntArray
) -> tuple[FloatArray, IntArray, float, int]:
    """Return the surface of a group of parts as one solid, the sum of their volumes, and how many faces were turned."""
    faces = {int(k): F[found.part == k] for k in members}
    volumes = {k: signed_volume(V, f) for k, f in faces.items()}
    first = F[found.part == members[0]][0, 0]
    signs = _trusted_signs(V, faces, volumes)
    if signs is None:
        signs = _signs_by_nesting(V, found, members, first)
    # From here on each part is oriented outwards, and its sign says if it adds or takes away.
    outward = {k: f if volumes[k] > 0 else f[:, ::-1] for k, f in faces.items()}
    oriented = np.concatenate([outward[k] if signs[k] > 0 else outward[k][:, ::-1] for k in outward])
    result = _expression(V, found, outward, signs)
    if _has_inner_walls(*result):
        # Parts that touch within the rounding of their corners keep a wall between them, unless they overlap a little.
        result = _expression(V, found, outward, signs, OVERLAP)
        if _has_inner_walls(*result):
            raise MeshError(
                f"parts of the mesh near {place(V[first])} touch within the rounding of their corners and cannot be "
                "united: a wall would be left between them. Unite them in a mesh editor, or move them apart."
            )
    _require_agreement(V, oriented, *result)
    turned = sum(len(faces[k]) for k in faces if signs[k] * volumes[k] < 0)
    return *result, sum(abs(volumes[k]) * signs[k] for k in faces), turned


def _trusted_signs(V: FloatArray, faces: dict[int, IntArray], volumes: dict[int, float]) -> dict[int, int] | None:
    """Return which parts add and which take away as their faces look; None where these contradict each other.

    They do where all parts together wind round a place in the negative sense: no solid looks so from either side.
    """
    together = np.concatenate(list(faces.values()))
    for turn in (1, -1):
        wound = _both_sides(V, together[:, ::turn])
        if wound.share(wound.outer < -0.5) + wound.share(wound.inner < -0.5) <= DISAGREEING_AREA:
            return {k: turn * int(np.sign(volume)) for k, volume in volumes.items()}
    return None


def _signs_by_nesting(V: FloatArray, found: Arrangement, members: IntArray, first: int) -> dict[int, int]:
    """Return signs for parts whose faces look every way: all add but those inside an odd number of others.

    Raises:
        MeshError: A part crosses one and is inside another, so that it may belong to the solid or to its cavity.
    """
    depth = found.inside[members].sum(axis=1)
    unclear = (depth > 0) & found.crosses[members].any(axis=1)
    if unclear.any():
        raise MeshError(
            f"parts of the mesh pass through each other inside another part, near {place(V[first])}, and their faces "
            "look in ways that no solid has: what is filled and what is hollow cannot be told. Turn the faces of the "
            "parts that bound a hollow inwards and those of the others outwards, in a mesh editor."
        )
    return {int(k): 1 if d % 2 == 0 else -1 for k, d in zip(members, depth, strict=True)}


def _expression(
    V: FloatArray, found: Arrangement, outward: dict[int, IntArray], signs: dict[int, int], overlap: float = 0.0
) -> tuple[FloatArray, IntArray]:
    """Return the union of all parts that add, each without those that take away right inside it."""
    every = np.concatenate(list(outward.values()))
    middle = (V[every].reshape(-1, 3).min(axis=0) + V[every].reshape(-1, 3).max(axis=0)) / 2
    solids = {k: _manifold(V, f, middle, overlap * signs[k]) for k, f in outward.items()}
    less: dict[int, list[int]] = {k: [] for k in solids if signs[k] > 0}
    alone = []  # parts that take away without lying inside one that adds
    for k in solids:
        if signs[k] < 0:
            around = [j for j in less if found.inside[k, j]]
            if around:
                less[min(around, key=lambda j: solids[j].volume())].append(k)
            else:
                alone.append(k)
    bodies = []
    for k, holes in less.items():
        body = solids[k]
        if holes:
            body = manifold3d.Manifold.batch_boolean([body, *(solids[j] for j in holes)], manifold3d.OpType.Subtract)
        bodies.append(body)
    union = manifold3d.Manifold.batch_boolean(bodies, manifold3d.OpType.Add)
    if alone:
        union = manifold3d.Manifold.batch_boolean([union, *(solids[j] for j in alone)], manifold3d.OpType.Subtract)
    if union.status() != manifold3d.Error.NoError or union.num_tri() == 0:
        raise MeshError(
            f"parts of the mesh that pass through each other near {place(middle)} could not be united: manifold3d says "
            f"{union.status().name}. Unite them in a mesh editor."
        )
    return _without_flat_faces(union, V, every, middle, overlap)


def _manifold(V: FloatArray, F: IntArray, middle: FloatArray, larger: float) -> Any:
    used, faces = np.unique(F, return_inverse=True)
    points = V[used] - middle
    if larger:
        own = (points.min(axis=0) + points.max(axis=0)) / 2
        points = points + larger * (points - own)
    mesh = manifold3d.Mesh64(np.ascontiguousarray(points), np.ascontiguousarray(faces.reshape(-1, 3).astype(np.uint64)))
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError:
        raise MeshError(
            f"the part of the mesh near {place(V[F[0, 0]])} passes through another and cannot be united with it: "
            f"manifold3d says {solid.status().name}. Is it closed? See mend_mesh."
        )
    return solid


def _without_flat_faces(
    solid: Any, V: FloatArray, F: IntArray, middle: FloatArray, overlap: float
) -> tuple[FloatArray, IntArray]:
    """Return a Manifold as arrays; where it has slivers, simplified within the rounding of the coordinates given."""
    size = float(np.ptp(V[F].reshape(-1, 3), axis=0).max())
    new_V, new_F = _arrays(solid, V, F, middle, 2 * overlap * size)
    if overlap == 0 and relative_heights(new_V, new_F).min() > FLATTEST_FACE:
        return new_V, new_F
    rounding = 8 * float(np.spacing(np.abs(V[F]).max()))
    simple = solid.simplify(max(rounding, 1e-12 * size, 4 * overlap * size))
    return _arrays(simple, V, F, middle, 2 * overlap * size)


def _arrays(solid: Any, V: FloatArray, F: IntArray, middle: FloatArray, near: float) -> tuple[FloatArray, IntArray]:
    """Return vertices and faces of a Manifold; those within a distance of a corner given are put exactly there."""
    mesh = solid.to_mesh64()
    points = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    faces = np.asarray(mesh.tri_verts, dtype=np.int64).reshape(-1, 3)
    target = np.arange(len(points))
    target[np.asarray(mesh.merge_from_vert, dtype=np.int64)] = np.asarray(mesh.merge_to_vert, dtype=np.int64)
    used, faces = np.unique(target[faces], return_inverse=True)
    points = points[used]
    given = np.unique(F)
    distance, nearest = cKDTree(V[given] - middle).query(points)
    found = np.asarray(distance) <= near
    new = points + middle
    corner = np.where(found, given[np.minimum(nearest, len(given) - 1)], -1)
    new[found] = V[corner[found]]
    # Neighbours that were put on one corner become one; others in one place are kept apart, as where edges touch.
    ends = half_edges(faces.reshape(-1, 3))
    short = ends[(corner[ends[:, 0]] == corner[ends[:, 1]]) & found[ends[:, 0]]]
    graph = sparse.coo_array((np.ones(len(short)), (short[:, 0], short[:, 1])), shape=(len(points), len(points)))
    of_group = csgraph.connected_components(graph, directed=False)[1]
    first = np.unique(of_group, return_index=True)[1]
    faces = first[of_group][faces.reshape(-1, 3)]
    used, faces = np.unique(faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)], return_inverse=True)
    return new[used], faces.reshape(-1, 3).astype(np.int64)


def _has_inner_walls(V: FloatArray, F: IntArray) -> bool:
    """Tell if some faces have the solid on both sides, or on neither."""
    wound = _both_sides(V, F)
    return wound.share((wound.outer > 0.5) | (wound.inner < 0.5)) > DISAGREEING_AREA


def inverted_face(V: FloatArray, F: IntArray) -> int | None:
    """Return a face of a part that is inside out, or None: the surface winds round places beside it backwards.

    Open parts count too, where they wind round places beside most of their faces by more than half.
    """
    parts, of_vertex = vertex_components(F, len(V))
    part = of_vertex[F[:, 0]]
    firsts = np.unique(part, return_index=True)[1]
    probed = np.union1d(_probed(F, INVERTED_PROBES), firsts)
    areas = face_areas(V, F)[probed]
    probed, areas = probed[areas > 0], areas[areas > 0]
    if not probed.size:
        return None
    wound = _both_sides(V, F, chosen=probed)
    backwards = np.minimum(wound.outer, wound.inner) < -0.5
    total = np.bincount(part[probed], weights=areas, minlength=parts)
    wrong = np.bincount(part[probed], weights=areas * backwards, minlength=parts)
    return next(iter(np.flatnonzero(wrong[part] > total[part] / 2).tolist()), None)


def hidden_faces(V: FloatArray, F: IntArray) -> BoolArray:
    """Return which faces, (m,), lie within the solid in their middle, where a part passes through itself."""
    middles = np.einsum("c,kcx->kx", PLACE_IN_FACE, V[F])
    return hidden_points(V, F, middles, np.arange(len(F))) & (face_areas(V, F) > 0)


def hidden_points(V: FloatArray, F: IntArray, points: FloatArray, faces: IntArray) -> BoolArray:
    """Return which points of a surface, (k,), have the solid on both sides.

    Args:
        V, F: The surface.
        points: On it, (k, 3).
        faces: On which of its faces each lies, (k,).
    """
    normals = unit_or_zero(doubled_area_vectors(V, F))[faces]
    away = HIDDEN_BESIDE * float(np.linalg.norm(np.ptp(V, axis=0))) * normals
    tree = igl.FastWindingNumberBVH()  # in single precision, which is enough at that distance
    middle = V.mean(axis=0)
    tree.init(V - middle, F, 2)
    outer, inner = (np.asarray(tree.winding_number(points + side - middle)).reshape(-1) > 0.5 for side in (away, -away))
    return np.asarray(outer & inner)


class _Wound(NamedTuple):
    """Winding numbers on both sides of some faces, and the area that each of these stands for."""

    outer: FloatArray
    inner: FloatArray
    areas: FloatArray
    points: FloatArray  # on the faces

    def share(self, where: BoolArray) -> float:
        """Return the part of the area where something is so."""
        return float(self.areas[where].sum() / self.areas.sum())


def _both_sides(
    V: FloatArray,
    F: IntArray,
    V2: FloatArray | None = None,
    F2: IntArray | None = None,
    *,
    chosen: IntArray | None = None,
) -> _Wound:
    """Return how often the faces, or those of a second mesh, wind round places beside the middles of some faces."""
    chosen = F[_probed(F, PROBED_FACES) if chosen is None else chosen]
    areas = face_areas(V, chosen)
    chosen, areas = chosen[areas > 0], areas[areas > 0]
    corners = V[chosen]
    points = np.einsum("c,kcx->kx", PLACE_IN_FACE, corners)
    normals = doubled_area_vectors(V, chosen) / (2 * areas[:, None])
    size = float(np.linalg.norm(np.ptp(V[F].reshape(-1, 3), axis=0)))
    away = max(BESIDE * size, 64 * float(np.spacing(np.abs(V[F]).max()))) * normals
    beside = np.concatenate([points + away, points - away])
    winding = winding_numbers(V if V2 is None else V2, F if F2 is None else F2, beside)
    return _Wound(winding[: len(points)], winding[len(points) :], areas, points)


def _require_agreement(V: FloatArray, F: IntArray, new_V: FloatArray, new_F: IntArray) -> None:
    """Refuse a union that is not where the parts wind round at least once."""
    wanted, got = _both_sides(V, F), _both_sides(V, F, new_V, new_F)
    wrong = ((wanted.outer > 0.5) != (got.outer > 0.5)) | ((wanted.inner > 0.5) != (got.inner > 0.5))
    share = wanted.share(wrong)
    if share > DISAGREEING_AREA:
        raise MeshError(
            f"parts of the mesh that pass through each other could not be united: near "
            f"{place(wanted.points[int(np.argmax(wrong))])} the union is not where they wind round (over {share:.2g} "
            "of their area). Does a part pass through itself, or a cavity through two bodies? Unite them in a mesh "
            "editor."
        )


def _probed(F: IntArray, most: int) -> IntArray:
    affordable = PAIRS_OF_POINT_AND_FACE // (2 * len(F))
    return _spread(np.arange(len(F)), max(min(most, affordable), LEAST_PROBED_FACES))


def _members(label: IntArray, count: int) -> list[IntArray]:
    order = np.argsort(label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1])


def _spread(items: IntArray, most: int) -> IntArray:
    """Return at most so many of the items, evenly spread over their order."""
    if len(items) <= most:
        return items
    return items[np.linspace(0, len(items) - 1, most).astype(np.int64)]
