"""Marching over a grid of which only what is near the surface is ever evaluated or visited.

The grid is cut into chunks of 32 cells, these into blocks of 8, of 4 and of 2. A block is left
out where |f| at its middle exceeds its half diagonal times a bound on |df/dx|: the largest gradient seen near by on a
coarse grid, with a safety factor. What is left out has the sign of its middle. Of the nodes of the last blocks, those
that no middle speaks for are evaluated, each once, so that neighbouring chunks agree on them to the bit and their
triangles fit. Where the field shows on the coarse grid that no such bound holds, for it is saturated (an occupancy, a
narrow truncation) or jumps, every node is evaluated.

Single precision is all that marching cubes work in; the vertices find the surface afterwards in the field's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Int8
from numpy.typing import NDArray
from skimage.measure import find_contours, marching_cubes
from torch import Tensor

from implicit.field.field import Field, SurfaceError

# Cells along a block of each level; the first is a chunk, marched as a whole.
LEVELS = (32, 8, 4, 2)
CHUNK_CELLS = LEVELS[0]

# The factor by which the largest gradient seen near by is raised to bound those in between.
GRADIENT_SAFETY = 1.5

# Bytes for the grid of an extraction unless the caller says otherwise: a resolution of about 890 in a cube.
MEMORY_LIMIT = 4 * 2**30
MOST_AT_ONCE = 1_000_000  # nodes

# Grids of so few nodes are evaluated whole: the gradients that bound f elsewhere would cost more.
FEW_NODES = 40_000
BYTES_A_NODE = 6  # value, sign, and what blocks of two cells have for their eight nodes


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes lower + cell * index, index from 0 to cells, along each axis; cubes of one size that cover the bounds."""

    lower: Float[Tensor, " d"]
    cell: float
    cells: tuple[int, ...]

    @classmethod
    def over(cls, field: Field, resolution: int) -> Grid:
        """Return a grid of so many cells along the longest side of the bounds, centred on them."""
        cell = field.size / resolution
        lower, upper = field.bounds
        cells = [int(np.ceil(side / cell - 1e-9)) for side in (upper - lower).tolist()]
        return cls((lower + upper) / 2 - cell * torch.tensor(cells).to(lower) / 2, cell, tuple(cells))

    @property
    def nodes(self) -> tuple[int, ...]:
        return tuple(count + 1 for count in self.cells)

    def place(self, index: Tensor) -> Tensor:
        """Return the places of nodes, or of points between them, from their index."""
        return self.lower + self.cell * index.to(self.lower)

    def cells_of(self, points: Float[Tensor, "n d"]) -> Int[Tensor, "n d"]:
        """Return the cell that holds each point; beyond the grid, the last one on the way."""
        index = ((points - self.lower) / self.cell).floor().long()
        return index.clamp(min=0).minimum(torch.tensor(self.cells, device=points.device) - 1)

    def number(self, cells: Int[Tensor, "n d"]) -> Int[Tensor, " n"]:
        """Return the number of each cell, the first index slowest."""
        numbers = cells[:, 0]
        for axis, count in enumerate(self.cells[1:], start=1):
            numbers = numbers * count + cells[:, axis]
        return numbers

    def require_memory(self, limit: float) -> None:
        needed = BYTES_A_NODE * float(np.prod(self.nodes, dtype=float))
        if needed > limit:
            raise MemoryError(
                f"A grid of {' x '.join(map(str, self.nodes))} nodes needs about {needed / 2**30:.1f} GiB, more than "
                f"the limit of {limit / 2**30:.1f} GiB. Lower the resolution, or raise memory_limit."
            )


