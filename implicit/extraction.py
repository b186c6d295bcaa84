"""The zero set as a mesh (3D) or as line segments (2D): grid, marching, then Newton to the true surface.

Conventions: faces wind so that their normals point out of f < 0; segments have the inside on their left.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from skimage.measure import find_contours, marching_cubes
from torch import Tensor

from implicit.field import Field

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


# Cells along a block that is evaluated or left out as a whole, and the factor by which the largest gradient seen at
# the blocks' centres is raised to bound those in between.
BLOCK_CELLS = 4
GRADIENT_SAFETY = 1.5

# Bytes for the grid of an extraction unless the caller says otherwise: a resolution of about 640 in a cube.
MEMORY_LIMIT = 4 * 2**30
BYTES_A_NODE = 16  # value, mask, and what marching cubes take on top


class SurfaceError(ValueError):
    """The field has no usable surface inside its bounds."""


def extract_mesh(field: Field, resolution: int = 128, *, memory_limit: float = MEMORY_LIMIT) -> tuple[Vertices, Faces]:
    """The surface as a closed triangle mesh, its vertices placed on f = 0 by Newton's method.

    Args:
        field: A field in 3D (triangles), or in 2D (segments).
        resolution: Cells along the longest side of the bounds, at least 4.
        memory_limit: Bytes that the grid may take; a finer one is refused before any work.

    Returns:
        Vertices (n, D) float64 in the field's coordinates, and faces (m, D) int64 that index them: triangles
        with outward normals, or in 2D segments with the inside on their left.

    Raises:
        SurfaceError: There is no zero set in the bounds, it leaves them, or the gradient vanishes on it.
        MemoryError: The grid would take more than memory_limit.
    """
    points, faces = marched_surface(field, resolution, memory_limit)
    return points.double().cpu().numpy(), faces.cpu().numpy()


def marched_surface(
    field: Field, resolution: int, memory_limit: float = MEMORY_LIMIT
) -> tuple[Float[Tensor, "n d"], Tensor]:
    """As extract_mesh, but as tensors of the field's dtype and device."""
    if resolution < 4:
        raise ValueError(f"resolution must be at least 4 cells along the longest side, but is {resolution}.")
    axes, cell = _axes(field, resolution)
    _require_memory(axes, memory_limit)
    values = grid_values(field, axes)
    _require_inside_bounds(values, field)
    march = _march_cubes if field.dimension == 3 else _march_squares
    index_points, faces = march(values.cpu().numpy())
    lower = torch.stack([axis[0] for axis in axes])
    start = lower + torch.from_numpy(index_points).to(field.theta) * cell
    points, arrived = newton_to_surface(field, start, reach=2 * cell)
    if not bool(arrived.all()):
        # A vertex between two sheets closer than a cell may have nowhere to go; it keeps its place on the grid edge,
        # which is within a cell of the surface, unless so many fail that the field itself is at fault.
        lost = int((~arrived).sum())
        if lost > 0.01 * len(points):
            raise SurfaceError(
                f"{lost} of {len(points)} surface points could not be placed on f = 0: the gradient vanishes or jumps "
                "there. Refit the field, or extract at a higher resolution."
            )
        points = torch.where(arrived[:, None], points, start)
    return points, torch.from_numpy(faces).to(field.device)


def newton_to_surface(
    field: Field,
    points: Float[Tensor, "n d"],
    *,
    reach: float,
    tolerance: float | None = None,
    iterations: int = 30,
) -> tuple[Float[Tensor, "n d"], Tensor]:
    """Newton's method along the gradient, x <- x - f df/dx / |df/dx|^2, only where still needed.

    Args:
        points: Starting points (N, D).
        reach: No point goes farther from its start than this, a length.
        tolerance: Distance |f| / |df/dx| at which a point has arrived; None is 1e-12 of the field's size in
            float64 and 1e-6 in float32.
        iterations: Most steps taken.

    Returns:
        The points where they ended, and whether each arrived.
    """
    if tolerance is None:
        tolerance = field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)
    current = points.clone()
    arrived = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    going = torch.arange(len(points), device=points.device)
    for _ in range(iterations):
        if len(going) == 0:
            break
        x = current[going]
        f, g = field.value_and_gradient(x)
        square = (g * g).sum(dim=1)
        step = -(f / square.clamp(min=torch.finfo(f.dtype).tiny))[:, None] * g
        length = step.norm(dim=1)
        # Longer steps than a quarter of the reach are the sign of a small gradient, not of a distant surface.
        step = step * (0.25 * reach / length.clamp(min=0.25 * reach))[:, None]
        moved = x + step
        strayed = ~torch.isfinite(moved).all(dim=1) | ((moved - points[going]).norm(dim=1) > reach)
        # Newton squares the error: a step s leaves about s^2 / (2 r) where the surface has radius r. Taking r for a
        # hundredth of the field's size saves the last evaluation, which would only confirm it.
        there = (torch.minimum(length, 50 / field.size * length**2) <= tolerance) & ~strayed
        current[going] = torch.where(strayed[:, None], x, moved)
        arrived[going[there]] = True
        going = going[~there & ~strayed]
    if len(going):  # rounding may hold the last digit above the tolerance: accept ten times as much
        f, g = field.value_and_gradient(current[going])
        arrived[going] = f.abs() <= 10 * tolerance * g.norm(dim=1)
    return current, arrived


