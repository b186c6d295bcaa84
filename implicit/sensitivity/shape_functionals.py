"""Shape functionals: numbers that belong to a surface, and how they change with the parameters.

    volume integral  H = int_inside h dV     dH/dtheta = int h b dA                       [paper, eq. 7]
    surface integral G = int_surface g dA    dG/dtheta = int (dg/dn + kappa g) b dA       [paper, eq. 7]

b is the boundary sensitivity, kappa = div n, in weak form where the field has no second derivatives that tell it
(implicit.sensitivity.weak_curvature). Volume is h = 1, area is g = 1. In the plane they are area and
length. Any of them can be held during an edit, at a value or within a bound.

A quadrature whose points lie on curved cells is off by the cells' distance delta = -f / |df/dx| from the surface. One
evaluation of the field at the points takes that out: with c the cosine between the normals of cell and surface,

    H = H_cells + int_cells h c delta dA          G = int_cells g(x + delta n) c (1 + kappa delta) dA

which leaves 3e-8 of the volume of the bundled cow at 64 cells, where the cells alone leave 1.3e-5.

The error of a value is estimated from the values on two coarser grids, and from what none of them can show: parts of
the surface that pass between the nodes of the grid (implicit.surface.unseen).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field as default
from typing import ClassVar, Literal, get_args, overload

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_callable, require_choice, require_finite, require_positive, require_whole
from implicit.field.field import Field, SurfaceError
from implicit.sensitivity.boundary_sensitivity import adjoint
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.sensitivity.weak_curvature import surface_mean_curvature
from implicit.surface.extraction import require_resolution
from implicit.surface.quadrature import MeshedSample, SurfaceSample, require_sample
from implicit.surface.refined_quadrature import MOST_REFINED, refined_quadrature
from implicit.surface.unseen import Unseen, unseen_parts

Density = Callable[[Tensor], Tensor]
Bound = Literal["equal", "at least", "at most"]
Values = tuple[float, ...]


# An error on so many times as large cells is larger by this power of it, or more, of volumes: the quadrature is of the
# fourth order where the cells follow the surface, but of none in the few that do not. The area in such a cell is off by
# more than the volume: with the third power it is above the estimate on 14 of 200 random shapes.
LEAST_ORDER = 3
LEAST_ORDER_OF_AREAS = 2


class Functional(ABC):
    """A number that belongs to a surface, and how it is to be held.

    Attributes:
        target: The value to hold; None is the value at the start.
        bound: "equal" holds the value at the target, "at least" and "at most" on one side of it.
    """

    target: float | None
    bound: Bound
    least_order: ClassVar[int] = LEAST_ORDER_OF_AREAS  # of the quadrature, as its errors are estimated

    def __post_init__(self) -> None:
        if self.target is not None:
            require_finite("target", self.target)
        require_choice("bound", self.bound, get_args(Bound))

    def __repr__(self) -> str:
        target, bound = getattr(self, "target", None), getattr(self, "bound", "equal")  # a user's class may lack them
        held = [] if target is None else [f"target={target:g}"]
        if bound != "equal":
            held.append(f"bound={bound!r}")
        return f"{type(self).__name__}({', '.join([*self._arguments(), *held])})"

    def _arguments(self) -> list[str]:
        """Return the arguments that tell one functional of this kind from another, as in its repr."""
        return []

    @property
    def name(self) -> str:
        """Name of the functional in records."""
        return type(self).__name__.lower()

    @abstractmethod
    def value(self, field: Field, sample: SurfaceSample) -> float:
        """Return the functional of the field's surface, integrated over the sample."""

    def value_on(self, field: Field, meshed: MeshedSample) -> float:
        """Return the functional as the steps of an edit measure it, in a third of the time where there is a way.

        Estimates of errors are of `value`: on cells that do not follow the surface this may be further off.
        """
        return self.value(field, meshed.sample)

    @abstractmethod
    def shape_gradient(self, field: Field, sample: SurfaceSample) -> Float[Tensor, " n"]:
        """Return its change per unit of outward motion and of area, at each point."""

    def unseen(self, value: float, sample: SurfaceSample, parts: Unseen) -> float:
        """Return about how much of the functional is in parts of the surface that the sample has not.

        Args:
            value: The functional on the sample.
            sample: Of the surface that was meshed.
            parts: What was not, measured roughly.
        """
        area, volume = float(sample.weights.sum()), float(volume_terms(sample).sum())
        share = max(float(parts.areas.sum()) / area, float(parts.volumes.sum()) / abs(volume))
        return share * abs(value)

    def sensitivity(self, field: Field, sample: SurfaceSample) -> Float[Tensor, " p"]:
        """Return its derivative by each parameter, (P,): B^T times the weighted shape gradient."""
        require_sample(field, sample)
        return adjoint(field, sample.points, sample.weights * self.shape_gradient(field, sample))