@dataclass(frozen=True, eq=False)
class Crossings:
    """The edges of a grid that cross f = 0.

    Attributes:
        points: About where, by linear interpolation, (N, D).
        lower: The end of the edge with the smaller coordinate; the point itself for the few inside a cell, (N, D).
        upper: Its other end.
        outward: Unit vector along the edge from its end with f < 0 to the other; zero of the few inside a cell (N, D).
        faces: Triangles (M, 3) or segments (M, 2) that join the points.
        signs: At each node of the grid the sign of f, zero where the surface is far; its size says no more.
        steepest: Bound on |df/dx| that was found for the march; None where all nodes were evaluated.
    """

    points: Float[Tensor, "n d"]
    lower: Float[Tensor, "n d"]
    upper: Float[Tensor, "n d"]
    outward: Float[Tensor, "n d"]
    faces: Int[Tensor, "m d"]
    signs: Int8[Tensor, "*nodes"]
    steepest: Steepest | None = None

    def only(self, which: Bool[Tensor, " n"]) -> Crossings:
        """Return some of the crossings, joined by nothing."""
        points, lower, upper, outward = (x[which] for x in (self.points, self.lower, self.upper, self.outward))
        return Crossings(points, lower, upper, outward, self.faces[:0], self.signs)


# Of each vertex the lower end of its edge of the grid (N, D), and which axes that runs along: all for one in a cell.
Edges = tuple[NDArray[np.int64], NDArray[np.bool_]]


def march(field: Field, grid: Grid) -> Crossings:
    """Return where the edges of the grid cross f = 0, and what joins them.

    Raises:
        SurfaceError: There is no zero set in the bounds, it leaves them, or the field is not finite.
    """
    # One dtype for all: what is rounded differently for two neighbours could give a node two signs.
    single = field.to(torch.float32)
    steepest = None
    if field.dimension == 2:
        index, (corner, along), faces, signs = _march_squares(single, grid)
    else:
        chunks = near_surface(single, grid, None if _has_few_nodes(grid) else steepest_of(field))
        index, (corner, along), faces = _march_chunks(single, grid, chunks)
        signs, steepest = chunks.signs, chunks.steepest
    inside = along.sum(axis=1, keepdims=True) > 1
    ends = (np.where(inside, index, end) for end in (corner, corner + along))
    place, lower, upper = (grid.lower + torch.from_numpy(x).to(grid.lower) * grid.cell for x in (index, *ends))
    sides = signs[tuple(torch.from_numpy(corner.T).to(signs.device))].sign().to(grid.lower)
    outward = torch.from_numpy(along & ~inside).to(grid.lower) * -sides[:, None]
    return Crossings(place, lower, upper, outward, torch.from_numpy(faces).to(field.device), signs, steepest)


# In space: chunk by chunk


