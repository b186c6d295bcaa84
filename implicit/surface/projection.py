"""Points brought onto f = 0 along the gradient: by Newton's method, and by brackets where it does not arrive.

Newton's method needs a gradient that says where the surface is. It does not where the gradient jumps (ReLU, the medial
axis of a distance) or nearly vanishes (occupancies and truncated distances off the surface, dead units). The points it
leaves walk along the gradient, with growing steps, until f changes its sign, and the zero in between is bracketed.
What arrives by Newton's method is left as it is, to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from implicit.arguments import require_positive
from implicit.field.field import Field, SurfaceError, require_field
from implicit.surface.bracketing import bracketed_zeros

Segments = tuple[Float[Tensor, "n d"], Float[Tensor, "n d"]]

# A point has arrived where |f| / |df/dx| is at most so many tolerances: rounding may hold the last digit above one.
SLACK = 10

# A point on an edge of a grid that goes farther than this share of the edge may pass its neighbours, and fold the mesh.
# On smooth surfaces that a grid resolves none of thousands does.
LEASH = 0.5

# Steps of the walk to a change of sign, the first at most this share of the reach, each at most so much longer.
WALK_STEPS = 24
WALK_FIRST = 1 / 64
WALK_GROWTH = 1.5

# Shares of the reach at which a point without a gradient looks about.
LOOKS = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)

# A gradient that would take so many sizes of the field to bring f to zero points nowhere.
POINTLESS = 100.0


@dataclass(frozen=True, eq=False)
class Placement:
    """Points brought to the surface, as far as they went.

    Attributes:
        points: The points where they ended (N, D).
        arrived: True for each on f = 0, (N,).
        jumps: True for each where f changes its sign in a jump, without a zero: the field is discontinuous there.
        gradients: df/dx at the last place at which each was evaluated on its way, within a step of its end.
    """

    points: Float[Tensor, "n d"]
    arrived: Bool[Tensor, " n"]
    jumps: Bool[Tensor, " n"]
    gradients: Float[Tensor, "n d"]


def newton_to_surface(
    field: Field,
    points: Float[Tensor, "n d"],
    *,
    reach: float,
    tolerance: float | None = None,
    iterations: int = 30,
) -> tuple[Float[Tensor, "n d"], Tensor]:
    """Newton's method along the gradient, x <- x - f df/dx / |df/dx|^2; brackets where it does not arrive.

    Args:
        field: The field.
        points: Starting points (N, D).
        reach: No point goes farther from its start than this, a length.
        tolerance: Distance |f| / |df/dx| at which a point has arrived; None is 1e-12 of the field's size in
            float64 and 1e-6 in float32 and below, where single precision places the points.
        iterations: Most steps taken by Newton's method.

    Returns:
        The points where they ended (N, D), and True for each that arrived (N,).

    Raises:
        ValueError: The points are not finite, or do not fit the field.
    """
    found = place_on_surface(field, points, reach=reach, tolerance=tolerance, iterations=iterations)
    return found.points, found.arrived


def place_on_surface(
    field: Field,
    points: Float[Tensor, "n d"],
    *,
    reach: float,
    tolerance: float | None = None,
    iterations: int = 30,
    segments: Segments | None = None,
    thorough: bool = False,
    brackets: bool = True,
) -> Placement:
    """Place points as newton_to_surface does, and tell where the field jumps.

    Args:
        field: The field.
        points: Starting points (N, D).
        reach: No point goes farther from its start than this, a length.
        tolerance: As for newton_to_surface.
        iterations: As for newton_to_surface.
        segments: Two ends (N, D) for each point with the surface between them, such as the edge of a grid. A point
            that Newton's method does not bring to the surface, or takes farther than a part of the segment, is placed
            on its segment. None, or ends of the same sign, leave it the walk along the gradient.
        thorough: True looks all around from each point whose gradient leads nowhere, as in a hollow of |f| off the
            surface; False does so where there is no gradient alone, since most such points are better given up.
        brackets: False gives up what Newton's method does not bring to the surface.
    """
    field.require_points(points)
    if in_working_precision(field) is not field:
        single = [x.float() for x in (points, *(segments or ()))]
        found = place_on_surface(
            in_working_precision(field),
            single[0],
            reach=reach,
            tolerance=tolerance,
            iterations=iterations,
            segments=None if segments is None else (single[1], single[2]),
            thorough=thorough,
            brackets=brackets,
        )
        return Placement(found.points.to(points), found.arrived, found.jumps, found.gradients.to(points))
    if tolerance is None:
        tolerance = placing_tolerance(field)
    current, arrived, gradients = _newton(field, points, reach, tolerance, iterations)
    away = ~arrived
    if segments is not None:
        away = away | ((current - points).norm(dim=1) > LEASH * (segments[1] - segments[0]).norm(dim=1))
    jumps = torch.zeros_like(arrived)
    left = away.nonzero()[:, 0]
    if len(left) and brackets:
        chosen = None if segments is None else (segments[0][left], segments[1][left])
        start, end, at_start, at_end, known = _brackets(field, points[left], reach, tolerance, chosen, thorough)
        zeros = bracketed_zeros(field, start, end, at_start, at_end, tolerance)
        left = left[known]
        current[left], arrived[left], jumps[left] = zeros.points, ~zeros.jumps, zeros.jumps
        gradients[left] = field.gradient(zeros.points)
    return Placement(current, arrived, jumps, gradients)


def placing_tolerance(field: Field) -> float:
    """Return the distance from the surface at which a point has arrived, where the caller names none."""
    return field.size * (1e-12 if field.dtype == torch.float64 else 1e-6)


def in_working_precision(field: Field) -> Field:
    """Return the field, in single precision where it is of half: there the surface is found, and told in half."""
    return field.to(torch.float32) if field.dtype.itemsize < 4 else field


def _newton(
    field: Field, points: Float[Tensor, "n d"], reach: float, tolerance: float, iterations: int
) -> tuple[Float[Tensor, "n d"], Bool[Tensor, " n"], Float[Tensor, "n d"]]:
    """Return where Newton's method takes the points, True for each that arrived, and their last gradients."""
    current = points.clone()
    gradients = torch.zeros_like(points)
    arrived = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    going = torch.arange(len(points), device=points.device)
    for _ in range(iterations):
        if len(going) == 0:
            break
        every = len(going) == len(points)  # then nothing is gathered or scattered: that takes as long as a layer
        x = current if every else current.index_select(0, going)
        begun = points if every else points.index_select(0, going)
        f, g = field.value_and_gradient(x, validate=False)  # those that strayed or are not finite go no further
        gradients = g if every else gradients.index_copy_(0, going, g)
        square = (g * g).sum(dim=1)
        step = -(f / square.clamp(min=torch.finfo(f.dtype).tiny))[:, None] * g
        length = step.norm(dim=1)
        # Longer steps than a quarter of the reach are the sign of a small gradient, not of a distant surface.
        step = step * (0.25 * reach / length.clamp(min=0.25 * reach))[:, None]
        moved = x + step
        strayed = ~((moved - begun).norm(dim=1) <= reach)  # or not finite
        strayed |= (square == 0) & (f != 0)  # no step is none that has arrived
        # Newton squares the error: a step s leaves about s^2 / (2 r) where the surface has radius r. Taking r for a
        # hundredth of the field's size saves a gradient; the values below tell whether it was so.
        there = (torch.minimum(length, 50 / field.size * length**2) <= tolerance) & ~strayed
        moved = torch.where(strayed[:, None], x, moved)
        current = moved if every else current.index_copy_(0, going, moved)
        arrived.scatter_(0, going, there)
        going = going.masked_select(~there & ~strayed)
    if len(going):
        f, g = field.value_and_gradient(current[going], validate=False)
        gradients[going] = g
        arrived[going] = f.abs() <= SLACK * tolerance * g.norm(dim=1)
    claimed = arrived.nonzero()[:, 0]
    if len(claimed):
        # Where the gradient has jumped in the last step, the step was not the whole way.
        every = len(claimed) == len(points)
        x, g = (current, gradients) if every else (part.index_select(0, claimed) for part in (current, gradients))
        arrived.scatter_(0, claimed, field.value(x).abs() <= SLACK * tolerance * g.norm(dim=1))
    return current, arrived, gradients


