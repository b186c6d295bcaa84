"""The quadrature of surface_quadrature, on finer cells where those of the grid do not follow the surface.

A cell is unresolved where the middle of a curved triangle is off the surface, or turned against it, by more than a few
hundredths, or where Newton's method leads from the middle of a cell of one sign to surface that no triangle is near.
Such cells are cut into 4^3 (implicit.surface.refinement). On a bundled shape there are none; on a scan with thin parts
a hundred, which bring the error of its volume at 64 cells from 4e-4 to 1e-7.

At a seam the vertices lie on edges of the grid and the middles of edges in the plane of the common face, where both
sides follow the same curve f = 0; the coarse triangle is cut along that curve, until its parts are as short as those of
the other side. So the fourth order is kept (measured on spheres and tori with cells refined at random).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from implicit.field.field import Field
from implicit.surface.bracketing import bracketed_zeros
from implicit.surface.creases import edges_of, split_triangles
from implicit.surface.extraction import PlacedOnGrid, on_their_side
from implicit.surface.marching import Crossings
from implicit.surface.projection import SLACK, in_working_precision, place_on_surface
from implicit.surface.quadrature import (
    MOST_BULGE,
    CurvedCells,
    CurvedMesh,
    MeshedSample,
    cell_points,
    curved_mesh,
    meshed_sample,
    middle_nodes,
    with_creases,
)
from implicit.surface.refinement import FACTOR, ROUNDS, Pieces, RefinedGrid
from implicit.surface.unseen import entered_cells, nearest_of_sample

# A triangle is off the surface where its middle is, by more than this share of a cell, or its normal there by so much
# that the cosine is less.
OFF = 0.01
TURNED = 0.985

# Surface in a cell of one sign is not that of the triangles beside it where it is so far off their planes, in cells, or
# turned by so much that the cosine is less.
BESIDE = 0.05
OTHERWISE = 0.5

# Above this share of the cells that the surface crosses nothing about the fault of their triangles is local, and a
# finer grid is cheaper. What no triangle is near is refined whatever its share, up to so many cells.
MOST_REFINED = 1 / 4

# A mesh that was split along creases in more than this share of its triangles is a polyhedron, as of ReLU networks. Its
# corners are in most cells, and a finer grid brings the error of their triangles down for less.
MOST_CREASED = 0.1
MOST_MISSED = 4000

IN_PLANE_STEPS = 20


def refined_quadrature(field: Field, resolution: int, *, most: float = MOST_REFINED) -> MeshedSample:
    """Return the quadrature of meshed_quadrature with unresolved cells refined, in 3D; in the plane the same.

    The vertices and faces are still those of the grid, for whoever counts pieces.

    Args:
        field: The field.
        resolution: Cells along the longest side of the bounds.
        most: Share of the cells that the surface crosses above which those whose triangles are off it are left as
            they are.

    Raises:
        SurfaceError: There is no surface in the bounds, it leaves them, or the gradient vanishes on it.
    """
    curved = curved_mesh(field, resolution)
    marched = curved.marched
    meshed = meshed_sample(field, curved.cells, marched)
    if field.dimension == 2:
        return meshed
    working = in_working_precision(field)
    meshed = replace(meshed, entered=entered_cells(working, meshed))
    unresolved = _unresolved(working, curved, meshed, most)
    if len(unresolved) == 0:
        return meshed
    refined, pieces, mesh = _without_lost_seams(working, marched, unresolved)
    finer = meshed_sample(field, _curved(working, curved, pieces, mesh), marched)
    return replace(finer, refined=int(refined.flags.sum()), entered=meshed.entered)


def _unresolved(field: Field, curved: CurvedMesh, meshed: MeshedSample, most: float) -> Int[NDArray, "n 3"]:
    """Return the cells of the grid whose triangles are not on the surface, or whose surface has no triangles."""
    nodes, cell = curved.cells.nodes, meshed.grid.cell
    points, across = cell_points(nodes, nodes.new_full((len(nodes), 2), 1 / 3))
    value, gradient = field.value_and_gradient(points)
    slope = gradient.norm(dim=1)
    cosine = (gradient * across).sum(dim=1) / (slope * across.norm(dim=1))
    followed = (value.abs() <= OFF * cell * slope) & (cosine >= TURNED)
    grid = meshed.grid
    keys = grid.number(grid.cells_of(nodes[:, :3].mean(dim=1)))
    found = [torch.unique(keys[~followed])]
    flat = len(curved.marched.faces)
    if len(found[0]) > most * len(torch.unique(keys)) or len(nodes) - flat > MOST_CREASED * flat:
        found = []
    assert meshed.entered is not None
    index, points = meshed.entered
    if len(points):
        sample = meshed.sample.to(points.dtype)
        nearest, near = nearest_of_sample(meshed, index, points)
        at, normals = sample.points[nearest], sample.normals[nearest]
        off = ((points - at) * normals).sum(dim=1).abs()
        turned = (field.normal(points) * normals).sum(dim=1) < OTHERWISE
        missed = index[~near | turned | (off > BESIDE * cell)]
        found += [grid.number(missed)] if len(missed) <= MOST_MISSED else []
    unresolved = torch.unique(torch.cat([*found, keys[:0]])).cpu().numpy()
    return np.stack(np.unravel_index(unresolved, grid.cells), axis=1)


# Vertices, and edges at seams


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of triangles in faces between coarse and refined cells.

    Attributes:
        ends: Two vertices, the smaller first (S, 2); each edge once.
        axes: The axis across the face (S,).
        cells: The coarse cell (S, 3), of those of coarse triangles.
    """

    ends: Int[Tensor, "s 2"]
    axes: Int[Tensor, " s"]
    cells: Int[Tensor, "s 3"]

    @classmethod
    def of(cls, faces: Int[Tensor, "m 3"], planes: Int[Tensor, "m 3"], cells: Int[Tensor, "m 3"]) -> _Edges:
        which, k = (planes >= 0).nonzero().T
        ends = torch.stack([faces[which, k], faces[which, (k + 1) % 3]], dim=1).sort(dim=1).values
        return cls(ends, planes[which, k], cells[which])._once()

    def __len__(self) -> int:
        return len(self.ends)

    def __add__(self, other: _Edges) -> _Edges:
        return _Edges(*(torch.cat([getattr(x, name) for x in (self, other)]) for name in ("ends", "axes", "cells")))

    def _once(self) -> _Edges:
        codes = self.ends[:, 0] * (1 + int(self.ends.max()) if len(self) else 1) + self.ends[:, 1]
        _, where = torch.unique(codes, return_inverse=True)
        first = torch.empty(int(where.max()) + 1 if len(where) else 0, dtype=torch.long, device=where.device)
        first[where] = torch.arange(len(where), device=where.device)
        return self.only(first)

    def only(self, which: Tensor) -> _Edges:
        return _Edges(self.ends[which], self.axes[which], self.cells[which])

    def halved(self, middles: Int[Tensor, " s"]) -> _Edges:
        """Return both halves of each edge; a middle is a vertex with a larger number than any before."""
        first, second = (_Edges(torch.stack([end, middles], dim=1), self.axes, self.cells) for end in self.ends.T)
        return first + second

    def among(self, edges: Int[Tensor, "e 2"]) -> Int[Tensor, " s"]:
        """Return where each is in a list of all edges, which are in order."""
        return _among(self.ends, edges)

    def middles(self, field: Field, corners: Float[Tensor, "v 3"]) -> tuple[Float[Tensor, "s 3"], Bool[Tensor, " s"]]:
        """Return the middle of each, brought to f = 0 within the plane of its face, and True where that is near.

        Of the others the middle of the chord is returned.
        """
        ends = corners[self.ends]
        start = ends.mean(dim=1)
        within = torch.ones_like(start).scatter_(1, self.axes[:, None], 0.0)
        tolerance = field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)
        x = start
        for _ in range(IN_PLANE_STEPS if len(self) else 0):
            value, gradient = field.value_and_gradient(x, validate=False)
            gradient = within * gradient
            square = (gradient * gradient).sum(dim=1)
            step = -(value / square.clamp(min=torch.finfo(value.dtype).tiny))[:, None] * gradient
            x = x + step
            if bool((step.norm(dim=1) <= tolerance).all()):
                break
        value, gradient = field.value_and_gradient(x, validate=False)
        arrived = value.abs() <= SLACK * tolerance * (within * gradient).norm(dim=1)
        near = (x - start).norm(dim=1) <= MOST_BULGE * (ends[:, 1] - ends[:, 0]).norm(dim=1)
        good = arrived & near
        return torch.where(good[:, None], x, start), good