@dataclass(frozen=True, repr=False)
class Volume(Functional):
    """Volume inside the surface (area inside the curve, in the plane), by the divergence theorem.

    Args:
        target, bound: Value to hold, None for that at the start, and the side of it, as in Functional.
    """

    least_order: ClassVar[int] = LEAST_ORDER
    target: float | None = None
    bound: Bound = "equal"

    def value(self, field: Field, sample: SurfaceSample) -> float:
        off = _Distance.of(field, sample)
        return float((volume_terms(sample) + off.weights * off.distance).double().sum())

    def value_on(self, field: Field, meshed: MeshedSample) -> float:
        sample, slopes = meshed.sample, meshed.slopes
        if slopes is None or type(self).value is not Volume.value:
            return self.value(field, sample)
        # The distance is of third order in the cell, so that a slope from the nodes leaves errors of the fifth.
        limit = field.size / 100
        distance = (-field.value(sample.points) / slopes).clamp(-limit, limit)
        return float((volume_terms(sample) + sample.weights * distance).double().sum())

    def shape_gradient(self, field: Field, sample: SurfaceSample) -> Tensor:
        return torch.ones_like(sample.weights)

    def unseen(self, value: float, sample: SurfaceSample, parts: Unseen) -> float:
        return float(parts.volumes.sum())


@dataclass(frozen=True, repr=False)
class Area(Functional):
    """Area of the surface (length of the curve, in the plane).

    Args:
        target, bound: Value to hold, None for that at the start, and the side of it, as in Functional.
    """

    target: float | None = None
    bound: Bound = "equal"

    def value(self, field: Field, sample: SurfaceSample) -> float:
        off = _Distance.of(field, sample)
        return float(off.surface_weights(field, sample).double().sum())

    def shape_gradient(self, field: Field, sample: SurfaceSample) -> Tensor:
        return surface_mean_curvature(field, sample.points)

    def unseen(self, value: float, sample: SurfaceSample, parts: Unseen) -> float:
        return float(parts.areas.sum())


@dataclass(frozen=True, eq=False, repr=False)
class VolumeIntegral(Functional):
    """Integral of a density over the inside.

    Args:
        h: From points (N, D) to values (N,), smooth on the whole of the field's bounds, not on the inside alone.
        target, bound: Value to hold, None for that at the start, and the side of it, as in Functional.
        nodes: Gauss points along each ray in the antiderivative; exact for polynomials h of degree up to
            2 nodes - D.
    """

    least_order: ClassVar[int] = LEAST_ORDER
    h: Density
    target: float | None = None
    bound: Bound = "equal"
    nodes: int = default(default=8)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_callable("h", self.h, "a function from points (N, D) to values (N,)")
        require_whole("nodes", self.nodes)

    def _arguments(self) -> list[str]:
        return [_name_of(self.h)]

    def value(self, field: Field, sample: SurfaceSample) -> float:
        require_sample(field, sample)
        # The field F(x) = (x - c) int_0^1 t^(D-1) h(c + t (x - c)) dt has div F = h, so int h = int F . n.
        center = field.bounds.mean(dim=0)
        arm = sample.points - center
        gauss, weight = np.polynomial.legendre.leggauss(self.nodes)
        total = torch.zeros_like(sample.weights)
        for t, w in zip((gauss + 1) / 2, weight / 2, strict=True):
            total += w * t ** (field.dimension - 1) * _density(self.h, center + t * arm, "h")
        off = _Distance.of(field, sample)
        beyond = off.weights * off.distance * _density(self.h, sample.points, "h")
        return float((sample.weights * total * (arm * sample.normals).sum(dim=1) + beyond).double().sum())

    def shape_gradient(self, field: Field, sample: SurfaceSample) -> Tensor:
        return _density(self.h, sample.points, "h")

    def unseen(self, value: float, sample: SurfaceSample, parts: Unseen) -> float:
        return float(parts.volumes @ _density(self.h, parts.points, "h").abs())


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceIntegral(Functional):
    """Integral of a density over the surface.

    Args:
        g: From points (N, D) to values (N,), differentiable by torch.
        target, bound: Value to hold, None for that at the start, and the side of it, as in Functional.
    """

    g: Density
    target: float | None = None
    bound: Bound = "equal"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_callable("g", self.g, "a function from points (N, D) to values (N,)")

    def _arguments(self) -> list[str]:
        return [_name_of(self.g)]

    def value(self, field: Field, sample: SurfaceSample) -> float:
        off = _Distance.of(field, sample)
        density = _density(self.g, sample.points + off.distance[:, None] * off.normals, "g")
        return float((off.surface_weights(field, sample) * density).double().sum())

    def shape_gradient(self, field: Field, sample: SurfaceSample) -> Tensor:
        with torch.enable_grad():
            x = sample.points.detach().requires_grad_()
            values = _density(self.g, x, "g")
            slope = torch.autograd.grad(values.sum(), x)[0] if values.requires_grad else torch.zeros_like(x)
        return (slope * sample.normals).sum(dim=1) + surface_mean_curvature(field, sample.points) * values.detach()

    def unseen(self, value: float, sample: SurfaceSample, parts: Unseen) -> float:
        return float(parts.areas @ _density(self.g, parts.points, "g").detach().abs())