@dataclass(frozen=True, eq=False)
class Chunks:
    """The chunks that the surface may run through, and the nodes near it."""

    index: Int[Tensor, "c 3"]
    blocks: Float[Tensor, "c 16 16 16"]  # in each chunk, f at the middle of the last block that holds the node
    values: Float[Tensor, "x y z"]  # of the whole grid, filled where near
    signs: Int8[Tensor, "x y z"]  # zero where not near
    steepest: Steepest | None = None

    def __iter__(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
        """First node and values of each chunk."""
        values, signs = self.values.cpu().numpy(), self.signs.cpu().numpy()
        for start, blocks in zip((self.index * CHUNK_CELLS).cpu().numpy(), self.blocks.cpu().numpy()):
            where = tuple(slice(first, first + CHUNK_CELLS + 1) for first in start)
            chunk = _spread(blocks, signs[where].shape)
            np.copyto(chunk, values[where], where=signs[where] != 0)
            yield start, chunk


def _spread(blocks: NDArray[np.float32], nodes: tuple[int, ...]) -> NDArray[np.float32]:
    """Return for each node of a chunk the value of the block after it; the last of the grid has the one before it."""
    side = LEVELS[-1]
    chunk = np.empty((CHUNK_CELLS + side,) * 3, dtype=np.float32)
    room = chunk.reshape([part for n in blocks.shape for part in (n + 1, side)])
    room[:-1, :, :-1, :, :-1, :] = blocks[:, None, :, None, :, None]
    x, y, z = (n - 1 for n in nodes)
    chunk[x] = chunk[x - 1]
    chunk[:, y] = chunk[:, y - 1]
    chunk[:, :, z] = chunk[:, :, z - 1]
    return chunk[: x + 1, : y + 1, : z + 1]


def _march_chunks(field: Field, grid: Grid, chunks: Chunks) -> tuple[NDArray[np.float64], Edges, NDArray[np.int64]]:
    """Vertices in units of the grid with their edges, and triangles with outward normals."""
    places, triangles = [], []
    count = 0
    for start, values in chunks:
        if values.min() >= 0 or values.max() < 0:
            continue
        # Default winding ("descent") faces outward for f < 0 inside; its normals do not, so they are not used.
        vertices, faces, _, _ = marching_cubes(values, 0.0)
        places.append(vertices + start.astype(np.float64))
        triangles.append(faces.astype(np.int64) + count)
        count += len(vertices)
    if not places:
        raise _no_surface(field, positive=bool(field.value(field.bounds.mean(dim=0, keepdim=True)) > 0))
    place = np.concatenate(places)
    corner, along = edges_of_places(place)
    # A vertex between two chunks is found by both; they agree on its edge.
    _, first, merged = np.unique(_edge_keys(corner, along, grid.nodes), return_index=True, return_inverse=True)
    return place[first], (corner[first], along[first]), merged[np.concatenate(triangles)]


def _edge_keys(corner: NDArray[np.int64], along: NDArray[np.bool_], nodes: tuple[int, ...]) -> NDArray[np.int64]:
    """A number for the edge of the grid that each vertex lies on, or for the cell where it lies inside one."""
    x, y, z = corner.T
    by_x, by_y, _ = along.T
    axis = np.where(by_x, np.where(by_y, 3, 0), np.where(by_y, 1, 2))  # along all axes where it lies inside
    return 4 * ((x * nodes[1] + y) * nodes[2] + z) + axis


def edges_of_places(place: NDArray[np.float64]) -> Edges:
    """Return the lower end of the edge that each vertex lies on, and which axis it runs along.

    Some cases of marching cubes put a vertex inside their cell: of those the lower corner of the cell, and all axes.
    """
    # A coordinate at a time: to sort three neighbours in memory takes ten times as long.
    columns = np.ascontiguousarray(place.T)
    nearest = np.rint(columns)
    off = np.abs(columns - nearest)
    most, second = off[0], np.zeros_like(off[0])
    for other in off[1:]:
        most, second = np.maximum(most, other), np.maximum(second, np.minimum(most, other))
    inside = second > NUDGE / 8  # the ends of an edge are NUDGE / 2 away or more
    along = off == most
    for axis in range(1, len(along)):  # the first where several are as far
        along[axis] &= ~along[:axis].any(axis=0)
    along |= inside
    return np.where(along, np.floor(columns), nearest).astype(np.int64).T, along.T


# Values nearer to zero than this, in units of the change of f over a cell, are moved away from it, so that no vertex
# comes to lie in a node, where it would belong to several edges. Newton's method takes the vertices to the surface.
NUDGE = 4e-3


def near_surface(field: Field, grid: Grid, steepest: Steepest | None = None) -> Chunks:
    """Evaluate f from coarse to fine, only where the surface can be (3D).

    Args:
        field: The field, in single precision.
        grid: The grid.
        steepest: Bound on |df/dx|, where it is known.
    """
    if _has_few_nodes(grid):
        return _every_node(field, grid)
    steepest = Steepest(field) if steepest is None else steepest
    if not steepest.holds:
        return _every_node(field, grid)
    cells = torch.tensor(grid.cells, device=field.device)
    counts = [-(-count // CHUNK_CELLS) for count in grid.cells]
    blocks = _Blocks.evaluate(
        field,
        grid,
        torch.cartesian_prod(*[torch.arange(count, device=field.device) for count in counts]),
        CHUNK_CELLS,
        steepest,
    )
    chunks = blocks.index[blocks.near]
    owner = torch.arange(len(chunks), device=field.device)  # the chunk of each block
    middles = blocks.values[blocks.near][:, None, None, None]
    index = chunks
    for coarse, fine in pairwise(LEVELS):
        ratio = coarse // fine
        offsets = torch.cartesian_prod(*[torch.arange(ratio, device=field.device)] * 3)
        index = (index[:, None] * ratio + offsets).view(-1, 3)
        owner = owner.repeat_interleave(ratio**3)
        within = (index * fine < cells).all(dim=1)  # the last chunks may stand out over the grid
        index, owner = index[within], owner[within]
        blocks = _Blocks.evaluate(field, grid, index, fine, steepest)
        for axis in (1, 2, 3):
            middles = middles.repeat_interleave(ratio, dim=axis)
        middles = middles.contiguous()
        middles[(owner, *(index % (CHUNK_CELLS // fine)).T)] = blocks.values
        index, owner = index[blocks.near], owner[blocks.near]
    signs = middles.flatten(1) < 0
    crossed = signs.any(dim=1) & ~signs.all(dim=1)
    crossed[owner] = True
    return Chunks(chunks[crossed], middles[crossed], *_node_values(field, grid, blocks, steepest), steepest)


def _has_few_nodes(grid: Grid) -> bool:
    return bool(np.prod(grid.nodes, dtype=float) <= FEW_NODES)


def _every_node(field: Field, grid: Grid) -> Chunks:
    """Evaluate f at all nodes, some planes of the grid at a time."""
    values = torch.empty(grid.nodes, dtype=torch.float32, device=field.device)
    planes = max(1, MOST_AT_ONCE // (grid.nodes[1] * grid.nodes[2]))
    axes = [torch.arange(count, device=field.device) for count in grid.nodes]
    for part in axes[0].split(planes):
        points = grid.place(torch.cartesian_prod(part, *axes[1:])).float()
        values[part] = _finite(field.value(points)).view(len(part), *grid.nodes[1:])
    _nudge_by_differences(values)
    signs = 2 - 4 * (values < 0).to(torch.int8)
    for axis, count in enumerate(grid.nodes):
        for end in (0, count - 1):
            if bool((out := signs.select(axis, end) < 0).any()):
                index = out.nonzero()[0].tolist()
                index.insert(axis, end)
                raise _leaves(field, grid.place(torch.tensor(index, device=field.device)))
    counts = [torch.arange(-(-count // CHUNK_CELLS), device=field.device) for count in grid.cells]
    chunks = torch.cartesian_prod(*counts)
    side = CHUNK_CELLS // LEVELS[-1]
    return Chunks(chunks, values.new_zeros(1).expand(len(chunks), side, side, side), values, signs)


def _nudge_by_differences(values: Float[Tensor, "x y z"]) -> None:
    """Move values at all nodes away from zero where they are nearer to it than NUDGE, in place."""
    change = torch.zeros_like(values)  # the most between a node and the next ones
    for axis, count in enumerate(values.shape):
        steps = values.diff(dim=axis).abs_()
        for first in (0, 1):
            beside = change.narrow(axis, first, count - 1)
            torch.maximum(beside, steps, out=beside)
    near = (values.abs() <= NUDGE * change.max()).nonzero(as_tuple=True)
    found = values[near]
    # On level ground beside steep one a thousandth of the steepest is enough to tell a place from the nodes.
    least = NUDGE * change[near].clamp(min=1e-3 * float(change.max()))
    values[near] = (1 - 2 * (found < 0).to(torch.int8)) * found.abs().maximum(least)


def _nudged(field: Field, grid: Grid, points: Float[Tensor, "n 3"], steepest: Steepest) -> Float[Tensor, " n"]:
    """Return f at nodes of the grid, moved away from zero where it is nearer to it than NUDGE."""
    found = _finite(field.value(points))
    least = NUDGE * grid.cell / GRADIENT_SAFETY * steepest.at(points)
    return (1 - 2 * (found < 0).to(torch.int8)) * found.abs().maximum(least)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Blocks of so many cells a side, with f at their middles."""

    index: Int[Tensor, "n 3"]  # in units of the side
    side: int
    values: Float[Tensor, " n"]
    clear: Float[Tensor, " n"]  # about the middle the surface comes no nearer than this, a length
    near: Bool[Tensor, " n"]  # true where the surface may run through the block

    @classmethod
    def evaluate(cls, field: Field, grid: Grid, index: Int[Tensor, "n 3"], side: int, steepest: Steepest) -> _Blocks:
        first = index * side
        cells = torch.tensor(grid.cells, device=index.device)
        last = torch.minimum(first + side, cells)
        middle = grid.place((first + last) / 2).float()
        values = _finite(field.value(middle))
        bound = steepest.at(middle, reach=side * grid.cell / 2)
        clear = values.abs() / bound.clamp(min=torch.finfo(bound.dtype).tiny)
        near = clear <= 0.5 * grid.cell * (last - first).float().norm(dim=1)
        at_border = ((first == 0) | (last == cells)).any(dim=1)
        if bool((out := ~near & at_border & (values < 0)).any()):
            raise _leaves(field, middle[out][0])
        # At the border every node is looked at, for the surface must not leave there.
        return cls(index, side, values, torch.where(near & at_border, 0.0, clear), near)


# Of a node near the surface that nothing has been told of yet.
UNTOLD = 3


def _node_values(
    field: Field, grid: Grid, blocks: _Blocks, steepest: Steepest
) -> tuple[Float[Tensor, "x y z"], Int8[Tensor, "x y z"]]:
    """f at the nodes of the blocks that are near, and its sign there, which elsewhere is zero.

    A node in the clear about the middle of a block has the sign of that middle, whose value stands for its own unless
    the surface runs through one of its edges. This spares half of the evaluations.
    """
    nodes = [2 * -(-count // 2) + 1 for count in grid.cells]  # to the end of the last block
    strides = [nodes[1] * nodes[2], nodes[2], 1]
    count = nodes[0] * strides[0]
    values = torch.empty(count, dtype=torch.float32, device=field.device)
    signs = torch.zeros(count, dtype=torch.int8, device=field.device)  # twice the sign where the value is its own
    top = torch.tensor(grid.cells, device=field.device)

    def index_of(flat: Int[Tensor, " n"]) -> Int[Tensor, "n 3"]:
        return torch.stack([flat // strides[0], flat // strides[1] % nodes[1], flat % nodes[2]], dim=1)

    def evaluate(flat: Int[Tensor, " n"]) -> None:
        index = index_of(flat)
        points = grid.place(index).float()
        found = _nudged(field, grid, points, steepest)
        if bool((out := ((index == 0) | (index == top)).any(dim=1) & (found < 0)).any()):
            raise _leaves(field, points[out][0])
        values.scatter_(0, flat, found)
        signs.scatter_(0, flat, 2 - 4 * (found < 0).to(torch.int8))

    flat = _told_by_blocks(blocks, grid, strides, values, signs)
    if any(count % 2 for count in grid.cells):
        beyond = (index_of(flat) > top).any(dim=1)
        signs[flat[beyond]] = 0
        flat = flat[~beyond]
    evaluate(flat.masked_select(signs.index_select(0, flat) == UNTOLD))
    mistaken = True
    while mistaken:
        sign, ends = signs.index_select(0, flat), []
        for stride in strides:
            beside = (flat + stride).clamp(max=count - 1)
            other = signs.index_select(0, beside)
            crossed = (sign * other < 0).nonzero()[:, 0]
            for side, nodes_of_side in ((sign, flat), (other, beside)):
                ends.append(nodes_of_side[crossed].masked_select(side[crossed].abs() == 1))
        told = torch.unique(torch.cat(ends))
        before = signs[told]
        evaluate(told)
        # A middle that spoke wrongly for a node may have done so for those beside it.
        mistaken = bool((signs[told] * before < 0).any())
    where = tuple(slice(count) for count in grid.nodes)
    return values.view(nodes)[where], signs.view(nodes)[where]


def _told_by_blocks(
    blocks: _Blocks, grid: Grid, strides: list[int], values: Float[Tensor, " n"], signs: Int8[Tensor, " n"]
) -> Int[Tensor, " k"]:
    """Set the signs of the nodes of near blocks, with values for now, that middles of blocks tell; the others UNTOLD.

    Args:
        blocks: Of two cells.
        grid: The grid.
        strides: From node to node along each axis in the arrays of values and signs.
        values, signs: To be set.

    Returns:
        The nodes of the blocks that are near, each once.
    """
    first = (2 * blocks.index * torch.tensor(strides, device=signs.device)).sum(dim=1)
    steps = [(int(np.dot(way, strides)), way) for way in product(range(3), repeat=3)]
    nodes, near = [], first[blocks.near]
    # Gathered and scattered by name: indexing by tensors takes five times as long.
    for step, _ in steps:
        some = near + step
        some = some.masked_select(signs.index_select(0, some) == 0)
        signs.scatter_(0, some, UNTOLD)
        nodes.append(some)
    sides = 1 - 2 * (blocks.values < 0).to(torch.int8)
    for step, way in steps:
        # From the middle to a node is one cell along each axis on which it is not the middle one.
        room = grid.cell * sum(k != 1 for k in way) ** 0.5
        speaking = (blocks.clear > room).nonzero()[:, 0]
        some = first.index_select(0, speaking) + step
        untold = (signs.index_select(0, some) == UNTOLD).nonzero()[:, 0]
        some, speaking = some.index_select(0, untold), speaking.index_select(0, untold)
        signs.scatter_(0, some, sides.index_select(0, speaking))
        values.scatter_(0, some, blocks.values.index_select(0, speaking))
    return torch.cat(nodes)


def node_values(
    field: Field, grid: Grid, steepest: Steepest | None = None
) -> Callable[[NDArray[np.int64]], NDArray[np.float32]]:
    """Return a function that gives f at nodes of a grid from their index, moved away from zero as in a march.

    Args:
        field: The field, in single precision.
        grid: The grid.
        steepest: Bound on |df/dx| from a march, where there is one.
    """
    bound = Steepest(field) if steepest is None else steepest

    def values(index: NDArray[np.int64]) -> NDArray[np.float32]:
        points = grid.place(torch.from_numpy(index).to(field.device)).to(field.dtype)
        return _nudged(field, grid, points, bound).cpu().numpy()

    return values


class Steepest:
    """A bound on |df/dx| near a point: the largest at the nodes of a coarse grid about it, with the safety factor.

    Over a block the bound is that of all nodes in it and of the next ones: a truncated distance is level at the middle
    of a large block, and steep where the surface runs through its rim.

    Attributes:
        holds: False where the coarse grid itself shows that the slopes seen at its nodes bound nothing: f changes more
            between two of them than the bound allows, or is so far from zero for its slope that it must be saturated.
    """

    nodes = 24
    saturated = 4.0  # times the field's size; a distance over its slope is the size at most

    def __init__(self, field: Field) -> None:
        lines = [torch.linspace(float(a), float(b), self.nodes, device=field.device) for a, b in field.bounds.T]
        nodes = torch.cartesian_prod(*lines)
        values, gradients = field.value_and_gradient(nodes)
        lengths = _finite(gradients).norm(dim=1).view(1, 1, *[self.nodes] * 3)
        self._lengths = GRADIENT_SAFETY * lengths
        self._bounds: dict[int, Tensor] = {}
        self._lower = field.bounds[0]
        self._step = (field.bounds[1] - field.bounds[0]) / (self.nodes - 1)
        self._strides = torch.tensor([self.nodes**2, self.nodes, 1], device=field.device)
        self.holds = self._is_bound(_finite(values), self.at(nodes), field.size)

    def _is_bound(self, values: Float[Tensor, " n"], bound: Float[Tensor, " n"], size: float) -> bool:
        if bool((values.abs() > self.saturated * size * bound).any()):
            return False
        values, bound = values.view([self.nodes] * 3), bound.view([self.nodes] * 3)
        for axis in range(3):
            before, after = (bound.narrow(axis, first, self.nodes - 1) for first in (0, 1))
            if bool((values.diff(dim=axis).abs() > self._step[axis] * torch.maximum(before, after)).any()):
                return False
        return True

    def at(self, points: Float[Tensor, "n 3"], reach: float = 0.0) -> Float[Tensor, " n"]:
        """The bound in the cube that reaches so far from each point along each axis, a length."""
        # The nearest node is half a step away at most; the cube ends so far beyond it, in the cell up to the next node.
        around = min(self.nodes - 1, 1 + int(reach / float(self._step.min()) + 0.5 + 1e-6))
        if around not in self._bounds:
            pooled = self._lengths
            for axis in range(3):  # one after the other, for a cube of many nodes has few along each axis
                margin = [around if k == axis else 0 for k in range(3)]
                pooled = torch.nn.functional.max_pool3d(pooled, [2 * m + 1 for m in margin], stride=1, padding=margin)
            self._bounds[around] = pooled.view(-1)
        index = ((points - self._lower) / self._step).round().long().clamp(0, self.nodes - 1)
        return self._bounds[around].index_select(0, (index * self._strides).sum(dim=1))


def steepest_of(field: Field) -> Steepest:
    """Return the bound of a field in single precision, found once for its present parameters."""
    if field.theta.is_inference():  # such tensors do not say whether they were written to
        return Steepest(field.to(torch.float32))
    version = field.theta._version
    theta, before, bound = field.findings.get("steepest", (None, 0, None))
    # A function that is no module may have changed since, whatever theta.
    if bound is None or theta is not field.theta or before != version or field._evaluator.module is None:
        bound = Steepest(field.to(torch.float32))
        field.findings["steepest"] = field.theta, version, bound
    assert isinstance(bound, Steepest)
    return bound


# In the plane: all at once


def _march_squares(field: Field, grid: Grid) -> tuple[NDArray[np.float64], Edges, NDArray[np.int64], Tensor]:
    """Vertices in units of the grid with their edges, segments with the inside on their left, and the nodes' signs."""
    index = torch.cartesian_prod(*[torch.arange(count, device=field.device) for count in grid.nodes])
    values = _finite(field.value(grid.place(index).float()))
    inside = values < 0
    if not bool(inside.any()) or bool(inside.all()):
        raise _no_surface(field, positive=not bool(inside.any()))
    at_border = ((index == 0) | (index == torch.tensor(grid.cells, device=field.device))).any(dim=1)
    if bool((out := inside & at_border).any()):
        raise _leaves(field, grid.place(index[out][0]))
    points: list[NDArray[np.float64]] = []
    segments: list[NDArray[np.int64]] = []
    start = 0
    # find_contours walks with low values on the left; the contour closes, so its last point repeats the first.
    for contour in find_contours(values.view(grid.nodes).double().cpu().numpy(), 0.0, positive_orientation="low"):
        ring = contour[:-1]
        number = np.arange(len(ring)) + start
        points.append(ring)
        segments.append(np.stack([number, np.roll(number, -1)], axis=1))
        start += len(ring)
    signs = (1 - 2 * inside.to(torch.int8)).view(grid.nodes)
    place = np.concatenate(points)
    return place, edges_of_places(place), np.concatenate(segments).astype(np.int64), signs


# What can be wrong


def _finite(values: Tensor) -> Tensor:
    if not bool(torch.isfinite(values).all()):
        raise SurfaceError("The field is NaN or infinite inside its bounds. Mend its parameters, or shrink the bounds.")
    return values


def _no_surface(field: Field, *, positive: bool) -> SurfaceError:
    return SurfaceError(
        f"The field has no surface in its bounds {field.bounds.tolist()}: f {'>' if positive else '<'} 0 on the whole "
        "grid. Check level and inside, widen the bounds, or raise the resolution."
    )


def _leaves(field: Field, point: Tensor) -> SurfaceError:
    return SurfaceError(
        f"The surface leaves the bounds {field.bounds.tolist()}: f < 0 at the border, near {point.tolist()}. Widen the "
        "bounds, or refit the field so that it is positive there."
    )
