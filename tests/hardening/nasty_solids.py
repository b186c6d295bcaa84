"""Some sixty meshes of the kinds that people bring, each with what it must be as a solid, worked out without triangles.

Solids of boxes are filled cells of the grid of all their sides: volume and area are sums over cells and their faces,
bodies and cavities are connected cells, and the genus follows from the Euler number of the cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from meshref import box, icosphere, volume
from meshref.formats.polygons import triangulated

Box = tuple[np.ndarray, np.ndarray, int]  # lower and upper corner, and how often it counts: -1 is a hollow


@dataclass(frozen=True)
class Nasty:
    """A mesh, and what it bounds."""

    name: str
    V: np.ndarray
    F: np.ndarray
    volume: float
    area: float | None = None
    bodies: int | None = None
    cavities: int | None = None
    genus: int | None = None
    tolerance: float = 1e-9
    refused: str = ""  # words of a refusal that is right too; of one that must come, where the volume is not a number


def joined(meshes: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return one mesh of several."""
    count = np.cumsum([0, *(len(V) for V, _ in meshes)])
    return np.concatenate([V for V, _ in meshes]), np.concatenate([F + n for (_, F), n in zip(meshes, count)])


def of_boxes(boxes: list[Box]) -> dict[str, Any]:
    """Return what is filled where boxes count at least once together: volume, area, bodies, cavities and genus."""
    sides = [np.unique([corner[axis] for lower, upper, _ in boxes for corner in (lower, upper)]) for axis in range(3)]
    wound = np.zeros([len(s) + 1 for s in sides], dtype=int)  # with a layer of nothing all round
    for lower, upper, count in boxes:
        wound[
            tuple(slice(np.searchsorted(s, a) + 1, np.searchsorted(s, b) + 1) for s, a, b in zip(sides, lower, upper))
        ] += count
    filled = wound >= 1
    lengths = [np.concatenate([[0], np.diff(s), [0]]) for s in sides]
    sizes = np.einsum("i,j,k->ijk", *lengths)
    area = 0.0
    for axis in range(3):
        across = [lengths[a] for a in range(3) if a != axis]
        walls = np.diff(filled.astype(int), axis=axis) != 0
        area += float(np.einsum("ijk,j,k->", np.moveaxis(walls, axis, 0), *across))
    bodies = ndimage.label(filled)[1]
    empty = ndimage.label(~filled, np.ones((3, 3, 3)))[1]
    return {
        "volume": float(sizes[filled].sum()),
        "area": area,
        "bodies": bodies,
        "cavities": empty - 1,
        "genus": bodies + empty - 1 - _euler(filled),
    }


def _euler(filled: np.ndarray) -> int:
    """Return the Euler number of closed filled cells: corners, minus edges, plus faces, minus cells."""
    total = 0
    for directions in np.ndindex(2, 2, 2):  # 0 for an axis along which the element has a length
        grown = filled
        for axis in np.flatnonzero(directions):
            grown = np.maximum(grown, np.roll(grown, 1, axis))
        total += (-1) ** (3 - sum(directions)) * int(grown.sum())
    return total


def mesh_of_boxes(boxes: list[Box]) -> tuple[np.ndarray, np.ndarray]:
    """Return the surfaces of boxes, those of hollows facing inwards."""
    meshes = [(*box(lower, upper), count) for lower, upper, count in boxes]
    return joined([(V, F if count > 0 else F[:, ::-1]) for V, F, count in meshes])


def placed(
    case: Nasty, rng: np.random.Generator, *, scale: float = 1.0, offset: float = 0.0, turn: bool = True
) -> Nasty:
    """Return the case turned, in another unit and elsewhere."""
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0] if turn else np.eye(3)
    V = (case.V @ R.T) * scale + offset * scale * rng.standard_normal(3)
    area = None if case.area is None else case.area * scale**2
    rounding = 1e-12 * (1 + offset)  # of coordinates, where they are large
    return replace(case, V=V, volume=case.volume * scale**3, area=area, tolerance=max(case.tolerance, rounding))