@dataclass(frozen=True)
class Integral:
    """A functional's value, and an estimate of its error.

    Attributes:
        value: The value.
        error: Estimate of its error, in the same unit: above the error on 95 of 100 random unions of bodies.
        resolution: Cells along the longest side of the bounds on which it was measured.
        unseen: The part of the error that stands for pieces of the surface between the nodes of the grid.
    """

    value: float
    error: float
    resolution: int | None = None
    unseen: float = 0.0


def require_functional(name: str, value: object) -> None:
    """Refuse what is no functional."""
    if not isinstance(value, Functional):
        raise TypeError(f"{name} must be a functional such as Volume() or Area(), but is {value!r}.")


# The coarser grids that a value is compared with, in cells of its own; with one alone, two errors agree by chance in a
# fifth of all shapes.
COARSER = (2 / 3, 1 / 2)

# Powers by which they are taken to be further off where cells of the grid are refined. There errors are of single
# cells, and fall by fits and starts: the next coarser grid may be little worse; half the cells see next to nothing of
# some thin part, but guard against two errors that agree by chance.
REFINED_ORDERS = (1, 4)

# What the estimate allows for beyond the sum of its parts.
MARGIN = 2.0


@overload
def integrate(
    field: Field,
    functional: Functional,
    resolution: int = 64,
    *,
    tolerance: float | None = None,
    finest: int = 256,
) -> Integral: ...


@overload
def integrate(
    field: Field,
    functional: Sequence[Functional],
    resolution: int = 64,
    *,
    tolerance: float | None = None,
    finest: int = 256,
) -> tuple[Integral, ...]: ...


def integrate(
    field: Field,
    functional: Functional | Sequence[Functional],
    resolution: int = 64,
    *,
    tolerance: float | None = None,
    finest: int = 256,
) -> Integral | tuple[Integral, ...]:
    """Return the functional of the field's surface, with an estimate of its error.

    The estimate has two parts. The values on grids of two thirds and a half of the cells are off by more, at least with
    the third power of the cell; the larger of the errors that this tells is taken. And where the field says that the
    surface passes between the nodes of the grid (a fin, a gap, a spike) what is missed is measured roughly and added.

    Args:
        field: The field.
        functional: Volume(), Area() or another; a list or tuple of them is measured on the same points, which is what
            takes the time, and comes back as a tuple in its order.
        resolution: Cells along the longest side of the bounds.
        tolerance: Relative error to come to: where the estimate is above it, half as many cells again are taken until
            it is not, or up to `finest`. None measures once.
        finest: The most cells along the longest side.

    Raises:
        SurfaceError: There is no surface in the bounds, it leaves them, or the gradient vanishes on it.
        TypeError: It is no functional.
    """
    several = isinstance(functional, list | tuple)
    functionals = tuple(functional) if isinstance(functional, list | tuple) else (functional,)
    for k, one in enumerate(functionals):
        require_functional(f"functional[{k}]" if several else "functional", one)
    require_resolution("resolution", resolution)
    require_resolution("finest", finest)
    if tolerance is not None:
        require_positive("tolerance", tolerance)
    known: dict[int, Values] = {}
    while True:
        meshed = refined_quadrature(field, resolution)
        known[resolution] = tuple(one.value(field, meshed.sample) for one in functionals)
        found = with_errors(field, functionals, meshed, resolution, known)
        finer = next_finer(resolution, finest)
        within = tolerance is None or all(one.error <= tolerance * abs(one.value) for one in found)
        if within or finer == resolution:
            return found if several else found[0]
        resolution = finer