@dataclass(frozen=True, eq=False)
class _Mesh:
    """Triangles of coarse and refined cells that fit each other, with their seams."""

    corners: Float[Tensor, "v 3"]
    gradients: Float[Tensor, "v 3"]
    faces: Int[Tensor, "m 3"]
    seams: _Edges


def _without_lost_seams(
    field: Field, marched: PlacedOnGrid, unresolved: Int[NDArray, "n 3"]
) -> tuple[RefinedGrid, Pieces, _Mesh]:
    """Refine cells until each coarse edge at a seam follows its curve, and return the mesh."""
    refined = RefinedGrid(field, marched)
    refined.refine(unresolved)
    for _ in range(ROUNDS):
        pieces = refined.pieces()
        mesh, lost = _meshed(field, marched, pieces)
        if len(lost) == 0:
            break
        refined.refine(np.unique(lost, axis=0))
    return refined, pieces, _with_fine_vertices(field, marched, pieces, mesh)


def _places(marched: PlacedOnGrid, units: Float[NDArray, "n 3"]) -> Float[Tensor, "n 3"]:
    lower = marched.grid.lower
    return lower + torch.from_numpy(units).to(lower) * (marched.grid.cell / FACTOR)


def _meshed(field: Field, marched: PlacedOnGrid, pieces: Pieces) -> tuple[_Mesh, Int[NDArray, "k 3"]]:
    """Return the mesh with its seams, but the other vertices of refined cells only about where they are.

    Returns:
        The mesh; and the coarse cells of which an edge at a seam does not follow the curve in its face.
    """
    device = marched.grid.lower.device
    coarse = marched.placement
    others = _places(marched, pieces.places[len(coarse.points) :])
    corners = torch.cat([coarse.points, others])
    gradients = torch.cat([coarse.gradients, torch.zeros_like(others)])
    seam = torch.from_numpy(np.flatnonzero(pieces.at_seam)).to(device)
    lower, upper = (_places(marched, x[pieces.at_seam]) for x in (pieces.lower, pieces.upper))
    corners[seam] = _on_their_edges(field, lower, upper)
    gradients[seam] = field.gradient(corners[seam])
    faces, planes = (torch.from_numpy(x).to(device) for x in (pieces.faces, pieces.planes))
    cells = torch.from_numpy(pieces.cells).to(device)
    count = len(cells)
    fine = _Edges.of(faces[count:], planes[count:], faces[count:])
    edges, triangles = _Edges.of(faces[:count], planes[:count], cells), faces[:count]
    lost = [cells[:0]]
    for _ in range(FACTOR.bit_length() - 1):
        points, good = edges.middles(field, corners)
        lost.append(edges.cells[~good])
        edges, points = edges.only(good), points[good]
        numbers = torch.arange(len(edges), device=device) + len(corners)
        every, edge_of = edges_of(triangles, len(corners))
        new = torch.full_like(every[:, 0], -1)
        new[edges.among(every)] = numbers
        triangles = split_triangles(triangles, new[edge_of])
        corners, gradients = torch.cat([corners, points]), torch.cat([gradients, field.gradient(points)])
        edges = edges.halved(numbers)
    mesh = _Mesh(corners, gradients, torch.cat([triangles, faces[count:]]), edges + fine)
    return mesh, torch.cat(lost).cpu().numpy()


