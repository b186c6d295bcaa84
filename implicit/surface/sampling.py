"""Random points on the surface: evenly spread, independent and uniform, or as the paper draws them.

All but the paper's start from quadratic cells that follow the surface to third order (implicit.surface.quadrature), so
that drawing in a cell by its area, with rejection where its area element varies, is uniform on the surface to that
order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from torch import Tensor

from implicit.arguments import require_callable, require_choice, require_tensor, require_whole
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.extraction import require_resolution
from implicit.surface.projection import in_working_precision, newton_to_surface, project_to_surface
from implicit.surface.quadrature import (
    SurfaceSample,
    cell_elements,
    cell_points,
    curved_cells,
    normals_of,
    placed,
    require_sample,
    surface_quadrature,
)

SampleMethod = Literal["stratified", "uniform", "farthest", "rejection"]
METHODS = ("stratified", "uniform", "farthest", "rejection")

# Stratified points from which each of the farthest is chosen.
CANDIDATES = 6

# Cells along a side for the area that the paper's draws are held against, and by how much they may differ.
BAND_CHECK = 32
BAND_ERROR = 0.2


def sample_surface(
    field: Field,
    n: int,
    method: SampleMethod = "stratified",
    *,
    density: Callable[[Tensor], Tensor] | None = None,
    resolution: int = 64,
    seed: int = 0,
    generator: torch.Generator | None = None,
) -> SurfaceSample:
    """Return n random points on the surface.

    Args:
        field: The field.
        n: Number of points.
        method: "stratified" puts one point in each of n strips of equal area along a space-filling curve, so neighbours
            keep apart and integrals converge faster; "uniform" draws independent points, uniform over the area;
            "farthest" chooses of stratified points, six times as many, by farthest-point selection: the most even, and
            the fewest for the same error of an edit, at a cost that grows with n^2;
            "rejection" is the paper's: points of the bounds near the surface, projected, of which
            farthest-point selection chooses n.
        density: Points (N, D) to positive numbers (N,), as many points an area relative to elsewhere: draws more
            where more detail is needed, `lambda x: 1 + 9 * Ball(center, radius)(x)`. For "stratified" and "uniform".
        resolution: Cells along the longest side of the bounds for the cells that are sampled; for "rejection" it
            sets the width of the band, two cells.
        seed: Seed of the random choice, unless a generator is given.
        generator: Source of the random choice; None starts one with the seed.

    Returns:
        Points on the surface with weights that sum to its area: equal ones, with a density inverse to it, for
        "farthest" the area nearest to each. Those of "rejection" sum to an estimate of it, and its points are spread
        evenly by their distance, not by area.

    Raises:
        SurfaceError: There is no surface in the bounds, or it leaves them.
        ValueError: The method is unknown or takes no density, n is below 1, or the density is not positive.
    """
    require_field(field)
    require_whole("n", n, 1, "point")
    require_choice("method", method, METHODS)
    require_resolution("resolution", resolution)
    require_whole("seed", seed, 0)
    if generator is not None and not isinstance(generator, torch.Generator):
        raise TypeError(f"generator must be a torch.Generator, but is a {type(generator).__name__}.")
    if density is not None:
        require_callable("density", density, "a function from points (N, D) to numbers (N,)")
    if density is not None and method not in ("stratified", "uniform"):
        raise ValueError(f'A density needs method "stratified" or "uniform", not {method!r}.')
    generator = torch.Generator().manual_seed(seed) if generator is None else generator
    if (working := in_working_precision(field)) is not field:
        single = sample_surface(working, n, method, density=density, resolution=resolution, generator=generator)
        return single.to(field.dtype)
    if method == "rejection":
        return _by_rejection(field, n, resolution, generator)
    if method == "farthest":
        many = sample_surface(field, CANDIDATES * n, resolution=resolution, generator=generator)
        return _farthest(many, n)
    nodes = curved_cells(field, resolution)
    if method == "stratified":
        corners = nodes[:, : field.dimension]  # the nodes between them come after
        nodes = nodes[_space_filling_order(corners.mean(dim=1), field)]
    area, largest = _cell_areas(nodes)
    dense = torch.ones_like(area) if density is None else _cell_densities(density, nodes)
    amount = area * dense  # points in each cell, up to a factor
    total = amount.sum()
    if method == "stratified":
        chosen = one_a_strip(amount, _random(n, amount, generator))
    else:
        chosen = torch.multinomial(amount.double().cpu(), n, replacement=True, generator=generator).to(field.device)
    points, normals = torch.empty(2, n, field.dimension, dtype=field.dtype, device=field.device)
    waiting = torch.arange(n, device=field.device)
    while len(waiting):
        cells = chosen[waiting]
        at = _uniform_barycentric(len(waiting), field.dimension, generator).to(field.theta)
        found, across = cell_points(nodes[cells], at)
        chance = torch.rand(len(waiting), generator=generator, dtype=torch.float64).to(field.theta)
        taken = chance * largest[cells] <= across.norm(dim=1)
        points[waiting[taken]] = found[taken]
        normals[waiting[taken]] = torch.nn.functional.normalize(across[taken], dim=1)
        waiting = waiting[~taken]
    return placed(field, SurfaceSample(points, normals, total / n / dense[chosen]), 2 * field.size / resolution)


def carrying_points(
    field: Field, points: int | SurfaceSample, method: SampleMethod = "stratified", *, seed: int = 0
) -> SurfaceSample:
    """Return the points that carry an edit: the sample itself, or so many drawn from the surface."""
    if isinstance(points, SurfaceSample):
        field.require_points(points.points, "points")
        return points
    require_whole("points", points)
    return sample_surface(field, points, method, seed=seed)


def transport(field: Field, sample: SurfaceSample, displacement: Float[Tensor, "n d"]) -> SurfaceSample:
    """Return a sample moved along a displacement and put back on a surface, of the edited field say.

    Args:
        field: The field on whose surface the points are to lie.
        sample: Points of the surface before.
        displacement: Displacement of each point (N, D), a length; it has to lead to within its own length, or a
            hundredth of the field's size, of the new surface.

    Returns:
        Points and normals of the new surface. The weights are those of before: they integrate over the surface
        that the points came from.

    Raises:
        SurfaceError: A point does not reach the surface.
    """
    require_sample(field, sample)
    require_tensor("displacement", displacement, sample.points.shape, field.device)
    reach = float(displacement.norm(dim=1).amax()) + 0.01 * field.size
    points = project_to_surface(field, sample.points + displacement, reach=reach)
    return replace(sample, points=points, normals=normals_of(field, points, sample.normals))


def _farthest(sample: SurfaceSample, n: int) -> SurfaceSample:
    """Return n of the points by farthest-point selection, each with the weights of those nearest to it."""
    order = farthest_order(sample.points, n)
    points = sample.points[order]
    nearest = torch.from_numpy(cKDTree(points.cpu().numpy()).query(sample.points.cpu().numpy())[1]).to(order)
    weights = torch.zeros_like(sample.weights[:n]).index_add_(0, nearest, sample.weights)
    return SurfaceSample(points, sample.normals[order], weights)


def _cell_densities(density: Callable[[Tensor], Tensor], nodes: Tensor) -> Tensor:
    """Return the density at the middle of each cell."""
    dense = density(nodes.mean(dim=1))
    if not isinstance(dense, Tensor) or dense.shape != nodes.shape[:1]:
        came = tuple(dense.shape) if isinstance(dense, Tensor) else type(dense).__name__
        raise ValueError(f"density must give {len(nodes)} numbers, one a point, but gives {came}.")
    dense = dense.to(nodes)
    if not bool((torch.isfinite(dense) & (dense > 0)).all()):
        raise ValueError(
            f"density must be positive and finite, but is {float(dense.min()):.3g} to {float(dense.max()):.3g}. "
            "Add a constant to it for the rest of the surface."
        )
    return dense


def subsample(field: Field, sample: SurfaceSample, n: int, *, seed: int = 0) -> SurfaceSample:
    """Return n points of a quadrature, one from each of n strips of equal area, moved to the surface.

    As even as a fresh sample, for a fraction of its cost. A quadrature of fewer than 4 n points is too coarse to choose
    from; then the sample is a fresh one.
    """
    if len(sample) < 4 * n:
        return sample_surface(field, n, seed=seed)
    if (working := in_working_precision(field)) is not field:
        return subsample(working, sample.to(working.dtype), n, seed=seed).to(field.dtype)
    order = _space_filling_order(sample.points, field)
    amounts = sample.weights[order]
    chosen = order[one_a_strip(amounts, _random(n, amounts, torch.Generator().manual_seed(seed)))]
    equal = (sample.weights.sum() / n).expand(n).clone()
    return placed(field, SurfaceSample(sample.points[chosen], sample.normals[chosen], equal), field.size / 16)


def _random(n: int, like: Tensor, generator: torch.Generator) -> Float[Tensor, " n"]:
    return torch.rand(n, generator=generator, dtype=torch.float64).to(like)


def one_a_strip(amounts: Float[Tensor, " m"], within: Float[Tensor, " n"]) -> Int[Tensor, " n"]:
    """Return the index of the amount, all laid end to end, at a place in each of n strips of equal length.

    Args:
        amounts: Not negative.
        within: Where in its strip, from 0 to 1.
    """
    n = len(within)
    place = (torch.arange(n, device=amounts.device) + within) * (amounts.sum() / n)
    return torch.searchsorted(amounts.cumsum(0), place).clamp(max=len(amounts) - 1)


def _cell_areas(nodes: Tensor) -> tuple[Tensor, Tensor]:
    """Return the area (or length) of each quadratic cell, and a bound on its area element per unit of barycentric area.

    The element is sampled on a lattice of the cell; a tenth on top covers what varies between.
    """
    if nodes.shape[2] == 2:
        lattice = torch.linspace(0, 1, 9)[:, None]
        share = torch.ones(9)
        share[[0, -1]] = 0.5
        unit = 1.0
    else:
        steps = [(i / 6, j / 6) for i in range(7) for j in range(7 - i)]
        lattice = torch.tensor(steps)
        # Trapezoidal weights of the lattice: inside 6, on a side 3, in a corner 1 triangles meet at a node.
        on = torch.stack([lattice[:, 0] == 0, lattice[:, 1] == 0, (lattice.sum(dim=1) - 1).abs() < 1e-6]).sum(dim=0)
        share = torch.tensor([6.0, 3.0, 1.0])[on]
        unit = 0.5
    elements = cell_elements(nodes, lattice.to(nodes))
    share = (share / share.sum()).to(nodes)
    return unit * (share @ elements), 1.1 * elements.amax(dim=0)


def _by_rejection(field: Field, n: int, resolution: int, generator: torch.Generator) -> SurfaceSample:
    """Sample as the paper does: draw in the bounds, keep a band about the surface, project, select [appendix]."""
    band = 2 * field.size / resolution
    lower, upper = field.bounds
    kept: list[Tensor] = []
    count, drawn = 0, 0
    inside = 0
    while count < 4 * n and drawn < 1000 * n + 1_000_000:
        draw = torch.rand(max(20_000, 4 * n), field.dimension, generator=generator, dtype=torch.float64).to(field.theta)
        points = lower + draw * (upper - lower)
        value, gradient = field.value_and_gradient(points)
        # To first order the distance is the value over the slope, whatever the scale of the field.
        near = value.abs() <= band * gradient.norm(dim=1)
        inside += int(near.sum())
        moved, arrived = newton_to_surface(field, points[near], reach=2 * band)
        kept.append(moved[arrived])
        count += len(kept[-1])
        drawn += len(points)
    if count < n:
        raise SurfaceError(
            f"Only {count} of {n} points were found on the surface in {drawn} draws. Check that there is one in the "
            "bounds, or take another method."
        )
    candidates = torch.cat(kept)[: 4 * n]
    points = candidates[farthest_order(candidates, n)]
    # A band of half-width w about an area A has the volume 2 w A.
    area = _confirmed_area(field, float((upper - lower).prod()) * inside / drawn / (2 * band), resolution)
    weights = torch.full_like(points[:, 0], area / n)
    return SurfaceSample(points, field.normal(points), weights)


def _confirmed_area(field: Field, estimate: float, resolution: int) -> float:
    """Return the area from the draws in a band, or that of the cells where the band was not what it was taken for.

    A saturated or truncated field is level within the band, so that fewer points seem near than are.
    """
    try:
        cells = float(surface_quadrature(field, BAND_CHECK).weights.sum())
        if abs(estimate / cells - 1) <= BAND_ERROR:
            return estimate
        return float(surface_quadrature(field, max(BAND_CHECK, resolution)).weights.sum())
    except SurfaceError:  # the surface leaves the bounds, and only the part in them is sampled
        return estimate


def farthest_order(points: Float[Tensor, "m d"], n: int) -> Tensor:
    """Return the indices of n of the points, each the farthest from those before it; the first is the first."""
    distance = torch.full_like(points.detach()[:, 0], float("inf"))
    chosen = torch.zeros(n, dtype=torch.long, device=points.device)
    # A coordinate at a time: sums over three neighbours in memory take three times as long.
    axes = [axis.contiguous() for axis in points.detach().T]
    square, term = torch.empty_like(distance), torch.empty_like(distance)
    for k in range(1, n):
        last = chosen[k - 1]
        torch.sub(axes[0], axes[0][last], out=square).square_()
        for axis in axes[1:]:
            square += torch.sub(axis, axis[last], out=term).square_()
        torch.minimum(distance, square, out=distance)
        chosen[k] = distance.argmax()
    return chosen


def _uniform_barycentric(n: int, dimension: int, generator: torch.Generator) -> Tensor:
    """Return the last barycentric coordinates of n points uniform in a triangle (two), or in a segment (one)."""
    u = torch.rand(n, dimension - 1, generator=generator, dtype=torch.float64)
    if dimension == 2:
        return u
    root = u[:, 0].sqrt()
    return torch.stack([root * (1 - u[:, 1]), root * u[:, 1]], dim=1)


def _space_filling_order(centers: Tensor, field: Field) -> Tensor:
    """Return the order along the Morton curve, ten bits a coordinate."""
    unit = (centers - field.bounds[0]) / (field.bounds[1] - field.bounds[0])
    cells = (unit.clamp(0, 1) * 1023).long()
    numbers = torch.arange(1024, device=centers.device)
    spread = torch.zeros_like(numbers)  # the bits of a coordinate with room between them for those of the others
    for bit in range(10):
        spread |= ((numbers >> bit) & 1) << (bit * field.dimension)
    code = spread[cells[:, 0]]
    for axis in range(1, field.dimension):
        code |= spread[cells[:, axis]] << axis
    return torch.argsort(code, stable=True)