def next_finer(resolution: int, finest: int) -> int:
    """Return half as many cells again, but not more than the finest; the same where there are none finer."""
    return max(resolution, min(-(-3 * resolution // 2), finest))


def with_errors(
    field: Field, functionals: Sequence[Functional], meshed: MeshedSample, resolution: int, known: dict[int, Values]
) -> tuple[Integral, ...]:
    """Return functionals of a field's surface with estimates of their errors, as integrate does.

    Args:
        field: The field.
        functionals: What is measured.
        meshed: Its quadrature at the resolution.
        resolution: Cells along the longest side of the bounds.
        known: The values of the functionals on this and maybe other grids, by cells; those that are taken are added.
    """
    values = known[resolution]
    errors = [0.0] * len(values)
    most = 1.0 if meshed.refined else MOST_REFINED  # like is compared with like
    for share, order in zip(COARSER, REFINED_ORDERS, strict=True):
        cells = max(4, round(share * resolution))
        if cells == resolution:
            continue
        orders = [order if meshed.refined else functional.least_order for functional in functionals]
        gains = [(resolution / cells) ** power - 1 for power in orders]
        try:
            if cells not in known:
                sample = refined_quadrature(field, cells, most=most).sample
                known[cells] = tuple(functional.value(field, sample) for functional in functionals)
        except SurfaceError:  # such coarse cells may not even have a surface: then nothing bounds the error
            errors = [max(e, abs(v)) for e, v in zip(errors, values, strict=True)]
            continue
        told = [abs(v - o) / gain for v, o, gain in zip(values, known[cells], gains, strict=True)]
        errors = [max(pair) for pair in zip(errors, told, strict=True)]
    parts = unseen_parts(field, meshed)
    unseen = [
        c.unseen(v, meshed.sample, parts) if len(parts) else 0.0 for c, v in zip(functionals, values, strict=True)
    ]
    return tuple(
        Integral(value, MARGIN * (error + missed), resolution, missed)
        for value, error, missed in zip(values, errors, unseen, strict=True)
    )


@dataclass(frozen=True, eq=False)
class _Distance:
    """Distance from the points of a sample to the surface, to first order."""

    distance: Float[Tensor, " n"]  # along the normal of the field, outward
    normals: Float[Tensor, "n d"]  # of the field
    weights: Float[Tensor, " n"]  # of the sample, times the cosine between the two normals

    @classmethod
    def of(cls, field: Field, sample: SurfaceSample) -> _Distance:
        require_sample(field, sample)
        value, gradient = field.value_and_gradient(sample.points)
        slope = field.gradient_length(gradient)
        normals = gradient / slope[:, None]
        # Where two sheets come close the field's slope vanishes between them, and the first order means nothing.
        limit = field.size / 100
        distance = (-value / slope).clamp(-limit, limit)
        return cls(distance, normals, sample.weights * (normals * sample.normals).sum(dim=1))

    def surface_weights(self, field: Field, sample: SurfaceSample) -> Tensor:
        """Return the sample's weights on the surface."""
        if not normal_turning(field, sample.points).is_smooth:
            return self.weights  # between its edges such a surface is as good as flat
        # The distance is far below a cell, so that single precision of the curvature leaves errors below 1e-10.
        curvature = field.to(torch.float32).mean_curvature(sample.points.to(torch.float32))
        return self.weights * (1 + curvature.to(self.weights) * self.distance)


def volume_terms(sample: SurfaceSample) -> Float[Tensor, " n"]:
    """Return each point's share x . n / D of the volume, about the centroid so that distant shapes lose no digits."""
    center = (sample.weights @ sample.points) / sample.weights.sum()
    return sample.weights * ((sample.points - center) * sample.normals).sum(dim=1) / sample.points.shape[1]


def _name_of(function: Density) -> str:
    return str(getattr(function, "__name__", type(function).__name__))


def _density(function: Density, points: Tensor, name: str) -> Tensor:
    values = function(points)
    if not isinstance(values, Tensor) or values.shape != points.shape[:1]:
        came = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
        raise ValueError(f"{name} must give one value a point, shape ({len(points)},), but gave {came}.")
    if not bool(torch.isfinite(values).all()):
        raise ValueError(f"{name} must be finite on the surface and inside, but is not at all points. Mend it there.")
    return values