def random_boxes(rng: np.random.Generator, count: int) -> list[Box]:
    """Return boxes about a middle, most of which overlap."""
    middles = rng.uniform(-1, 1, (count, 3))
    half = rng.uniform(0.2, 0.9, (count, 3))
    return [(m - h, m + h, 1) for m, h in zip(middles, half)]


def corpus(seed: int = 0) -> Iterator[Nasty]:
    """Yield all of them."""
    rng = np.random.default_rng(seed)
    yield from _unions(rng)
    yield from _shells(rng)
    yield from _fins(rng)
    yield from _damaged(rng)
    yield from _balls(rng)
    yield from _prisms(rng)
    yield from _refused()


def _unions(rng: np.random.Generator) -> Iterator[Nasty]:
    for k in range(8):
        boxes = random_boxes(rng, 2 + 2 * k)
        yield placed(Nasty(f"union of {len(boxes)} boxes", *mesh_of_boxes(boxes), **of_boxes(boxes)), rng)
    for scale, offset in [(1e-9, 0), (1e9, 0), (1, 1e3), (1, 1e6), (1e-6, 1e5), (1e6, 1e4)]:
        boxes = random_boxes(rng, 5)
        case = Nasty(f"union in unit {scale:g} at {offset:g}", *mesh_of_boxes(boxes), **of_boxes(boxes))
        yield placed(case, rng, scale=scale, offset=offset)
    for k in range(6):  # on whole numbers: sides that lie on each other, unions by faces, edges and corners
        lower = rng.integers(0, 4, (4 + k, 3)).astype(float)
        boxes = [(a, a + s, 1) for a, s in zip(lower, rng.integers(1, 4, (4 + k, 3)).astype(float))]
        truth = of_boxes(boxes)
        yield Nasty(f"boxes on whole numbers, {len(boxes)}", *mesh_of_boxes(boxes), truth["volume"], truth["area"])
    for k in range(4):  # of unit squares: surfaces that cross along edges of both, and in no face
        lower = rng.integers(0, 4, (3 + k, 3)).astype(float)
        halvings = rng.integers(1, 3, 3 + k)
        boxes = [(a, a + 2.0**h, 1) for a, h in zip(lower, halvings)]
        truth = of_boxes(boxes)
        meshes = [box(a, a + 2.0**h, subdivisions=int(h)) for a, h in zip(lower, halvings)]
        yield Nasty(f"cubes of unit squares, {len(boxes)}", *joined(meshes), truth["volume"], truth["area"])


def _shells(rng: np.random.Generator) -> Iterator[Nasty]:
    def cube(half: float, count: int) -> Box:
        return np.full(3, -half), np.full(3, half), count

    for depth in (2, 3, 4, 6):
        boxes = [cube(1 - 0.15 * k, 1 if k % 2 == 0 else -1) for k in range(depth)]
        truth = of_boxes(boxes)
        meshes = [box(lower, upper) for lower, upper, _ in boxes]
        looks = rng.integers(0, 2, depth)
        V, F = joined([(V, F if look else F[:, ::-1]) for (V, F), look in zip(meshes, looks)])
        yield placed(Nasty(f"shells {depth} deep, looking {looks}", V, F, **truth), rng)
    wall = [cube(1.0, 1), cube(0.8, -1)]
    rods = {
        "a rod through a hollow box": [(np.array([-2, -0.1, -0.1]), np.array([2, 0.1, 0.1]), 1)],
        "a strut in a hollow box": [(np.array([-0.9, -0.1, -0.1]), np.array([0.9, 0.1, 0.1]), 1)],
        "two struts that cross in a hollow box": [
            (np.array([-0.9, -0.1, -0.1]), np.array([0.9, 0.1, 0.1]), 1),
            (np.array([-0.1, -0.9, -0.15]), np.array([0.1, 0.9, 0.15]), 1),
        ],
        "a box in a hollow box": [(np.full(3, -0.3), np.full(3, 0.3), 1)],
        "a box in the wall of a hollow box": [(np.array([0.85, -0.1, -0.1]), np.array([0.95, 0.1, 0.1]), 1)],
    }
    for name, more in rods.items():
        if name == "a box in the wall of a hollow box":  # it crosses none: a cavity
            truth = of_boxes([*wall, (*more[0][:2], -1)])
        else:
            truth = of_boxes([*wall, *more])
        yield placed(Nasty(name, *mesh_of_boxes([*wall, *more]), **truth), rng)


