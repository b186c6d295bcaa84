"""Shapes given by formulas, with few parameters and, where it is known, exact area and volume; and fitted ones.

Each function returns a Field in [-1, 1]^D whose shape fits in [-0.8, 0.8]^D by default, negative inside. The
primitives are distances (or nearly so). Bodies are joined, cut and intersected by one smooth minimum,

    union(f_1 ... f_k) = -t log sum_i exp(-f_i / t),    t = blend / sqrt(2)

which is infinitely often differentiable, unlike min, and rounds the groove between two faces that meet at right
angles with radius `blend` at its narrowest. Intersection and difference are unions of complements.

An analytic shape can only be edited in its own few parameters. To deform one freely, edit a network fitted to it:
`bundled` loads such networks.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence

import torch
from torch import nn

from implicit.arguments import require_numbers
from implicit.field.field import Bounds, Field, require_field
from implicit.shapes.modules import (
    Box,
    Capsule,
    Combination,
    Cylinder,
    Ellipsoid,
    RoundedBox,
    Shape,
    SmoothDifference,
    SmoothIntersection,
    SmoothUnion,
    Sphere,
    Torus,
)

# Primitives


def sphere(
    radius: float = 0.5,
    center: Sequence[float] | None = None,
    scale: float = 1.0,
    *,
    dimension: int = 3,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return f = scale (|x - center| - radius), with parameters "radius" and "center".

    Args:
        radius, center: Of the sphere; the default centre is the origin.
        scale: Any positive factor: f is a distance for 1. It is not a parameter of the field.
        dimension: 3 for a sphere, 2 for a circle.
        dtype: Precision of the field.
        parameters: Which parameters to edit, as for Field.
        bounds: A box that holds the shape. The default is [-1, 1]^D where the shape fits in, else a box around it
            with a quarter of its length to spare on each side.
    """
    center = (0.0,) * dimension if center is None else center
    if require_numbers("center", center, f"{dimension} numbers").shape != (dimension,):
        raise ValueError(f"center must be {dimension} numbers like the dimension, but is {center!r}.")
    return _field(Sphere(radius, center, scale, dtype=dtype), parameters, bounds)