# Where Newton's method does not arrive: two places of different sign

_Brackets = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]  # start, end, f at both, and which points have them


def _brackets(
    field: Field, points: Tensor, reach: float, tolerance: float, segments: Segments | None, thorough: bool
) -> _Brackets:
    """Return brackets: the given segments where they are some, found on a walk elsewhere."""
    start, end = points.clone(), points.clone()
    at_start, gradient = field.value_and_gradient(points)
    at_end = at_start.clone()
    known = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    if segments is not None:
        low, high = segments
        at_low, at_high = field.value(low), field.value(high)
        known = (at_low < 0) != (at_high < 0)
        start, end = torch.where(known[:, None], low, start), torch.where(known[:, None], high, end)
        at_start, at_end = torch.where(known, at_low, at_start), torch.where(known, at_high, at_end)
    level = gradient.norm(dim=1) * POINTLESS * field.size <= at_start.abs()
    for search in (_walk, _look_about):
        lost = (~known & (level | thorough | (search is _walk))).nonzero()[:, 0]
        if len(lost) == 0:
            continue
        found = search(field, points[lost], at_start[lost], gradient[lost], reach, tolerance)
        which = lost[found[4]]
        start[which], end[which], at_start[which], at_end[which] = (part[found[4]] for part in found[:4])
        known[which] = True
    return start[known], end[known], at_start[known], at_end[known], known