def _fins(rng: np.random.Generator) -> Iterator[Nasty]:
    for thickness in (1e-2, 1e-4, 1e-6):
        body = (np.zeros(3), np.ones(3), 1)
        fins = [(np.array([0.2 * k, 0.1, 0.5]), np.array([0.2 * k + thickness, 0.9, 2]), 1) for k in (1, 2, 3, 4)]
        boxes = [body, *fins]
        case = Nasty(f"fins of {thickness:g}", *mesh_of_boxes(boxes), **of_boxes(boxes))
        yield placed(case, rng)
        sheet = [(np.zeros(3), np.array([1, 1, thickness]), 1)]
        yield placed(Nasty(f"a plate of {thickness:g}", *mesh_of_boxes(sheet), **of_boxes(sheet)), rng)
    gap = 1e-5
    boxes = [(np.zeros(3), np.ones(3), 1), (np.array([0, 0, 1 + gap]), np.array([1, 1, 2 + gap]), 1)]
    yield placed(Nasty("two boxes nearly touching", *mesh_of_boxes(boxes), **of_boxes(boxes)), rng)


def _damaged(rng: np.random.Generator) -> Iterator[Nasty]:
    boxes = random_boxes(rng, 4)
    truth = of_boxes(boxes)
    V, F = mesh_of_boxes(boxes)
    flip = rng.random(len(F)) < 0.4
    yield placed(Nasty("faces that look every way", V, np.where(flip[:, None], F[:, ::-1], F), **truth), rng)
    yield placed(Nasty("faces twice", V, np.concatenate([F, F[::3], F[::2, ::-1]]), **truth), rng)
    yield placed(Nasty("surfaces twice", *joined([(V, F), (V, F)]), **truth), rng)
    soup = V[F].reshape(-1, 3)
    yield placed(Nasty("a soup of triangles", soup, np.arange(len(soup)).reshape(-1, 3), **truth), rng)
    jitter = soup + 1e-12 * rng.standard_normal(soup.shape)
    yield placed(Nasty("a soup not quite closed", jitter, np.arange(len(soup)).reshape(-1, 3), **truth), rng)
    yield placed(Nasty("mirrored", V * [1, 1, -1], F, **truth), rng)
    parts = [box(lower, upper) for lower, upper, _ in boxes]
    some = joined([(V, F if k % 2 else F[:, ::-1]) for k, (V, F) in enumerate(parts)])
    yield placed(Nasty("every other part inside out", *some, **truth), rng)
    hole = np.delete(F, [0, 1], axis=0)  # a whole side of the first box
    yield placed(Nasty("a side missing", V, hole, **truth, refused="longer than the limit"), rng)
    unused = np.concatenate([V, rng.uniform(5, 9, (7, 3))])
    yield placed(Nasty("points that no face has", unused, F, **truth), rng)


def _prisms(rng: np.random.Generator) -> Iterator[Nasty]:
    """Prisms over stars, whose ends are polygons: the area of these, found from their corners, times the height."""
    for corners in (4, 6, 11, 40):
        angle = (np.arange(corners) + rng.uniform(0, 0.8, corners)) * 2 * np.pi / corners
        flat = rng.uniform(0.3, 2, (corners, 1)) * np.column_stack([np.cos(angle), np.sin(angle)])
        V = np.concatenate([np.column_stack([flat, np.full(corners, z)]) for z in (0.0, 0.7)])
        around = np.arange(corners)
        sides = np.column_stack([around, np.roll(around, -1), corners + np.roll(around, -1), corners + around])
        F = triangulated(V, [around[::-1].tolist(), (corners + around).tolist(), *sides.tolist()])
        x, y = flat.T
        inside = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        walls = 0.7 * float(np.linalg.norm(flat - np.roll(flat, 1, axis=0), axis=1).sum())
        case = Nasty(f"a star of {corners} corners", V, F, 0.7 * inside, 2 * inside + walls, 1, 0, 0)
        yield placed(case, rng, offset=1e3)