def circle(
    radius: float = 0.5,
    center: Sequence[float] = (0.0, 0.0),
    scale: float = 1.0,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return the circle in the plane, f = scale (|x - center| - radius); arguments as for `sphere`."""
    return sphere(radius, center, scale, dimension=2, dtype=dtype, parameters=parameters, bounds=bounds)


def torus(
    R: float = 0.55,
    r: float = 0.25,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return the distance to the torus about the z axis; parameters "R", of its centre line, and "r", of its tube."""
    return _field(Torus(R, r, dtype=dtype), parameters, bounds)


def box(
    half_lengths: Sequence[float] = (0.5, 0.4, 0.3),
    center: Sequence[float] | None = None,
    edge: float = 0.05,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return a box (a rectangle in the plane) as the smooth intersection of its half spaces, smooth everywhere.

    Args:
        half_lengths: Half the length of each side; their number gives the dimension. Faces lie there but for the edges.
        center: Default the origin.
        edge: Smallest radius of curvature of its edges.
        dtype, parameters, bounds: As for `sphere`.
    """
    center = (0.0,) * len(half_lengths) if center is None else center
    return _field(Box(half_lengths, center, edge, dtype=dtype), parameters, bounds)


def rounded_box(
    half_lengths: Sequence[float] = (0.5, 0.4, 0.3),
    radius: float = 0.1,
    center: Sequence[float] | None = None,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return the distance to a box with edges rounded to a radius; its curvature jumps along the roundings.

    Args:
        half_lengths: Half the length of each side, roundings included; their number gives the dimension.
        radius: Radius of the edges, at most each of half_lengths.
        center: Default the origin.
        dtype, parameters, bounds: As for `sphere`.
    """
    center = (0.0,) * len(half_lengths) if center is None else center
    return _field(RoundedBox(half_lengths, radius, center, dtype=dtype), parameters, bounds)


def capsule(
    a: Sequence[float] = (0.0, -0.4, 0.0),
    b: Sequence[float] = (0.0, 0.4, 0.0),
    radius: float = 0.3,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return the distance to the segment from a to b, less the radius; its curvature jumps where the caps begin.

    Args:
        a, b: Ends of the segment, in 2 or 3 dimensions.
        radius: Radius about the segment, a length.
        dtype, parameters, bounds: As for `sphere`.
    """
    return _field(Capsule(a, b, radius, dtype=dtype), parameters, bounds)


def cylinder(
    a: Sequence[float] = (0.0, -0.5, 0.0),
    b: Sequence[float] = (0.0, 0.5, 0.0),
    radius: float = 0.4,
    edge: float = 0.05,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return a cylinder with rounded rims, smooth off the axis.

    Args:
        a, b: Ends of the axis, at the middles of the end discs.
        radius: Radius about the axis, a length.
        edge: Smallest radius of curvature of the rims.
        dtype, parameters, bounds: As for `sphere`.
    """
    return _field(Cylinder(a, b, radius, edge, dtype=dtype), parameters, bounds)


def ellipsoid(
    radii: Sequence[float] = (0.7, 0.5, 0.4),
    center: Sequence[float] | None = None,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Return an ellipsoid (ellipse in the plane); f has gradient 1 on the surface, and is no distance away from it.

    Args:
        radii: Half axes along the coordinates; their number gives the dimension.
        center: Default the origin.
        dtype, parameters, bounds: As for `sphere`.
    """
    center = (0.0,) * len(radii) if center is None else center
    return _field(Ellipsoid(radii, center, dtype=dtype), parameters, bounds)


# Combinations


def smooth_union(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """Return the union of the bodies, with the grooves where they meet rounded to the radius `blend`."""
    return _combine(SmoothUnion, (first, *others), blend, bounds)


def smooth_intersection(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """Return the intersection of the bodies, with the edges where they meet rounded to the radius `blend`."""
    return _combine(SmoothIntersection, (first, *others), blend, bounds)


def smooth_difference(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """Return the first body less all the others, with the edges of the cuts rounded to the radius `blend`."""
    return _combine(SmoothDifference, (first, *others), blend, bounds)


# Bodies


def cactus(*, dtype: torch.dtype = torch.float64) -> Field:
    """Return a trunk along y with two bent arms: smooth, thin parts, genus 0."""
    limbs = [
        capsule((0.0, -0.58, 0.0), (0.0, 0.58, 0.0), 0.19, dtype=dtype),
        capsule((0.0, -0.12, 0.0), (-0.46, -0.05, 0.06), 0.11, dtype=dtype),
        capsule((-0.46, -0.05, 0.06), (-0.48, 0.36, 0.1), 0.11, dtype=dtype),
        capsule((0.0, 0.04, 0.0), (0.44, 0.12, -0.08), 0.1, dtype=dtype),
        capsule((0.44, 0.12, -0.08), (0.47, 0.48, -0.1), 0.1, dtype=dtype),
    ]
    return smooth_union(*limbs, blend=0.05)


def bracket(*, dtype: torch.dtype = torch.float64) -> Field:
    """Return an angle bracket, two plates at right angles with three holes: a mechanical part of genus 3."""
    plates = smooth_union(
        box((0.62, 0.12, 0.5), (0.08, -0.5, 0.0), 0.05, dtype=dtype),
        box((0.12, 0.57, 0.42), (-0.55, 0.02, 0.0), 0.05, dtype=dtype),
        blend=0.08,
    )
    holes = [
        cylinder((0.26, -0.9, 0.23), (0.26, 0.0, 0.23), 0.13, dtype=dtype),
        cylinder((0.26, -0.9, -0.23), (0.26, 0.0, -0.23), 0.13, dtype=dtype),
        cylinder((-1.0, 0.15, 0.0), (-0.1, 0.15, 0.0), 0.22, dtype=dtype),
    ]
    return smooth_difference(plates, *holes, blend=0.04)


def dumbbell(*, dtype: torch.dtype = torch.float64) -> Field:
    """Return two balls on a thin bar along x, which pinches off under mean-curvature flow."""
    balls = [sphere(0.3, (-0.45, 0.0, 0.0), dtype=dtype), sphere(0.3, (0.45, 0.0, 0.0), dtype=dtype)]
    return smooth_union(*balls, capsule((-0.45, 0.0, 0.0), (0.45, 0.0, 0.0), 0.1, dtype=dtype), blend=0.1)


def chair(*, dtype: torch.dtype = torch.float64) -> Field:
    """Return a seat, a back and four legs, y up."""
    legs = [
        capsule((0.38 * i, -0.72, 0.38 * k), (0.34 * i, -0.05, 0.34 * k), 0.07, dtype=dtype)
        for i in (-1, 1)
        for k in (-1, 1)
    ]
    seat = box((0.46, 0.08, 0.46), (0.0, -0.03, 0.0), 0.04, dtype=dtype)
    back = box((0.46, 0.42, 0.08), (0.0, 0.36, -0.38), 0.04, dtype=dtype)
    return smooth_union(seat, back, *legs, blend=0.05)


# Exact measures


def exact_area(field: Field) -> float:
    """Return the area of the surface (length of the curve in the plane) at the field's parameters, by formula.

    Known for sphere, circle, torus, capsule and rounded_box.

    Raises:
        TypeError: No formula is known for this shape.
    """
    return _measured(field, "area")


def exact_volume(field: Field) -> float:
    """Return the volume inside (area in the plane) at the field's parameters, by formula.

    Known for sphere, circle, torus, capsule, rounded_box and ellipsoid.

    Raises:
        TypeError: No formula is known for this shape.
    """
    return _measured(field, "volume")


def _measured(field: Field, what: str) -> float:
    module = None if require_field(field).module is None else _at_theta(field)
    formula = getattr(module, f"exact_{what}", None)
    if formula is None:
        kind = type(module).__name__.removeprefix("_")
        raise TypeError(
            f"No formula is known for the {what} of a field of a {kind}. Take implicit.integrate for its surface."
        )
    return float(formula())


# Helpers


def _field(module: Shape, parameters: Iterable[str] | None, bounds: Bounds | None) -> Field:
    return Field(module, parameters=parameters, bounds=_bounds(module) if bounds is None else bounds)


def _bounds(module: Shape) -> Bounds:
    with torch.no_grad():
        lower, upper = module.extent()
    if not bool((lower < upper).all()):
        raise ValueError(f"The bodies do not meet: their boxes share nothing ({lower.tolist()} to {upper.tolist()}).")
    if float(torch.maximum(-lower, upper).max()) <= 0.95:
        return (-1.0,) * len(lower), (1.0,) * len(lower)
    margin = float((upper - lower).max()) / 4
    return (lower - margin).tolist(), (upper + margin).tolist()


def _combine(kind: type[Combination], fields: Sequence[Field], blend: float, bounds: Bounds | None) -> Field:
    parts = []
    for i, field in enumerate(fields):
        if require_field(field).module is None or not isinstance(module := _at_theta(field), Shape):
            raise TypeError(f"{kind.name} takes shapes of this file, but body {i} is none. Join its values yourself.")
        if field.dimension != fields[0].dimension or field.dtype != fields[0].dtype:
            raise ValueError(
                f"Bodies must share dimension and dtype, but body {i} has {field.dimension}, {field.dtype} and the "
                f"first {fields[0].dimension}, {fields[0].dtype}."
            )
        parts.append(module)
    return _field(kind(parts, blend), None, bounds)


def _at_theta(field: Field) -> nn.Module:
    """Return a copy of the field's module that holds the field's parameters."""
    assert field.module is not None
    module = copy.deepcopy(field.module)
    named = dict(module.named_parameters())
    with torch.no_grad():
        for block in field.layout:
            named[block.name].copy_(field.theta[block.where].view(block.shape))
    return module