def _on_their_edges(field: Field, lower: Float[Tensor, "n 3"], upper: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Return the zero of f on each edge, or its end nearer to zero where rounding gives both ends one sign."""
    at_lower, at_upper = field.value(lower), field.value(upper)
    points = torch.where((at_lower.abs() < at_upper.abs())[:, None], lower, upper)
    crossed = (at_lower < 0) != (at_upper < 0)
    tolerance = field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)
    low, high, at_low, at_high = (x[crossed] for x in (lower, upper, at_lower, at_upper))
    points[crossed] = bracketed_zeros(field, low, high, at_low, at_high, tolerance).points
    return points


def _with_fine_vertices(field: Field, marched: PlacedOnGrid, pieces: Pieces, mesh: _Mesh) -> _Mesh:
    """Return the mesh with the vertices of refined cells that are at no seam on the surface too."""
    free = np.flatnonzero(~pieces.at_seam)
    free = free[free >= len(marched.placement.points)]
    points, lower, upper = (_places(marched, x[free]) for x in (pieces.places, pieces.lower, pieces.upper))
    along = torch.nn.functional.normalize(upper - lower, dim=1)
    sides = 1 - 2 * (field.value(lower) < 0).to(points)
    start = Crossings(points, lower, upper, -sides[:, None] * along, mesh.faces[:0], marched.signs)
    reach = 2 * marched.grid.cell / FACTOR
    found = on_their_side(field, start, place_on_surface(field, points, reach=reach, segments=(lower, upper)))
    corners, gradients = mesh.corners.clone(), mesh.gradients.clone()
    which = torch.from_numpy(free).to(points.device)
    corners[which] = torch.where((found.arrived | found.jumps)[:, None], found.points, points)
    gradients[which] = found.gradients
    return _Mesh(corners, gradients, mesh.faces, mesh.seams)


def _curved(field: Field, curved: CurvedMesh, pieces: Pieces, mesh: _Mesh) -> CurvedCells:
    """Return curved cells on the triangles, split along creases but not at seams."""
    corners, reach = mesh.corners, 2 * curved.marched.grid.cell
    edges, edge_of = edges_of(mesh.faces, len(corners))
    seams = mesh.seams.among(edges)
    in_face, _ = mesh.seams.middles(field, corners)
    # What the coarse mesh knows already is not looked for again: the middles between vertices that are where they were.
    moved = torch.ones(len(corners), dtype=torch.bool, device=corners.device)
    moved[: len(curved.marched.placement.points)] = False
    moved[: len(pieces.at_seam)] |= torch.from_numpy(pieces.at_seam).to(corners.device)
    known = ~moved[edges].any(dim=1)
    where = _among(edges[known], curved.edges)
    other = ~known
    other[seams] = False
    points, slopes = torch.empty_like(corners[edges[:, 0]]), torch.empty_like(corners[edges[:, 0]])
    points[known], slopes[known] = curved.middles[where], curved.slopes[where]
    points[other], slopes[other] = middle_nodes(field, corners, edges[other], reach, MOST_BULGE)
    points[seams] = in_face
    # A seam must stay whole on both sides: with a normal half way between those of its ends it crosses no crease.
    ends = mesh.gradients[edges[seams]]
    half_way = torch.nn.functional.normalize(torch.nn.functional.normalize(ends, dim=2).sum(dim=1), dim=1)
    slopes[seams] = half_way * ends.norm(dim=2).mean(dim=1, keepdim=True)

    def given(edges: Tensor, middles: Tensor) -> Tensor:
        return middles.index_copy(0, mesh.seams.among(edges), in_face)

    parts = (corners, mesh.faces, edges, edge_of)
    return with_creases(field, parts, points, (mesh.gradients, slopes), reach, given)


def _among(some: Int[Tensor, "s 2"], edges: Int[Tensor, "e 2"]) -> Int[Tensor, " s"]:
    """Return where some edges are in a list of all, which are in order."""
    most = int(edges.max()) + 1
    return torch.searchsorted(edges[:, 0] * most + edges[:, 1], some[:, 0] * most + some[:, 1])