def _balls(rng: np.random.Generator) -> Iterator[Nasty]:
    """Balls apart and hollow, by the volume of one."""
    V, F = icosphere(2)
    whole = volume(V, F)
    for k in range(4):
        far = np.array([4.0, 0, 0])
        apart = [(V * r + far * i, F) for i, r in enumerate(rng.uniform(0.5, 1.5, 3 + k))]
        total = sum(volume(*mesh) for mesh in apart)
        yield placed(
            Nasty(f"{len(apart)} balls apart", *joined(apart), total, bodies=len(apart), cavities=0, genus=0), rng
        )
    for radius in (0.1, 0.5, 0.9):
        hollow = joined([(V, F), (V * radius, F)])
        yield placed(
            Nasty(f"a ball hollow to {radius}", *hollow, whole * (1 - radius**3), bodies=1, cavities=1, genus=0), rng
        )
    halves = [(np.array([-2.0, -2, 0]), np.full(3, 2.0), 1), (np.full(3, -2.0), np.array([2.0, 2, 0]), 1)]
    yield placed(Nasty("halves that touch", *mesh_of_boxes(halves), **of_boxes(halves)), rng)


def _refused() -> Iterator[Nasty]:
    n = 12
    u = 2 * np.pi * np.arange(n) / n
    for twists in (1, 3):
        middle = np.stack([np.cos(u), np.sin(u), 0 * u], axis=1)
        half = twists * u / 2
        across = 0.2 * np.stack([np.cos(half) * np.cos(u), np.cos(half) * np.sin(u), np.sin(half)], axis=1)
        V = np.stack([middle - across, middle + across], axis=1).reshape(-1, 3)
        i = np.arange(n)
        c, d = np.where(i == n - 1, 1, 2 * i + 2), np.where(i == n - 1, 0, 2 * i + 3)
        F = np.concatenate([np.stack([2 * i, 2 * i + 1, c], axis=1), np.stack([2 * i + 1, d, c], axis=1)])
        yield Nasty(f"a strip of {twists} half twists", V, F, np.nan, refused="must have two sides")
    V, F = box()
    fin = np.concatenate([V, [[2.0, 2, 2]]]), np.concatenate([F, [[F[0, 0], F[0, 1], 8]]])
    yield Nasty("a face on the edge of a box", *fin, np.nan, refused="more than two faces meet")
    sheet = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    yield Nasty("a flat sheet", sheet, np.array([[0, 1, 2], [0, 2, 3]]), np.nan, refused="flat|cannot be closed|longer")
    outer, inner = box((0, 0, 0), (10, 10, 10)), box((1, 1, 1), (9, 9, 9))
    strut = box((0.5, 4, 4), (9.5, 5, 5))
    wrong = joined([outer, (inner[0], inner[1][:, ::-1]), (strut[0], strut[1][:, ::-1])])
    yield Nasty(
        "a strut that looks inwards", *wrong, np.nan, refused="what is filled and what is hollow cannot be told"
    )


def figure_of_eight(around=120, radius=0.12):
    """Return a tube along a figure of eight, which passes through itself in the middle."""
    t = np.linspace(0, 2 * np.pi, around, endpoint=False)
    middle = np.stack([np.sin(t), np.sin(t) * np.cos(t), 0 * t], axis=1)
    along = np.roll(middle, -1, axis=0) - np.roll(middle, 1, axis=0)
    side = np.cross(along / np.linalg.norm(along, axis=1)[:, None], [0, 0, 1.0])
    u = 2 * np.pi * np.arange(24) / 24
    up = np.array([0, 0, 1.0])
    V = middle[:, None] + radius * (np.cos(u)[:, None] * side[:, None] + np.sin(u)[:, None] * up)
    i, j = (k.ravel() for k in np.indices((around, 24)))
    a, b, c, d = (24 * ((i + p) % around) + (j + q) % 24 for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
    F = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return V.reshape(-1, 3), F
