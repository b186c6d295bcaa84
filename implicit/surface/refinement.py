"""Single cells of a grid marched finer, where its own size does not resolve the surface.

Such a cell is cut into FACTOR^3. Its triangles meet those of its coarse neighbours in a common face, and both sides'
curves there must be the same, or the seam costs two orders: that is for those who place the vertices to see to, and
`Pieces` says where. Where a face at a seam shows the finer cells more than its corners tell, the coarse cell behind it
is refined too, so that the curves of both sides have the same ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from numpy.typing import NDArray
from scipy.ndimage import label
from skimage.measure import marching_cubes

from implicit.field.field import Field
from implicit.surface.extraction import PlacedOnGrid
from implicit.surface.marching import Grid, edges_of_places, node_values

# Parts along a side of a refined cell.
FACTOR = 4
SIDE = FACTOR + 1  # nodes

# Rounds in which neighbours of refined cells are found to need it too, one cell farther each.
ROUNDS = 16


@dataclass(frozen=True, eq=False)
class Pieces:
    """Triangles of coarse and of refined cells; lengths are of refined cells, from the lower corner of the grid.

    Attributes:
        places: Where their vertices are about (N, 3).
        lower: The node at the lower end of the edge of the grid that each lies on (N, 3); its own place inside a cell.
        upper: The other end.
        faces: Triangles (M, 3), first those of coarse cells.
        cells: The cell of the grid that holds each of these (C, 3).
        at_seam: True for each vertex in a face, or on an edge, between coarse and refined cells (N,).
        planes: For each edge of each triangle, 01, 12, 20, the axis across the face at a seam that it lies in, or -1.
    """

    places: Float[NDArray, "n 3"]
    lower: Float[NDArray, "n 3"]
    upper: Float[NDArray, "n 3"]
    faces: Int[NDArray, "m 3"]
    cells: Int[NDArray, "c 3"]
    at_seam: Bool[NDArray, " n"]
    planes: Int[NDArray, "m 3"]


class RefinedGrid:
    """A grid of which some cells are refined.

    Args:
        field: The field.
        marched: Its mesh on the grid.

    Attributes:
        flags: True for each refined cell of the grid (X, Y, Z).
    """

    def __init__(self, field: Field, marched: PlacedOnGrid) -> None:
        grid = marched.grid
        self.flags = np.zeros(grid.cells, dtype=bool)
        self._marched, self._signs = marched, marched.signs.cpu().numpy()
        fine = Grid(grid.lower, grid.cell / FACTOR, tuple(FACTOR * count for count in grid.cells))
        self._value = node_values(field.to(torch.float32), fine, marched.crossings.steepest)
        self._nodes = fine.nodes
        self._index = np.empty((0, 3), dtype=np.int64)
        self._values = np.empty((0, SIDE, SIDE, SIDE), dtype=np.float32)

    def refine(self, index: Int[NDArray, "n 3"]) -> None:
        """Refine cells, and those beside them of which they show that they need it."""
        new = index
        for _ in range(ROUNDS):
            new = np.unique(new[~self.flags[tuple(new.T)]], axis=0)
            if len(new) == 0:
                break
            self.flags[tuple(new.T)] = True
            values = self._values_in(new)
            self._index, self._values = np.concatenate([self._index, new]), np.concatenate([self._values, values])
            new = self._unlike(new, values < 0)

    def _values_in(self, index: Int[NDArray, "n 3"]) -> Float32[NDArray, "n s s s"]:
        """Return f at the finer nodes of cells; those told by the grid itself have the sign that they have there."""
        nodes = FACTOR * index[:, None] + np.stack(np.unravel_index(np.arange(SIDE**3), (SIDE,) * 3), axis=1)
        keys, where = np.unique(np.ravel_multi_index(tuple(nodes.reshape(-1, 3).T), self._nodes), return_inverse=True)
        unique = np.stack(np.unravel_index(keys, self._nodes), axis=1)
        values = self._value(unique)
        own = (unique % FACTOR == 0).all(axis=1)
        told = self._signs[tuple((unique[own] // FACTOR).T)]
        values[own] = np.where(told == 0, values[own], np.abs(values[own]) * np.sign(told))
        return values[where].reshape(len(index), SIDE, SIDE, SIDE)

    def _unlike(self, index: Int[NDArray, "n 3"], inside: Bool[NDArray, "n s s s"]) -> Int[NDArray, "k 3"]:
        """Return the coarse cells beside refined ones that do not tell the surface as these do in their common face."""
        found = []
        for axis, end in product(range(3), (0, 1)):
            beside = index.copy()
            beside[:, axis] += 2 * end - 1
            within = np.all((beside >= 0) & (beside < self.flags.shape), axis=1, keepdims=True)[:, 0]
            within[within] = ~self.flags[tuple(beside[within].T)]
            told = as_corners_tell(np.take(inside[within], -end, axis=axis + 1))
            found.append(beside[within][~told])
        return np.concatenate(found)

    def pieces(self) -> Pieces:
        """Return the triangles of all cells, each as fine as its cell."""
        start, grid = self._marched.crossings, self._marched.grid
        places, lower, upper = (
            ((x - grid.lower) / grid.cell * FACTOR).cpu().numpy() for x in (start.points, start.lower, start.upper)
        )
        inside = (lower == upper).all(axis=1, keepdims=True)
        lower, upper = (np.where(inside, places, np.rint(x)) for x in (lower, upper))
        places = np.where(lower == upper, lower, places)
        faces = self._marched.faces.cpu().numpy()
        cells = np.floor(places[faces].mean(axis=1) / FACTOR).astype(np.int64)
        kept = ~self.flags[tuple(cells.T)]
        fine = self._march()
        faces = np.concatenate([faces[kept], fine[3] + len(places)])
        places, lower, upper = (
            np.concatenate(both) for both in ((places, fine[0]), (lower, fine[1]), (upper, fine[2]))
        )
        at_seam, planes = self._seams(places, lower, upper, faces)
        return Pieces(places, lower, upper, faces, cells[kept], at_seam, planes)

    def _march(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return places, lower and upper ends of the vertices in refined cells, and their triangles."""
        inside = self._values < 0
        crossed = inside.any(axis=(1, 2, 3)) & ~inside.all(axis=(1, 2, 3))
        index, values = self._index[crossed], self._values[crossed]
        if len(index) == 0:
            none = np.empty((0, 3))
            return none, none, none, np.empty((0, 3), dtype=np.int64)
        # The cells side by side in one array; what is marched between them is dropped.
        across = int(np.ceil(len(index) ** (1 / 3)))
        room = np.ones((across**3, SIDE, SIDE, SIDE), dtype=np.float32)
        room[: len(index)] = values
        room = room.reshape(across, across, across, SIDE, SIDE, SIDE).transpose(0, 3, 1, 4, 2, 5)
        vertices, triangles, _, _ = marching_cubes(room.reshape([across * SIDE] * 3), 0.0)
        corners = vertices.astype(np.float64)[triangles]
        block = (corners.mean(axis=1) // SIDE).astype(np.int64)
        corners -= SIDE * block[:, None]
        kept = (corners.mean(axis=1) < FACTOR).all(axis=1)
        shift = FACTOR * index[np.ravel_multi_index(tuple(block[kept].T), (across,) * 3)]
        place = corners[kept].reshape(-1, 3)
        node, along = edges_of_places(place)
        place, node = (x + np.repeat(shift, 3, axis=0) for x in (place, node))
        inner = along.sum(axis=1, keepdims=True) > 1
        keys = 4 * np.ravel_multi_index(tuple(node.T), self._nodes) + np.where(inner[:, 0], 3, along.argmax(axis=1))
        _, first, merged = np.unique(keys, return_index=True, return_inverse=True)
        lower, upper = (np.where(inner, place, end)[first] for end in (node, node + along))
        return place[first], lower, upper, merged.reshape(-1, 3)

    def _seams(
        self, places: Float[NDArray, "n 3"], lower: Float[NDArray, "n 3"], upper: Float[NDArray, "n 3"], faces: NDArray
    ) -> tuple[Bool[NDArray, " n"], Int[NDArray, "m 3"]]:
        """Return which vertices are at a seam, and the axes of the edges that are."""
        refined = np.pad(self.flags, 1, mode="edge")
        in_face = (lower == upper) & (lower % FACTOR == 0)
        in_face &= ~(lower == upper).all(axis=1, keepdims=True)
        first = np.where(in_face, np.rint(places / FACTOR) - 1, np.floor(places / FACTOR)).astype(np.int64)
        about = [refined[tuple((first + 1 + in_face * step).T)] for step in product((0, 1), repeat=3)]
        planes = np.full(faces.shape, -1)
        for k in range(3):
            a, b = faces[:, k], faces[:, (k + 1) % 3]
            middle = np.floor((places[a] + places[b]) / 2 / FACTOR).astype(np.int64)
            for axis in range(3):
                shared = in_face[a, axis] & in_face[b, axis] & (lower[a, axis] == lower[b, axis])
                above = middle.copy()
                above[:, axis] = np.rint(lower[a, axis] / FACTOR)
                below = above - (np.arange(3) == axis)
                planes[shared & (refined[tuple((above + 1).T)] != refined[tuple((below + 1).T)]), k] = axis
        return np.logical_or.reduce(about) & ~np.logical_and.reduce(about), planes


def as_corners_tell(inside: Bool[NDArray, "n s s"]) -> Bool[NDArray, " n"]:
    """Return for each face of cells whether the signs at its finer nodes say no more than those at its corners.

    They do not where each side has one change of sign at most, and there is one region of each sign at most; of
    corners that alternate, which may be joined either way, they always do.
    """
    if len(inside) == 0:
        return np.zeros(0, dtype=bool)
    sides = np.stack([inside[:, 0], inside[:, -1], inside[:, :, 0], inside[:, :, -1]], axis=1)
    changes = np.diff(sides, axis=2).sum(axis=2)
    in_plane = np.zeros((3, 3, 3), dtype=bool)
    in_plane[1, 1, :] = in_plane[1, :, 1] = True
    regions = np.zeros(len(inside), dtype=np.int64)
    for sign in (inside, ~inside):
        labels, count = label(sign, structure=in_plane)
        owner = np.zeros(count + 1, dtype=np.int64)
        owner[labels] = np.arange(len(inside))[:, None, None]
        regions += np.bincount(owner[1:], minlength=len(inside))
    total = changes.sum(axis=1)
    return (changes <= 1).all(axis=1) & (total < 4) & (regions == 1 + (total > 0))
