"""Spokes and rims of a surface that is filled: points inside that hold it apart.

    E(u) + w sum over the points p inside  sum over their neighbours q  |(u_p - u_q) - R_p (x_p - x_q)|^2

A surface alone lets its inside go. A tube that is turned about its axis pinches where it costs least, until it passes
through itself there and what was turned unwinds, however short the steps and whatever volume is held: of a bar ten
times as long as wide, with 4000 vertices, at 165 degrees. Points inside, each with a rotation of its own, which is a
proper one, cost more the more they are squeezed, and turned inside out most of all.

The neighbours are the nearest of surface and inside, without those across a gap, and the price w of all is such that a
uniform stretch costs the inside `firmness` times what it costs the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy import sparse
from scipy.spatial import cKDTree

from implicit.field.field import Field
from implicit.sensitivity.weak_curvature import FloatArray, IntArray, WeakSurface
from implicit.step.spokes_and_rims import SpokesAndRims

# Spacing of the points inside, in spacings of the vertices, and how far within the surface they begin, in their own.
SPACING = 2.0
DEPTH = 0.4

# How far they are shaken off their grid, in spacings: no two planes of them are then the same, whatever the shape.
SHAKEN = 0.1

# Neighbours of each: in a grid those along its axes and diagonals. Most points: for more they are set further apart.
NEIGHBOURS = 14
MOST = 6000


@dataclass(frozen=True, eq=False)
class Filled(SpokesAndRims):
    """The energy of a surface and of points inside it, whose cells stand after those of the surface.

    Attributes:
        vertices: Of the surface and, after these, the points inside (V + I, 3).
        faces: Of the surface (m, 3).
        shell: The energy of the surface alone.
        ties: Ends of the edges inside (k, 2), each in the cell of its first one, a point inside.
        price: w.
    """

    shell: SpokesAndRims
    ties: IntArray
    price: float

    @classmethod
    def of(cls, field: Field, shell: SpokesAndRims, firmness: float, seed: int = 0) -> Filled:
        """Return that of a surface.

        Args:
            field: Whose surface it is.
            shell: The energy of the surface.
            firmness: Cost of a uniform stretch inside, over that of the surface.
            seed: Of the shaking.
        """
        inside = points_inside(field, WeakSurface(shell.vertices, shell.faces), seed)
        vertices = np.concatenate([shell.vertices, inside])
        ties = _ties(field, vertices, len(shell.vertices))
        stretched = float(((vertices[ties[:, 0]] - vertices[ties[:, 1]]) ** 2).sum())
        part = 0.01
        whole = shell.energy((1 + part) * shell.vertices) / part**2
        return cls(vertices, shell.faces, shell, ties, firmness * whole / stretched if len(ties) else 0.0)

    @cached_property
    def _edges(self) -> tuple[IntArray, IntArray]:
        ends, opposite = self.shell._edges
        return np.concatenate([ends, self.ties]), opposite

    @cached_property
    def cells(self) -> sparse.csr_array:
        """C, the weight of each edge in each cell (V + I, E)."""
        first = len(self.shell.vertices)
        places = (self.ties[:, 0] - first, np.arange(len(self.ties)))
        shape = (len(self.vertices) - first, len(self.ties))
        inside = sparse.coo_array((np.full(len(self.ties), self.price), places), shape=shape)
        return sparse.csr_array(sparse.block_diag([self.shell.cells, inside]))


def points_inside(field: Field, surface: WeakSurface, seed: int = 0) -> FloatArray:
    """Return points of a shaken grid inside a surface (I, 3), none where it is too thin for one."""
    x = surface.vertices
    low, high = x.min(axis=0), x.max(axis=0)
    # Of triangles alike, each has half the area of a vertex.
    spacing = SPACING * float(surface.contents.sum() / len(x)) ** 0.5
    spacing = max(spacing, float(np.prod(high - low) / MOST) ** (1 / 3))
    axes = [np.arange(start + spacing / 2, end, spacing) for start, end in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid += SHAKEN * spacing * np.random.default_rng(seed).uniform(-1, 1, grid.shape)
    deep = cKDTree(x).query(grid)[0] > DEPTH * spacing
    return np.asarray(grid[deep & _inside(field, grid)])


def _ties(field: Field, points: FloatArray, first: int) -> IntArray:
    """Return the edges from each point from the first one inside on to its neighbours (k, 2)."""
    inside = points[first:]
    count = min(NEIGHBOURS, len(points) - 1)
    if not len(inside):
        return np.zeros((0, 2), dtype=np.int64)
    found = np.asarray(cKDTree(points).query(inside, k=count + 1)[1])[:, 1:]
    ties = np.stack([np.repeat(np.arange(first, len(points)), count), found.ravel()], axis=1)
    return np.asarray(ties[_inside(field, points[ties].mean(axis=1))])


def _inside(field: Field, points: FloatArray) -> np.ndarray:
    values = field.value(torch.from_numpy(points).to(field.theta))
    return np.asarray((values < 0).cpu().numpy())
