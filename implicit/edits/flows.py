"""Laws of motion for smoothing: the speed of each point along its normal, and what makes one step of it implicit.

| flow | outward speed | lowers |
|---|---|---|
| MeanCurvature | -(kappa - kappa_0) | the area; with kappa_0 the mean of kappa, at fixed volume |
| Bending | surface_laplacian(kappa) + |A|^2 kappa - kappa^3 / 2 | 1/2 int kappa^2, twice Willmore's energy |
| Offset | a constant | nothing: each surface goes to its parallel one |

|A|^2 is the sum of the squared principal curvatures. A step of time t minimises |u|^2 / 2 - t (speed, u) over the
motions u along the normal, an explicit step, to which the implicit one adds a quadratic form of grad_surface u.

Of a field without second derivatives the same integrals are taken over a mesh of its surface, with kappa in weak form
(implicit.sensitivity.weak_curvature): each flow has them as `weak_energies`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_finite
from implicit.field.field import Field
from implicit.sensitivity.frame import Frame, tangential_component
from implicit.sensitivity.weak_curvature import FloatArray, WeakSurface
from implicit.step.energies import Energy, NormalTarget, Smoothness
from implicit.step.mesh_energies import MeshNormalMotion
from implicit.surface.quadrature import SurfaceSample


class Flow(Protocol):
    """A law of motion along the normal."""

    def energies(
        self,
        field: Field,
        sample: SurfaceSample,
        kappa: Float[Tensor, " n"],
        time: float,
        share: Float[Tensor, " n"],
        implicit: bool,
    ) -> Sequence[Energy]:
        """Return the energies that one step minimises.

        Args:
            kappa: Mean curvature at the points of the sample.
            time: Time of the step, in the flow's unit.
            share: Between 0 and 1, how much of the flow's speed each point gets.
            implicit: True adds the implicit part.
        """


@runtime_checkable
class WeakFlow(Protocol):
    """A law of motion that can also be stated on a mesh of the surface, for fields without second derivatives."""

    def weak_energies(self, surface: WeakSurface, time: float, share: FloatArray, implicit: bool) -> Sequence[Energy]:
        """Return the energies that one step minimises, of a mesh's vertices.

        Args:
            surface: Mesh of the current surface.
            time: Time of the step, in the flow's unit.
            share: Between 0 and 1, how much of the flow's speed each vertex gets (V,).
            implicit: True adds the implicit part.
        """


# Largest share of a step by which the change of the curvature on the way may lengthen it.
LARGEST_GROWTH = 0.2


@dataclass(frozen=True)
class MeanCurvature:
    """Mean-curvature flow [paper, section 4.4]; its implicit step adds t int |grad_surface u|^2 [Desbrun et al. 1999].

    A motion u changes kappa by -surface_laplacian(u) - |A|^2 u. The second part, which makes a small sphere shrink ever
    faster, is taken at the middle of the step by both methods: the form |u|^2 is lessened by t / 2 |A|^2 u^2. That
    makes steps of second order where the curvature is even.

    Args:
        level: kappa_0 in speed = -(kappa - kappa_0). Zero is the flow that shrinks; "mean", the average of kappa over
            the surface, keeps the volume by itself [Huisken 1987] and ends at constant mean curvature.
    """

    level: float | Literal["mean"] = 0.0

    def __post_init__(self) -> None:
        if self.level != "mean":
            require_finite("level", self.level, 'curvature or "mean"')

    def energies(
        self, field: Field, sample: SurfaceSample, kappa: Tensor, time: float, share: Tensor, implicit: bool
    ) -> Sequence[Energy]:
        mean = sample.weights @ kappa / sample.weights.sum() if self.level == "mean" else self.level
        left = 1 - (0.5 * time * share * squared_curvatures(field, sample.points)).clamp(max=LARGEST_GROWTH)
        target = NormalTarget(sample.points, -time * share * (kappa - mean) / left, left * sample.weights)
        return [target, Smoothness(sample.points, time * share * sample.weights)] if implicit else [target]

    def weak_energies(self, surface: WeakSurface, time: float, share: FloatArray, implicit: bool) -> Sequence[Energy]:
        masses = surface.masses
        kappa = surface.integrated_curvature / masses  # a density that only its integrals are taken of
        mean = surface.integrated_curvature.sum() / masses.sum() if self.level == "mean" else self.level
        left = 1 - np.minimum(0.5 * time * share * surface.squared_curvatures, LARGEST_GROWTH)
        stiffness = time * surface.on_cells(share) if implicit else None
        return [MeshNormalMotion(surface, -time * share * (kappa - mean) / left, left * masses, stiffness)]


@dataclass(frozen=True)
class Bending:
    """The flow of 1/2 int kappa^2, twice Willmore's energy (kappa is twice the mean of the principal curvatures).

    Its first variation is int (grad_surface kappa . grad_surface u + (kappa^3 / 2 - |A|^2 kappa) u), so the Laplacian
    of kappa is never formed. The fourth-order part is steadied by c int |grad_surface u|^2 with c = sqrt(2 time): then
    1 + c k^2 exceeds time k^4 / 2 for waves up to k^2 = (2 + sqrt(2)) / sqrt(time), and finer ones are the
    network's to damp. Both methods carry it.
    """

    def energies(
        self, field: Field, sample: SurfaceSample, kappa: Tensor, time: float, share: Tensor, implicit: bool
    ) -> Sequence[Energy]:
        total, slope = curvature_slope(field, sample.points)
        slope = tangential_component(slope, sample.normals)
        target = NormalTarget(sample.points, -time * share * (kappa**3 / 2 - total * kappa), sample.weights)
        steady = (2 * time) ** 0.5
        return [target, Smoothness(sample.points, steady * sample.weights, -(time / steady) * share[:, None] * slope)]

    def weak_energies(self, surface: WeakSurface, time: float, share: FloatArray, implicit: bool) -> Sequence[Energy]:
        kappa, total = surface.mean_curvature, surface.squared_curvatures
        slope = np.einsum("mtk,mk->mt", surface.hat_slopes, kappa[surface.faces])
        steady = (2 * time) ** 0.5
        return [
            MeshNormalMotion(
                surface,
                -time * share * (kappa**3 / 2 - total * kappa),
                surface.masses,
                np.full(len(surface.faces), steady),
                -(time / steady) * surface.on_cells(share)[:, None] * slope,
            )
        ]


@dataclass(frozen=True)
class Offset:
    """Motion along the normal at one speed, outward if positive: time times speed is the distance moved."""

    speed: float = 1.0

    def __post_init__(self) -> None:
        require_finite("speed", self.speed)

    def energies(
        self, field: Field, sample: SurfaceSample, kappa: Tensor, time: float, share: Tensor, implicit: bool
    ) -> Sequence[Energy]:
        return [NormalTarget(sample.points, time * share * self.speed, sample.weights)]

    def weak_energies(self, surface: WeakSurface, time: float, share: FloatArray, implicit: bool) -> Sequence[Energy]:
        return [MeshNormalMotion(surface, time * share * self.speed, surface.masses)]


def squared_curvatures(field: Field, points: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
    """Return |A|^2, the sum of the squared principal curvatures (N,), per squared length."""
    return Frame.at(field, points).shape_operator.square().sum(dim=(1, 2))


def curvature_slope(field: Field, points: Float[Tensor, "n d"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n d"]]:
    """Return |A|^2, the sum of the squared principal curvatures (N,), and the gradient of kappa in space (N, D).

    The latter takes third derivatives of f.
    """
    squares, slopes = [], []
    with torch.enable_grad():
        for part in points.split(4096):
            x = part.detach().requires_grad_()
            (g,) = torch.autograd.grad(field.function(field.theta, x).sum(), x, create_graph=True)
            normal = g / g.norm(dim=1, keepdim=True)
            columns = [torch.autograd.grad(normal[:, k].sum(), x, create_graph=True)[0] for k in range(field.dimension)]
            bend = torch.stack(columns, dim=1)  # dn_k/dx_j; its part across the normal is no curvature
            kappa = bend.diagonal(dim1=1, dim2=2).sum(dim=1)
            slopes.append(torch.autograd.grad(kappa.sum(), x)[0])
            n = normal.detach()
            flat = bend.detach() - torch.einsum("nkj,nj,ni->nki", bend.detach(), n, n)
            squares.append(flat.square().sum(dim=(1, 2)))
    return torch.cat(squares), torch.cat(slopes)