def _walk(field: Field, points: Tensor, f: Tensor, g: Tensor, reach: float, tolerance: float) -> _Brackets:
    """Follow the gradient towards f = 0 from each point, a little past where it says that f is zero."""
    start, end, at_start, at_end = points.clone(), points.clone(), f.clone(), f.clone()
    known = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    going = (g.norm(dim=1) > 0).nonzero()[:, 0]
    x, f, g = points[going], f[going], g[going]
    ahead = torch.zeros_like(x)
    longest, past = WALK_FIRST * reach, WALK_GROWTH
    for _ in range(WALK_STEPS):
        slope = g.norm(dim=1)
        # Over ground without a slope the walk goes on as before.
        downhill = -torch.sign(f + (f == 0))[:, None] * g / slope.clamp(min=torch.finfo(f.dtype).tiny)[:, None]
        ahead = torch.where((slope > 0)[:, None], downhill, ahead)
        room = reach - (x - points[going]).norm(dim=1)
        length = (past * f.abs() / slope).nan_to_num(nan=longest).clamp(SLACK * tolerance, longest)
        length = torch.minimum(length, room)
        beyond = x + length[:, None] * ahead
        within = torch.isfinite(beyond).all(dim=1) & (room > tolerance)
        going, x, f, beyond, ahead = going[within], x[within], f[within], beyond[within], ahead[within]
        if len(going) == 0:
            break
        f_beyond, g = field.value_and_gradient(beyond, validate=False)
        crossed = (f < 0) != (f_beyond < 0)
        which = going[crossed]
        start[which], end[which], at_start[which], at_end[which] = (part[crossed] for part in (x, beyond, f, f_beyond))
        known[which] = True
        going, x, f, g, ahead = (part[~crossed] for part in (going, beyond, f_beyond, g, ahead))
        # Where f falls off as a power of the distance, a fixed share of the way ahead would never be the whole of it.
        longest, past = min(WALK_GROWTH * longest, reach / 4), WALK_GROWTH * past
    return start, end, at_start, at_end, known


def _look_about(field: Field, points: Tensor, f: Tensor, _: Tensor, reach: float, __: float) -> _Brackets:
    """Look from each point in every direction of a lattice, farther and farther."""
    start, end, at_start, at_end = points.clone(), points.clone(), f.clone(), f.clone()
    known = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    going = torch.arange(len(points), device=points.device)
    directions = [way for way in product((-1.0, 0.0, 1.0), repeat=field.dimension) if any(way)]
    ways = torch.nn.functional.normalize(torch.tensor(directions).to(points), dim=1)
    at_before = f[going, None].expand(-1, len(ways))
    before = 0.0
    for share in LOOKS:
        if len(going) == 0:
            break
        beyond = points[going, None] + share * reach * ways
        f_beyond = field.value(beyond.flatten(0, 1)).view(len(going), -1)
        crossed = (f_beyond < 0) != (f[going] < 0)[:, None]
        found, way = crossed.any(dim=1), crossed.int().argmax(dim=1)
        which, way, row = going[found], way[found], found.nonzero()[:, 0]
        start[which] = points[which] + before * reach * ways[way]
        end[which] = beyond[row, way]
        at_start[which], at_end[which] = at_before[row, way], f_beyond[row, way]
        known[which] = True
        going, at_before, before = going[~found], f_beyond[~found], share
    return start, end, at_start, at_end, known


def project_to_surface(
    field: Field, points: Float[Tensor, "n d"], *, reach: float | None = None, tolerance: float | None = None
) -> Float[Tensor, "n d"]:
    """Move points to the surface along the gradient of the field; where it vanishes, to where the sign changes.

    Args:
        field: The field. It need not be smooth: where its gradient jumps or vanishes, the zero is bracketed.
        points: Points (N, D) near the surface.
        reach: Largest distance a point may be moved, a length; None is half the size of the bounds.
        tolerance: Distance from the surface at which a point has arrived; None is 1e-12 of the field's size in
            float64 and 1e-6 in float32 and below.

    Raises:
        SurfaceError: A point does not arrive, or the field is discontinuous where it changes its sign.
    """
    require_field(field).require_points(points)
    reach = field.size / 2 if reach is None else reach
    require_positive("reach", reach, "length")
    if tolerance is not None:
        require_positive("tolerance", tolerance, "length")
    found = place_on_surface(field, points, reach=reach, tolerance=tolerance, thorough=True)
    if bool(found.jumps.any()):
        raise discontinuous(field, found)
    if not bool(found.arrived.all()):
        i = int((~found.arrived).nonzero()[0])
        raise SurfaceError(
            f"{int((~found.arrived).sum())} of {len(points)} points did not reach the surface within {reach:.3g}, the "
            f"first is points[{i}] = {points[i].tolist()}. Start closer to the surface, or raise reach."
        )
    return found.points


def discontinuous(field: Field, found: Placement) -> SurfaceError:
    """Return what to raise where f jumps over zero."""
    i = int(found.jumps.nonzero()[0])
    return SurfaceError(
        f"The field is discontinuous in {field.dtype}: it jumps from one sign to the other without a zero at "
        f"{int(found.jumps.sum())} of {len(found.jumps)} points, as near {found.points[i].tolist()}. A surface f = 0 "
        "needs a continuous field: give the values from before a threshold, a sign or a rounding."
    )


def require_on_surface(field: Field, points: Float[Tensor, "n d"], name: str) -> Float[Tensor, "n d"]:
    """Points placed on the surface, refused where they lie farther from it than a fiftieth of the field's size.

    Args:
        field: The field.
        points: Points (N, D) on the surface, or nearly.
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
