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
import math
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_numbers
from implicit.field import Bounds, Field, require_field
from implicit.field_file import load_field
from implicit.models import build, register

__all__ = [
    "BUNDLED",
    "box",
    "bracket",
    "bundled",
    "cactus",
    "capsule",
    "chair",
    "circle",
    "cylinder",
    "dumbbell",
    "ellipsoid",
    "exact_area",
    "exact_volume",
    "rounded_box",
    "smooth_difference",
    "smooth_intersection",
    "smooth_union",
    "sphere",
    "torus",
]

BUNDLED = ("spot", "cactus", "bracket")


# Fitted networks


def bundled(name: str) -> Field:
    """A network of 3 hidden layers of 32 sines fitted to a shape, one of BUNDLED; float32.

    "spot" is Keenan Crane's cow (public domain), "cactus" and "bracket" the shapes of that name in this file.
    How well each fits stands in data/<name>.json; `python -m compare.bundle` makes them again.
    """
    if name not in BUNDLED:
        raise ValueError(f"There is no bundled field {name!r}; there are {', '.join(BUNDLED)}. Choose one of them.")
    with resources.as_file(resources.files("implicit") / "data" / f"{name}.safetensors") as path:
        return load_field(path)


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
    """f = scale (|x - center| - radius), with parameters "radius" and "center".

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
    return _field(_Sphere(radius, center, scale, dtype=dtype), parameters, bounds)


def circle(
    radius: float = 0.5,
    center: Sequence[float] = (0.0, 0.0),
    scale: float = 1.0,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """The sphere of the plane."""
    return sphere(radius, center, scale, dimension=2, dtype=dtype, parameters=parameters, bounds=bounds)


def torus(
    R: float = 0.55,
    r: float = 0.25,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Distance to the torus about the z axis; parameters "R", of its centre line, and "r", of its tube."""
    return _field(_Torus(R, r, dtype=dtype), parameters, bounds)


