"""Points brought onto f = 0 along the gradient."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive
from implicit.field.field import Field, SurfaceError, require_field


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
        The points where they ended (N, D), and True for each that arrived (N,).

    Raises:
        ValueError: The points are not finite, or do not fit the field.
    """
    field.require_points(points)
    if tolerance is None:
        tolerance = field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)
    current = points.clone()
    arrived = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    going = torch.arange(len(points), device=points.device)
    for _ in range(iterations):
        if len(going) == 0:
            break
        x = current[going]
        f, g = field.value_and_gradient(x, validate=False)  # those that strayed or are not finite go no further
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
        f, g = field.value_and_gradient(current[going], validate=False)
        arrived[going] = f.abs() <= 10 * tolerance * g.norm(dim=1)
    return current, arrived


def project_to_surface(
    field: Field, points: Float[Tensor, "n d"], *, reach: float | None = None, tolerance: float | None = None
) -> Float[Tensor, "n d"]:
    """Move points to the surface along the gradient of the field.

    Args:
        points: Points (N, D) near the surface.
        reach: Largest distance a point may be moved, a length; None is half the size of the bounds.
        tolerance: Distance from the surface at which a point has arrived; None is 1e-12 of the field's size in
            float64 and 1e-6 in float32.

    Raises:
        SurfaceError: A point does not arrive.
    """
    require_field(field).require_points(points)
    reach = field.size / 2 if reach is None else reach
    require_positive("reach", reach, "length")
    if tolerance is not None:
        require_positive("tolerance", tolerance, "length")
    moved, arrived = newton_to_surface(field, points, reach=reach, tolerance=tolerance)
    if not bool(arrived.all()):
        i = int((~arrived).nonzero()[0])
        raise SurfaceError(
            f"{int((~arrived).sum())} of {len(points)} points did not reach the surface within {reach:.3g}, the first "
            f"is points[{i}] = {points[i].tolist()}. Start closer to the surface, or raise reach."
        )
    return moved


def require_on_surface(field: Field, points: Float[Tensor, "n d"], name: str) -> Float[Tensor, "n d"]:
    """Points placed on the surface, refused where they lie farther from it than a fiftieth of the field's size.

    Args:
        name: What the points are, for the error.

    Raises:
        SurfaceError: A point is off the surface.
    """
    points = field.require_points(points, name)
    placed, arrived = newton_to_surface(field, points, reach=0.02 * field.size)
    if not bool(arrived.all()):
        i = int((~arrived).nonzero()[0])
        raise SurfaceError(
            f"{name} must lie on the surface, but {name}[{i}] = {points[i].tolist()} is farther than "
            f"{0.02 * field.size:.3g} from it. Move them there first with project_to_surface."
        )
    return placed
