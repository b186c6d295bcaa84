"""Creases of a meshed surface, where the gradient of its field jumps: edges of the mesh that cross one are split there.

Marching cubes cuts creases off: a flat cell across one misses its area by a share that no resolution lessens, so that
the area of a box converges with the first order. Here each edge whose ends lie on different sides of a crease gets a
vertex where the two tangents meet (as in the extended marching cubes of Kobbelt et al. 2001), which is on the surface
where both sides are plane, and close to it elsewhere. What is left are the corners, a few cells.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from implicit.field.field import Field
from implicit.surface.projection import place_on_surface

# Least difference of the unit normals at the ends of an edge: 6 degrees.
SHARP = 0.1

# On a crease the middle has the normal of one end, up to this share of their difference; on a smooth surface half.
ONE_SIDED = 0.1

# Where the tangents meet must lie on the surface up to this share of its height over the edge, and this far from the
# ends, in lengths of the edge.
ON_SURFACE = 0.1
MARGIN = 0.02

# So near to the crease, in lengths of the edge, each side must have the normal of its end, up to this share of their
# difference.
BESIDE = 0.05
SAME_SIDE = 0.25


def split_at_creases(
    field: Field,
    corners: Float[Tensor, "v d"],
    cells: Int[Tensor, "m d"],
    edges: Int[Tensor, "e 2"],
    edge_of: Int[Tensor, "m s"],
    gradients: tuple[Float[Tensor, "v d"], Float[Tensor, "e d"]],
) -> tuple[Float[Tensor, "w d"], Int[Tensor, "k d"]]:
    """Return the mesh with a vertex on each edge that crosses a crease; as it came where none does.

    Args:
        field: The field.
        corners: Vertices on the surface.
        cells: Triangles, or in the plane segments.
        edges: The ends of each edge.
        edge_of: The edges of each cell: 01, 12, 20 of a triangle; the segment itself in the plane.
        gradients: df/dx at the vertices, and near the middle of each edge on the surface.
    """
    found, points = _crease_points(field, corners, edges, *gradients)
    if len(found) == 0:
        return corners, cells
    new = torch.full_like(edges[:, 0], -1)
    new[found] = torch.arange(len(found), device=new.device) + len(corners)
    split = _split_segments if field.dimension == 2 else split_triangles
    return torch.cat([corners, points]), split(cells, new[edge_of])


def _crease_points(
    field: Field,
    corners: Float[Tensor, "v d"],
    edges: Int[Tensor, "e 2"],
    at_corners: Float[Tensor, "v d"],
    at_middles: Float[Tensor, "e d"],
) -> tuple[Int[Tensor, " c"], Float[Tensor, "c d"]]:
    """Return which edges cross a crease, and where."""
    normals = torch.nn.functional.normalize(at_corners, dim=1)
    middles = torch.nn.functional.normalize(at_middles, dim=1)
    first, second = normals[edges[:, 0]], normals[edges[:, 1]]
    turn = (first - second).norm(dim=1)
    to_nearer = torch.minimum((middles - first).norm(dim=1), (middles - second).norm(dim=1))
    found = ((turn > SHARP) & (to_nearer < ONE_SIDED * turn)).nonzero()[:, 0]
    if len(found) == 0:
        return found, corners[:0]
    start, chord = corners[edges[found, 0]], (corners[edges[found, 1]] - corners[edges[found, 0]])
    length = chord.norm(dim=1)
    along, upright, share, height = _apex(chord, length, first[found], second[found])
    points = start + (share * length)[:, None] * along + height[:, None] * upright
    slope = at_corners[edges[found]].norm(dim=2).amin(dim=1)
    likely = torch.isfinite(points).all(dim=1) & (share > MARGIN) & (share < 1 - MARGIN) & (height.abs() < length)
    # Where the surface merely begins to bend, the tangents meet off it.
    likely[likely.clone()] = field.value(points[likely]).abs() <= (ON_SURFACE * height.abs() * slope)[likely]
    # And where it bends within a part of the edge, the normals beside that place are not those of the ends.
    for end, side in ((first, -BESIDE), (second, BESIDE)):
        beside = field.gradient((points + side * chord)[likely])
        off = (torch.nn.functional.normalize(beside, dim=1) - end[found][likely]).norm(dim=1)
        likely[likely.clone()] = off <= SAME_SIDE * turn[found][likely]
    found, points, height = found[likely], points[likely], height.abs()[likely]
    if len(found) == 0:
        return found, points
    placed = place_on_surface(field, points, reach=float(height.max()))
    good = placed.arrived & ((placed.points - points).norm(dim=1) <= 2 * ON_SURFACE * height)
    return found[good], placed.points[good]


def _apex(
    chord: Float[Tensor, "c d"], length: Float[Tensor, " c"], first: Float[Tensor, "c d"], second: Float[Tensor, "c d"]
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return where the tangents at the ends of an edge meet, in the plane of the edge and the mean of the normals.

    Returns:
        The two unit vectors of the plane, along the edge and upright; the share of the edge, and the height over it.
    """
    along = chord / length[:, None]
    mean = first + second
    upright = torch.nn.functional.normalize(mean - (mean * along).sum(dim=1, keepdim=True) * along, dim=1)
    au, aw, bu, bw = ((n * axis).sum(dim=1) for n in (first, second) for axis in (along, upright))
    # n_a . (s u + h w) = 0 and n_b . ((s - length) u + h w) = 0.
    det = au * bw - bu * aw
    return along, upright, -aw * bu / det, au * bu * length / det


def _split_segments(cells: Int[Tensor, "m 2"], new: Int[Tensor, "m 1"]) -> Int[Tensor, "k 2"]:
    crossed = new[:, 0] >= 0
    a, b, p = cells[crossed, 0], cells[crossed, 1], new[crossed, 0]
    return torch.cat([cells[~crossed], torch.stack([a, p], dim=1), torch.stack([p, b], dim=1)])


def split_triangles(cells: Int[Tensor, "m 3"], new: Int[Tensor, "m 3"]) -> Int[Tensor, "k 3"]:
    """Cut each triangle along the lines between its new vertices, on the edges 01, 12, 20, where there are any."""
    crossed = new >= 0
    count = crossed.sum(dim=1)
    parts = [cells[count == 0]]
    for turn in range(3):
        a, b, c = cells.roll(-turn, dims=1).T
        p, q, r = new.roll(-turn, dims=1).T
        on_p, on_q, on_r = crossed.roll(-turn, dims=1).T
        one = on_p & (count == 1)
        two = on_p & on_r & ~on_q
        parts += [torch.stack(corners, dim=1)[one] for corners in ((a, p, c), (p, b, c))]
        parts += [torch.stack(corners, dim=1)[two] for corners in ((a, p, r), (p, b, c), (p, c, r))]
    (a, b, c), (p, q, r) = cells.T, new.T
    parts += [torch.stack(corners, dim=1)[count == 3] for corners in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]
    return torch.cat(parts)


def edges_of(cells: Int[Tensor, "m d"], vertices: int) -> tuple[Int[Tensor, "e 2"], Int[Tensor, "m s"]]:
    """Return the ends of each edge, the smaller first, and the edges of each cell: 01, 12, 20, or the segment."""
    if cells.shape[1] == 2:
        return cells, torch.arange(len(cells), device=cells.device)[:, None]
    ends = cells, cells.roll(-1, dims=1)
    unique, inverse = torch.unique(torch.minimum(*ends) * vertices + torch.maximum(*ends), return_inverse=True)
    return torch.stack([unique // vertices, unique % vertices], dim=1), inverse.view(-1, 3)