def box(
    half_lengths: Sequence[float] = (0.5, 0.4, 0.3),
    center: Sequence[float] | None = None,
    edge: float = 0.05,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """A box (a rectangle in the plane) as the smooth intersection of its half spaces, smooth everywhere.

    Args:
        half_lengths: Half the length of each side; their number gives the dimension. Faces lie there but for the edges.
        center: Default the origin.
        edge: Smallest radius of curvature of its edges.
        dtype, parameters, bounds: As for `sphere`.
    """
    center = (0.0,) * len(half_lengths) if center is None else center
    return _field(_Box(half_lengths, center, edge, dtype=dtype), parameters, bounds)


def rounded_box(
    half_lengths: Sequence[float] = (0.5, 0.4, 0.3),
    radius: float = 0.1,
    center: Sequence[float] | None = None,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Distance to a box with edges rounded to a radius within half_lengths. Its curvature jumps along the roundings."""
    center = (0.0,) * len(half_lengths) if center is None else center
    return _field(_RoundedBox(half_lengths, radius, center, dtype=dtype), parameters, bounds)


def capsule(
    a: Sequence[float] = (0.0, -0.4, 0.0),
    b: Sequence[float] = (0.0, 0.4, 0.0),
    radius: float = 0.3,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """Distance to the segment from a to b, less the radius. Its curvature jumps where the caps begin."""
    return _field(_Capsule(a, b, radius, dtype=dtype), parameters, bounds)


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
    """A cylinder with axis from a to b and rims rounded to the radius `edge`, smooth off the axis."""
    return _field(_Cylinder(a, b, radius, edge, dtype=dtype), parameters, bounds)


def ellipsoid(
    radii: Sequence[float] = (0.7, 0.5, 0.4),
    center: Sequence[float] | None = None,
    *,
    dtype: torch.dtype = torch.float64,
    parameters: Iterable[str] | None = None,
    bounds: Bounds | None = None,
) -> Field:
    """An ellipsoid (ellipse in the plane). f has gradient 1 on the surface, and is no distance away from it."""
    center = (0.0,) * len(radii) if center is None else center
    return _field(_Ellipsoid(radii, center, dtype=dtype), parameters, bounds)


# Combinations


def smooth_union(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """All the bodies, with the grooves where they meet rounded to the radius `blend`."""
    return _combine(_SmoothUnion, (first, *others), blend, bounds)


def smooth_intersection(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """What all the bodies share, with the edges where they meet rounded to the radius `blend`."""
    return _combine(_SmoothIntersection, (first, *others), blend, bounds)


def smooth_difference(first: Field, *others: Field, blend: float = 0.1, bounds: Bounds | None = None) -> Field:
    """The first body less all the others, with the edges of the cuts rounded to the radius `blend`."""
    return _combine(_SmoothDifference, (first, *others), blend, bounds)


# Bodies


def cactus(*, dtype: torch.dtype = torch.float64) -> Field:
    """A trunk along y with two bent arms: smooth, thin parts, genus 0."""
    limbs = [
        capsule((0.0, -0.58, 0.0), (0.0, 0.58, 0.0), 0.19, dtype=dtype),
        capsule((0.0, -0.12, 0.0), (-0.46, -0.05, 0.06), 0.11, dtype=dtype),
        capsule((-0.46, -0.05, 0.06), (-0.48, 0.36, 0.1), 0.11, dtype=dtype),
        capsule((0.0, 0.04, 0.0), (0.44, 0.12, -0.08), 0.1, dtype=dtype),
        capsule((0.44, 0.12, -0.08), (0.47, 0.48, -0.1), 0.1, dtype=dtype),
    ]
    return smooth_union(*limbs, blend=0.05)


def bracket(*, dtype: torch.dtype = torch.float64) -> Field:
    """An angle bracket, two plates at right angles with three holes: a mechanical part of genus 3."""
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
    """Two balls on a thin bar along x, which pinches off under mean-curvature flow."""
    balls = [sphere(0.3, (-0.45, 0.0, 0.0), dtype=dtype), sphere(0.3, (0.45, 0.0, 0.0), dtype=dtype)]
    return smooth_union(*balls, capsule((-0.45, 0.0, 0.0), (0.45, 0.0, 0.0), 0.1, dtype=dtype), blend=0.1)


def chair(*, dtype: torch.dtype = torch.float64) -> Field:
    """A seat, a back and four legs, y up."""
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
    """Area of the surface (length of the curve in the plane) at the field's parameters, by formula.

    Known for sphere, circle, torus, capsule and rounded_box.

    Raises:
        TypeError: No formula is known for this shape.
    """
    return _measured(field, "area")


def exact_volume(field: Field) -> float:
    """Volume inside (area in the plane) at the field's parameters, by formula.

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


# The modules


class _Shape(nn.Module):
    """Points (N, D) to values (N,), negative inside; all tensors are parameters."""

    name: str

    def _own(self, dtype: torch.dtype, **values: float | Sequence[float]) -> None:
        for name, value in values.items():
            require_numbers(name, value, "a number, or one for each coordinate")
            self.register_parameter(name, nn.Parameter(torch.as_tensor(value, dtype=dtype)))

    def options(self) -> dict[str, Any]:
        """Arguments of the constructor that are not parameters."""
        return {}

    def describe(self) -> dict[str, Any]:
        """How to make this shape again."""
        own = {name: value.tolist() for name, value in self.named_parameters(recurse=False)}
        return {"name": self.name, "arguments": own | self.options()}

    def extent(self) -> Float[Tensor, "2 d"]:
        """Corners of a box that holds the shape."""
        raise NotImplementedError


def _require_positive(shape: str, **lengths: float | Sequence[float]) -> None:
    for name, length in lengths.items():
        if not bool((require_numbers(name, length, "a positive length, or several") > 0).all()):
            raise ValueError(f"{name} of a {shape} must be positive and finite, but is {length}.")


class _Sphere(_Shape):
    name = "sphere"
    radius: Tensor
    center: Tensor

    def __init__(
        self, radius: float, center: Sequence[float], scale: float = 1.0, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        _require_positive("sphere", radius=radius, scale=scale)
        self._own(dtype, radius=radius, center=center)
        self.scale = float(scale)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return self.scale * (_length(points - self.center) - self.radius)

    def options(self) -> dict[str, Any]:
        return {"scale": self.scale}

    def extent(self) -> Float[Tensor, "2 d"]:
        return torch.stack([self.center - self.radius, self.center + self.radius])

    def exact_area(self) -> Tensor:
        return 4 * math.pi * self.radius**2 if len(self.center) == 3 else 2 * math.pi * self.radius

    def exact_volume(self) -> Tensor:
        return 4 / 3 * math.pi * self.radius**3 if len(self.center) == 3 else math.pi * self.radius**2


class _Torus(_Shape):
    name = "torus"
    R: Tensor
    r: Tensor

    def __init__(self, R: float, r: float, dtype: torch.dtype = torch.float64) -> None:
        super().__init__()
        _require_positive("torus", R=R, r=r)
        if r >= R:
            raise ValueError(f"A torus needs r < R, but r = {r} and R = {R}.")
        self._own(dtype, R=R, r=r)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        ring = _length(points[:, :2]) - self.R
        return _length(torch.stack([ring, points[:, 2]], dim=1)) - self.r

    def extent(self) -> Float[Tensor, "2 3"]:
        upper = torch.stack([self.R + self.r, self.R + self.r, self.r])
        return torch.stack([-upper, upper])

    def exact_area(self) -> Tensor:
        return 4 * math.pi**2 * self.R * self.r

    def exact_volume(self) -> Tensor:
        return 2 * math.pi**2 * self.R * self.r**2


class _Box(_Shape):
    name = "box"
    half_lengths: Tensor
    center: Tensor

    def __init__(
        self, half_lengths: Sequence[float], center: Sequence[float], edge: float, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        _require_positive("box", half_lengths=half_lengths, edge=edge)
        self._own(dtype, half_lengths=half_lengths, center=center)
        self.edge = float(edge)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        x = points - self.center
        return _smooth_max(torch.cat([x - self.half_lengths, -x - self.half_lengths], dim=1), self.edge)

    def options(self) -> dict[str, Any]:
        return {"edge": self.edge}

    def extent(self) -> Float[Tensor, "2 d"]:
        return torch.stack([self.center - self.half_lengths, self.center + self.half_lengths])


class _RoundedBox(_Shape):
    name = "rounded_box"
    half_lengths: Tensor
    radius: Tensor
    center: Tensor

    def __init__(
        self, half_lengths: Sequence[float], radius: float, center: Sequence[float], dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        _require_positive("rounded box", half_lengths=half_lengths, radius=radius)
        if radius > min(half_lengths):
            raise ValueError(f"radius of a rounded box must be at most each of {half_lengths}, but is {radius}.")
        self._own(dtype, half_lengths=half_lengths, radius=radius, center=center)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        q = (points - self.center).abs() - (self.half_lengths - self.radius)
        return _length(q.clamp(min=0)) + q.amax(dim=1).clamp(max=0) - self.radius

    def extent(self) -> Float[Tensor, "2 d"]:
        return torch.stack([self.center - self.half_lengths, self.center + self.half_lengths])

    def exact_area(self) -> Tensor:
        side, r = 2 * (self.half_lengths - self.radius), self.radius  # a box grown by r: Steiner's formula
        if len(side) == 2:
            return 2 * side.sum() + 2 * math.pi * r
        a, b, c = side
        return 2 * (a * b + b * c + c * a) + 2 * math.pi * r * (a + b + c) + 4 * math.pi * r**2

    def exact_volume(self) -> Tensor:
        side, r = 2 * (self.half_lengths - self.radius), self.radius
        if len(side) == 2:
            return side.prod() + 2 * r * side.sum() + math.pi * r**2
        a, b, c = side
        faces = 2 * (a * b + b * c + c * a)
        return a * b * c + faces * r + math.pi * r**2 * (a + b + c) + 4 / 3 * math.pi * r**3


class _Capsule(_Shape):
    name = "capsule"
    a: Tensor
    b: Tensor
    radius: Tensor

    def __init__(
        self, a: Sequence[float], b: Sequence[float], radius: float, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        _require_positive("capsule", radius=radius, length=math.dist(a, b))
        self._own(dtype, a=a, b=b, radius=radius)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        axis = self.b - self.a
        along = ((points - self.a) @ axis / (axis @ axis)).clamp(0, 1)
        return _length(points - self.a - along[:, None] * axis) - self.radius

    def extent(self) -> Float[Tensor, "2 d"]:
        return torch.stack([torch.minimum(self.a, self.b) - self.radius, torch.maximum(self.a, self.b) + self.radius])

    def exact_area(self) -> Tensor:
        length, r = (self.b - self.a).norm(), self.radius
        return 2 * math.pi * r * length + 4 * math.pi * r**2 if len(self.a) == 3 else 2 * length + 2 * math.pi * r

    def exact_volume(self) -> Tensor:
        length, r = (self.b - self.a).norm(), self.radius
        if len(self.a) == 3:
            return math.pi * r**2 * length + 4 / 3 * math.pi * r**3
        return 2 * r * length + math.pi * r**2


class _Cylinder(_Shape):
    name = "cylinder"
    a: Tensor
    b: Tensor
    radius: Tensor

    def __init__(
        self, a: Sequence[float], b: Sequence[float], radius: float, edge: float, dtype: torch.dtype = torch.float64
    ) -> None:
        super().__init__()
        _require_positive("cylinder", radius=radius, edge=edge, length=math.dist(a, b))
        self._own(dtype, a=a, b=b, radius=radius)
        self.edge = float(edge)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        length = (self.b - self.a).norm()
        axis = (self.b - self.a) / length
        x = points - (self.a + self.b) / 2
        along = x @ axis
        across = _length(x - along[:, None] * axis)
        sides = [across - self.radius, along - length / 2, -along - length / 2]
        return _smooth_max(torch.stack(sides, dim=1), self.edge)

    def options(self) -> dict[str, Any]:
        return {"edge": self.edge}

    def extent(self) -> Float[Tensor, "2 3"]:
        axis = (self.b - self.a) / (self.b - self.a).norm()
        reach = self.radius * (1 - axis**2).clamp(min=0).sqrt()  # half width of the end discs
        return torch.stack([torch.minimum(self.a, self.b) - reach, torch.maximum(self.a, self.b) + reach])


class _Ellipsoid(_Shape):
    name = "ellipsoid"
    radii: Tensor
    center: Tensor

    def __init__(self, radii: Sequence[float], center: Sequence[float], dtype: torch.dtype = torch.float64) -> None:
        super().__init__()
        _require_positive("ellipsoid", radii=radii)
        self._own(dtype, radii=radii, center=center)

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        y = (points - self.center) / self.radii
        q = _length(y)
        return q * (q - 1) / _length(y / self.radii)

    def extent(self) -> Float[Tensor, "2 d"]:
        return torch.stack([self.center - self.radii, self.center + self.radii])

    def exact_volume(self) -> Tensor:
        return (4 / 3 if len(self.radii) == 3 else 1) * math.pi * self.radii.prod()


class _Combination(_Shape):
    """Several bodies as one. `parts` are modules, or the descriptions of modules to be made again."""

    def __init__(self, parts: Sequence[nn.Module | dict[str, Any]], blend: float) -> None:
        super().__init__()
        _require_positive(self.name.replace("_", " "), blend=blend)
        self.parts = nn.ModuleList(build(part) if isinstance(part, dict) else part for part in parts)
        self.blend = float(blend)

    def values(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n k"]:
        """f of each part."""
        return torch.stack([part(points) for part in self.parts], dim=1)

    def options(self) -> dict[str, Any]:
        parts: list[_Shape] = list(self.parts)  # type: ignore[arg-type]
        return {"parts": [part.describe() for part in parts], "blend": self.blend}

    def extents(self) -> Float[Tensor, "k 2 d"]:
        """Boxes of the parts."""
        parts: list[_Shape] = list(self.parts)  # type: ignore[arg-type]
        return torch.stack([part.extent() for part in parts])


class _SmoothUnion(_Combination):
    name = "smooth_union"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return -_smooth_max(-self.values(points), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        boxes = self.extents()
        swell = self.blend / 2**0.5 * math.log(len(self.parts))  # where all parts coincide
        return torch.stack([boxes[:, 0].amin(dim=0) - swell, boxes[:, 1].amax(dim=0) + swell])


class _SmoothIntersection(_Combination):
    name = "smooth_intersection"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return _smooth_max(self.values(points), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        boxes = self.extents()
        return torch.stack([boxes[:, 0].amax(dim=0), boxes[:, 1].amin(dim=0)])


class _SmoothDifference(_Combination):
    name = "smooth_difference"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        values = self.values(points)
        return _smooth_max(torch.cat([values[:, :1], -values[:, 1:]], dim=1), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        return self.extents()[0]


_SHAPES: tuple[type[_Shape], ...] = (
    _Sphere,
    _Torus,
    _Box,
    _RoundedBox,
    _Capsule,
    _Cylinder,
    _Ellipsoid,
    _SmoothUnion,
    _SmoothIntersection,
    _SmoothDifference,
)
for _shape in _SHAPES:
    register(_shape.name, _shape)


# Helpers


def _length(vectors: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """|v|, with derivative 0 and not NaN where v = 0."""
    return vectors.square().sum(dim=1).clamp(min=1e-30).sqrt()


def _smooth_max(values: Float[Tensor, "n k"], blend: float) -> Float[Tensor, " n"]:
    # The curve exp(u/t) + exp(v/t) = 1 has its largest curvature, 1 / (t sqrt 2), at u = v = -t log 2.
    t = blend / 2**0.5
    return t * torch.logsumexp(values / t, dim=1)


def _field(module: _Shape, parameters: Iterable[str] | None, bounds: Bounds | None) -> Field:
    return Field(module, parameters=parameters, bounds=_bounds(module) if bounds is None else bounds)


def _bounds(module: _Shape) -> Bounds:
    with torch.no_grad():
        lower, upper = module.extent()
    if not bool((lower < upper).all()):
        raise ValueError(f"The bodies do not meet: their boxes share nothing ({lower.tolist()} to {upper.tolist()}).")
    if float(torch.maximum(-lower, upper).max()) <= 0.95:
        return (-1.0,) * len(lower), (1.0,) * len(lower)
    margin = float((upper - lower).max()) / 4
    return (lower - margin).tolist(), (upper + margin).tolist()


def _combine(kind: type[_Combination], fields: Sequence[Field], blend: float, bounds: Bounds | None) -> Field:
    parts = []
    for i, field in enumerate(fields):
        if require_field(field).module is None or not isinstance(module := _at_theta(field), _Shape):
            raise TypeError(f"{kind.name} takes shapes of this file, but body {i} is none. Join its values yourself.")
        if field.dimension != fields[0].dimension or field.dtype != fields[0].dtype:
            raise ValueError(
                f"Bodies must share dimension and dtype, but body {i} has {field.dimension}, {field.dtype} and the "
                f"first {fields[0].dimension}, {fields[0].dtype}."
            )
        parts.append(module)
    return _field(kind(parts, blend), None, bounds)


def _at_theta(field: Field) -> nn.Module:
    """A copy of the field's module that holds the field's parameters."""
    assert field.module is not None
    module = copy.deepcopy(field.module)
    named = dict(module.named_parameters())
    with torch.no_grad():
        for block in field.layout:
            named[block.name].copy_(field.theta[block.where].view(block.shape))
    return module
