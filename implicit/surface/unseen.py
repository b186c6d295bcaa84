"""Parts of a surface that a marched mesh does not have: they run through cells whose corners all have one sign.

A fin thinner than a cell, a gap between two sheets, the tip of a spike pass between the nodes of a grid. No comparison
of two such meshes need show them, for both may miss them. But f is small beside them: Newton's step from the middle of
a cell that no corner says is crossed leads to a surface within it, far from all that was meshed. Where that is so,
points strewn over the cell tell how much of it lies on the other side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.field.field import Field
from implicit.surface.projection import in_working_precision, newton_to_surface
from implicit.surface.quadrature import Entered, MeshedSample

# A point of the surface is missed where no point of the quadrature is so near, in cells; those of one cell lie closer.
MISSED = 0.5

# Points strewn along each side of a cell, and the most cells that they are strewn over; these stand for the rest.
STREWN = 4
MOST_CELLS = 3000

# Cells looked at in one go: of a field that is saturated all cells of the grid have a sign.
AT_ONCE = 200_000

# What is too thin for the points to hit fills less than this share of its cell.
LEAST_SHARE = 1 / 16


@dataclass(frozen=True, eq=False)
class Unseen:
    """Parts of a surface in cells of a grid whose corners do not show it, measured roughly.

    Attributes:
        points: A point of the surface in each such cell (N, D).
        volumes: About how much of each cell is on the other side (N,); an area in the plane.
        areas: About how much surface it holds (N,); a length in the plane.
    """

    points: Float[Tensor, "n d"]
    volumes: Float[Tensor, " n"]
    areas: Float[Tensor, " n"]

    def __len__(self) -> int:
        return len(self.points)


def unseen_parts(field: Field, meshed: MeshedSample) -> Unseen:
    """Return the parts of a field's surface that a mesh of it has not.

    What has both its ends closer than half a cell to the mesh is taken for a part of that.

    Args:
        field: The field.
        meshed: Its quadrature, with the grid.
    """
    working = in_working_precision(field)
    index, points = entered_cells(working, meshed) if meshed.entered is None else meshed.entered
    if len(points):
        _, near = nearest_of_sample(meshed, index, points)
        points, index = points[~near], index[~near]
    if len(points) == 0:
        none = points.new_zeros(0)
        return Unseen(points, none, none)
    every = -(-len(points) // MOST_CELLS)
    index, some = index[::every], points[::every]
    share = len(points) / len(some)
    volumes, areas = _strewn(working, meshed, index)
    return Unseen(some, share * volumes, share * areas)


def nearest_of_sample(
    meshed: MeshedSample, index: Int[Tensor, "n d"], points: Float[Tensor, "n d"]
) -> tuple[Int[Tensor, " n"], Bool[Tensor, " n"]]:
    """Return the nearest point of a quadrature to each of some points, and True where it is nearer than MISSED.

    Args:
        meshed: The quadrature.
        index: Cells of its grid that hold the points.
        points: The points (N, D).
    """
    grid, device = meshed.grid, points.device
    # What is nearer than half a cell is in a cell beside: a tree of a small part of the quadrature tells it.
    steps = torch.cartesian_prod(*[torch.arange(-1, 2, device=device)] * index.shape[1])
    beside = (index[:, None] + steps).flatten(0, 1).clamp(min=0)
    about = torch.unique(grid.number(beside.minimum(torch.tensor(grid.cells, device=device) - 1)))
    numbers = grid.number(grid.cells_of(meshed.sample.points.to(grid.lower)))
    place = torch.searchsorted(about, numbers).clamp(max=len(about) - 1)
    some = (about[place] == numbers).nonzero()[:, 0]
    if len(some) == 0:
        return torch.zeros_like(index[:, 0]), torch.zeros(len(index), dtype=torch.bool, device=device)
    tree = cKDTree(meshed.sample.points[some].double().cpu().numpy())
    distance, which = tree.query(points.double().cpu().numpy())
    return some[torch.from_numpy(which).to(device)], torch.from_numpy(distance <= MISSED * grid.cell).to(device)


def entered_cells(field: Field, meshed: MeshedSample) -> Entered:
    """Return the cells whose corners have one sign but that hold a surface, and a point of it in each.

    Args:
        field: The field, in single precision or double.
        meshed: Its quadrature, with the grid.
    """
    cell = meshed.grid.cell
    index, points = _entered(field, meshed)
    if len(points):
        points, arrived = newton_to_surface(field, points, reach=cell)
        lower = meshed.grid.lower.to(points) + cell * index.to(points)
        within = ((points >= lower - 1e-6 * cell) & (points <= lower + (1 + 1e-6) * cell)).all(dim=1)
        points, index = points[arrived & within], index[arrived & within]
    return index, points


def _entered(field: Field, meshed: MeshedSample) -> tuple[Int[Tensor, "n d"], Float[Tensor, "n d"]]:
    """Return the cells of one sign that hold a surface by a step of Newton's from their middle, and where it ends."""
    grid, signs = meshed.grid, meshed.signs.sign()
    dimension = signs.ndim
    total = torch.zeros([n - 1 for n in signs.shape], dtype=torch.int8, device=signs.device)
    for corner in product((0, 1), repeat=dimension):
        total += signs[tuple(slice(c, c + n) for c, n in zip(corner, total.shape))]
    found = []
    for index in (total.abs() == 2**dimension).nonzero().split(AT_ONCE):
        middles = (grid.lower + grid.cell * (index.to(grid.lower) + 0.5)).to(field.dtype)
        f, g = field.value_and_gradient(middles)
        square = (g * g).sum(dim=1)
        step = -(f / square.clamp(min=torch.finfo(f.dtype).tiny))[:, None] * g
        enters = (step.abs() <= grid.cell / 2).all(dim=1) & (square > 0)  # saturated, f leads nowhere
        found.append((index[enters], (middles + step)[enters]))
    return torch.cat([index for index, _ in found]), torch.cat([points for _, points in found])


def _strewn(field: Field, meshed: MeshedSample, index: Int[Tensor, "n d"]) -> tuple[Tensor, Tensor]:
    """Return how much of each cell is on the other side of its corners, and how much surface is in it, about."""
    grid = meshed.grid
    dimension = index.shape[1]
    lattice = torch.cartesian_prod(*[torch.arange(STREWN)] * dimension).view(-1, dimension)
    jitter = torch.rand(len(index), *lattice.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    inner = ((lattice + jitter) / STREWN).to(grid.lower)
    points = (grid.lower + grid.cell * (index[:, None].to(grid.lower) + inner)).to(field.dtype)
    inside = (field.value(points.flatten(0, 1)) < 0).view(len(index), *[STREWN] * dimension)
    outside = meshed.signs[tuple(index.T)] > 0
    other = inside == outside.view(-1, *[1] * dimension)
    shares = other.flatten(1).to(grid.lower).mean(dim=1).clamp(min=LEAST_SHARE)
    faces = sum(other.diff(dim=k + 1).flatten(1).sum(dim=1) for k in range(dimension))
    # What passes through the whole of a cell has one cell of surface to each side of it.
    areas = (faces / STREWN ** (dimension - 1)).clamp(min=2.0).to(grid.lower)
    return (shares * grid.cell**dimension).to(field.dtype), (areas * grid.cell ** (dimension - 1)).to(field.dtype)
