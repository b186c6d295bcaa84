"""The modules of the analytic shapes: f of each, its extent, and its description."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from implicit.arguments import require_numbers
from implicit.models.registry import build, register


class Shape(nn.Module):
    """Module from points (N, D) to values (N,), negative inside; all tensors are parameters."""

    name: str

    def _own(self, dtype: torch.dtype, **values: float | Sequence[float]) -> None:
        for name, value in values.items():
            require_numbers(name, value, "a number, or one for each coordinate")
            self.register_parameter(name, nn.Parameter(torch.as_tensor(value, dtype=dtype)))

    def __repr__(self) -> str:
        own = {name: _rounded(value) for name, value in self.named_parameters(recurse=False)}
        return (
            f"{type(self).__name__}({', '.join(f'{name}={value}' for name, value in (own | self.options()).items())})"
        )

    def options(self) -> dict[str, Any]:
        """Return the arguments of the constructor that are not parameters."""
        return {}

    def describe(self) -> dict[str, Any]:
        """Return the name and the arguments that make this shape again."""
        own = {name: value.tolist() for name, value in self.named_parameters(recurse=False)}
        return {"name": self.name, "arguments": own | self.options()}

    def extent(self) -> Float[Tensor, "2 d"]:
        """Return the corners of a box that holds the shape."""
        raise NotImplementedError


def _require_positive(shape: str, **lengths: float | Sequence[float]) -> None:
    for name, length in lengths.items():
        if not bool((require_numbers(name, length, "a positive length, or several") > 0).all()):
            raise ValueError(f"{name} of a {shape} must be positive and finite, but is {length}.")


class Sphere(Shape):
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


class Torus(Shape):
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


class Box(Shape):
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


class RoundedBox(Shape):
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


class Capsule(Shape):
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


class Cylinder(Shape):
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


class Ellipsoid(Shape):
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


class Combination(Shape):
    """Several bodies as one. `parts` are modules, or the descriptions of modules to be made again."""

    def __init__(self, parts: Sequence[nn.Module | dict[str, Any]], blend: float) -> None:
        super().__init__()
        _require_positive(self.name.replace("_", " "), blend=blend)
        self.parts = nn.ModuleList(build(part) if isinstance(part, dict) else part for part in parts)
        self.blend = float(blend)

    def __repr__(self) -> str:
        kinds = list(dict.fromkeys(type(part).__name__ for part in self.parts))
        return f"{type(self).__name__}({len(self.parts)} bodies: {', '.join(kinds)}; blend={self.blend:g})"

    def values(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n k"]:
        """Return f of each part."""
        return torch.stack([part(points) for part in self.parts], dim=1)

    def options(self) -> dict[str, Any]:
        parts: list[Shape] = list(self.parts)  # type: ignore[arg-type]
        return {"parts": [part.describe() for part in parts], "blend": self.blend}

    def extents(self) -> Float[Tensor, "k 2 d"]:
        """Return the boxes of the parts."""
        parts: list[Shape] = list(self.parts)  # type: ignore[arg-type]
        return torch.stack([part.extent() for part in parts])


class SmoothUnion(Combination):
    name = "smooth_union"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return -_smooth_max(-self.values(points), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        boxes = self.extents()
        swell = self.blend / 2**0.5 * math.log(len(self.parts))  # where all parts coincide
        return torch.stack([boxes[:, 0].amin(dim=0) - swell, boxes[:, 1].amax(dim=0) + swell])


class SmoothIntersection(Combination):
    name = "smooth_intersection"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        return _smooth_max(self.values(points), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        boxes = self.extents()
        return torch.stack([boxes[:, 0].amax(dim=0), boxes[:, 1].amin(dim=0)])


class SmoothDifference(Combination):
    name = "smooth_difference"

    def forward(self, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        values = self.values(points)
        return _smooth_max(torch.cat([values[:, :1], -values[:, 1:]], dim=1), self.blend)

    def extent(self) -> Float[Tensor, "2 d"]:
        return self.extents()[0]


SHAPES: tuple[type[Shape], ...] = (
    Sphere,
    Torus,
    Box,
    RoundedBox,
    Capsule,
    Cylinder,
    Ellipsoid,
    SmoothUnion,
    SmoothIntersection,
    SmoothDifference,
)


def _rounded(value: Tensor) -> float | list[float]:
    """Return the numbers of a parameter to six digits, as text shows them."""
    digits = [float(f"{number:.6g}") for number in value.detach().reshape(-1).tolist()]
    return digits[0] if value.ndim == 0 else digits


def _length(vectors: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Return |v|, with derivative 0 and not NaN where v = 0."""
    return vectors.square().sum(dim=1).clamp(min=1e-30).sqrt()


def _smooth_max(values: Float[Tensor, "n k"], blend: float) -> Float[Tensor, " n"]:
    # The curve exp(u/t) + exp(v/t) = 1 has its largest curvature, 1 / (t sqrt 2), at u = v = -t log 2.
    t = blend / 2**0.5
    return t * torch.logsumexp(values / t, dim=1)


for _shape in SHAPES:
    register(_shape.name, _shape)