def project_to_surface(
    field: Field, points: Float[Tensor, "n d"], *, reach: float | None = None, tolerance: float | None = None
) -> Float[Tensor, "n d"]:
    """Move points to the surface along the gradient of the field.

    Args:
        points: Points (N, D) near the surface.
        reach: Farthest way allowed, a length; None is half the size of the bounds.
        tolerance: Distance from the surface at which a point has arrived; None is 1e-12 of the field's size in
            float64 and 1e-6 in float32.

    Raises:
        SurfaceError: A point does not arrive.
    """
    field.require_points(points)
    reach = field.size / 2 if reach is None else reach
    moved, arrived = newton_to_surface(field, points, reach=reach, tolerance=tolerance)
    if not bool(arrived.all()):
        i = int((~arrived).nonzero()[0])
        raise SurfaceError(
            f"{int((~arrived).sum())} of {len(points)} points did not reach the surface within {reach:.3g}, the first "
            f"is points[{i}] = {points[i].tolist()}. Start closer to the surface, or raise reach."
        )
    return moved


def grid_values(field: Field, axes: list[Tensor]) -> Tensor:
    """f in float32 on the product grid of the axes, evaluated only in blocks of cells that can hold the surface.

    A block is left out where |f| at its centre exceeds half its diagonal times a bound on |df/dx|: the largest
    gradient seen near by on a coarse grid, with a safety factor. Its nodes take the value at the centre, which has
    the right sign. Large grids are first thinned in blocks of blocks. Single precision is all that marching cubes
    work in; the vertices find the surface afterwards in the field's own.
    """
    field = field.to(torch.float32)
    axes = [axis.float() for axis in axes]
    counts = [-(-(len(axis) - 1) // BLOCK_CELLS) for axis in axes]
    cell = float(axes[0][1] - axes[0][0])
    steepest = _Steepest(field)
    values, near = _block_values(field, [float(axis[0]) for axis in axes], cell * BLOCK_CELLS, counts, steepest)
    wanted = near
    for axis, nodes in enumerate(axes):
        values = _to_nodes(values, axis, len(nodes))[0]
        here, before = _to_nodes(wanted, axis, len(nodes))
        wanted = here | before
    values = values.contiguous()
    index = wanted.nonzero()
    points = torch.stack([axis[index[:, k]] for k, axis in enumerate(axes)], dim=1)
    values[wanted] = _finite(field.value(points))
    return values


def _block_values(
    field: Field, lower: list[float], side: float, counts: list[int], steepest: _Steepest
) -> tuple[Tensor, Tensor]:
    """f at the centre of each block, or at that of the larger block round it, and whether the surface may be inside."""
    half_diagonal = 0.5 * side * field.dimension**0.5
    if max(counts) < 6 * BLOCK_CELLS:
        candidates = torch.ones(counts, dtype=torch.bool, device=field.device)
        values = torch.zeros(counts, dtype=torch.float32, device=field.device)
    else:
        coarse = [-(-count // BLOCK_CELLS) for count in counts]
        values, candidates = _block_values(field, lower, side * BLOCK_CELLS, coarse, steepest)
        for axis, count in enumerate(counts):
            values = values.repeat_interleave(BLOCK_CELLS, dim=axis).narrow(axis, 0, count)
            candidates = candidates.repeat_interleave(BLOCK_CELLS, dim=axis).narrow(axis, 0, count)
        values = values.contiguous()
    index = candidates.nonzero()
    centers = torch.tensor(lower, device=field.device) + side * (index + 0.5)
    found = _finite(field.value(centers.float()))
    values[candidates] = found
    near = torch.zeros_like(candidates)
    near[candidates] = found.abs() <= steepest.at(centers) * half_diagonal
    return values, near


class _Steepest:
    """A bound on |df/dx| near a point: the largest at the 27 nearest nodes of a coarse grid, with the safety factor."""

    nodes = 24

    def __init__(self, field: Field) -> None:
        lines = [
            torch.linspace(float(a), float(b), self.nodes, dtype=field.dtype, device=field.device)
            for a, b in field.bounds.T
        ]
        points = torch.stack(torch.meshgrid(*lines, indexing="ij"), dim=-1).reshape(-1, field.dimension)
        lengths = _finite(field.gradient(points)).norm(dim=1).view(1, 1, *[self.nodes] * field.dimension)
        pool = torch.nn.functional.max_pool3d if field.dimension == 3 else torch.nn.functional.max_pool2d
        self._bound = GRADIENT_SAFETY * pool(lengths, 3, stride=1, padding=1)[0, 0]
        self._lower = field.bounds[0]
        self._step = (field.bounds[1] - field.bounds[0]) / (self.nodes - 1)

    def at(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """The bound near each point."""
        index = ((points - self._lower) / self._step).round().long().clamp(0, self.nodes - 1)
        return self._bound[tuple(index.T)]


def _finite(values: Tensor) -> Tensor:
    if not bool(torch.isfinite(values).all()):
        raise SurfaceError("The field is NaN or infinite inside its bounds. Mend its parameters, or shrink the bounds.")
    return values


def _to_nodes(blocks: Tensor, axis: int, count: int) -> tuple[Tensor, Tensor]:
    """Along one axis, what each node gets from the block after it and from the block before it."""
    cells = blocks.repeat_interleave(BLOCK_CELLS, dim=axis).narrow(axis, 0, count - 1)
    first, last = cells.narrow(axis, 0, 1), cells.narrow(axis, count - 2, 1)
    return torch.cat([cells, last], dim=axis), torch.cat([first, cells], dim=axis)


def _axes(field: Field, resolution: int) -> tuple[list[Tensor], float]:
    """Grid lines in each direction, cubes of one size, centred on the bounds and covering them."""
    cell = field.size / resolution
    axes = []
    for lower, upper in field.bounds.T.tolist():
        count = int(np.ceil((upper - lower) / cell - 1e-9))
        first = (lower + upper) / 2 - count * cell / 2
        axes.append(first + cell * torch.arange(count + 1, dtype=field.dtype, device=field.device))
    return axes, cell


def _require_memory(axes: list[Tensor], limit: float) -> None:
    nodes = 1.0
    for axis in axes:
        nodes *= len(axis)
    if BYTES_A_NODE * nodes > limit:
        raise MemoryError(
            f"A grid of {' x '.join(str(len(axis)) for axis in axes)} nodes needs about "
            f"{BYTES_A_NODE * nodes / 2**30:.1f} GiB, more than the limit of {limit / 2**30:.1f} GiB. Lower "
            "the resolution, or raise memory_limit."
        )


def _require_inside_bounds(values: Tensor, field: Field) -> None:
    inside = values < 0
    if not bool(inside.any()) or bool(inside.all()):
        what = "f > 0" if not bool(inside.any()) else "f < 0"
        raise SurfaceError(
            f"The field has no surface in its bounds {field.bounds.tolist()}: {what} on the whole grid. Check level "
            "and inside, widen the bounds, or raise the resolution."
        )
    shell = torch.ones_like(inside)
    shell[(slice(1, -1),) * inside.ndim] = False
    if bool((inside & shell).any()):
        where = (inside & shell).nonzero()[0].tolist()
        raise SurfaceError(
            f"The surface leaves the bounds {field.bounds.tolist()}: f < 0 at the border, first at grid node {where}. "
            "Widen the bounds, or refit the field so that it is positive there."
        )


def _march_cubes(values: NDArray[np.floating]) -> tuple[NDArray[np.float64], Faces]:
    # Default winding ("descent") faces outward for f < 0 inside; its normals do not, so they are not used.
    vertices, faces, _, _ = marching_cubes(values.astype(np.float32), 0.0, allow_degenerate=False)
    return vertices.astype(np.float64), faces.astype(np.int64)


def _march_squares(values: NDArray[np.floating]) -> tuple[NDArray[np.float64], Faces]:
    points: list[NDArray[np.float64]] = []
    segments: list[Faces] = []
    start = 0
    # find_contours walks with low values on the left; the contour closes, so its last point repeats the first.
    for contour in find_contours(values.astype(np.float64), 0.0, positive_orientation="low"):
        ring = contour[:-1]
        index = np.arange(len(ring)) + start
        points.append(ring)
        segments.append(np.stack([index, np.roll(index, -1)], axis=1))
        start += len(ring)
    return np.concatenate(points), np.concatenate(segments).astype(np.int64)
