"""Vector fields that can slide points along the surface: what normal motion alone cannot do.

A tangential model is a linear space of smooth vector fields T(x) = sum_k phi_k(x) c_k, the same scalar
functions phi for each coordinate. Because it is linear, the tangential part of a rigid edit joins the same
least squares as the parameters; the paper trains a second network instead.
"""

from __future__ import annotations

from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field


class TangentialModel(Protocol):
    """Scalar functions whose coefficients, one a coordinate, make a vector field."""

    @property
    def count(self) -> int:
        """Number K of scalar functions."""

    def values(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n k"]:
        """Return phi at the points, as many columns as functions."""

    def slopes(self, points: Float[Tensor, "n d"]) -> Float[Tensor, "n d k"]:
        """Return dphi/dx at the points."""


class CosineFeatures:
    """1, the coordinates, and cosines of random waves cos(w . x + phase), w normal with deviation `frequency`.

    The first D + 1 functions make all affine fields, rigid motions among them, exactly representable. The waves
    approximate a Gaussian process with length scale 1 / frequency (Rahimi & Recht, NeurIPS 2007).

    Args:
        field: Field whose dimension and device they have; x is measured in halves of the field's size.
        waves: Number of cosines.
        frequency: Standard deviation of the wave vectors; 8 suits shapes that fill the bounds.
        seed: Seed of the random waves.
    """

    def __init__(self, field: Field, *, waves: int = 600, frequency: float = 8.0, seed: int = 0) -> None:
        generator = torch.Generator().manual_seed(seed)
        self._center = field.bounds.mean(dim=0)
        self._half = field.size / 2
        directions = torch.randn(field.dimension, waves, generator=generator, dtype=torch.float64) * frequency
        self._directions = directions.to(field.theta)
        self._phases = (2 * torch.pi * torch.rand(waves, generator=generator, dtype=torch.float64)).to(field.theta)

    def _to(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return x, the wave vectors and the phases in the precision of points: an edit may run in a finer one."""
        x = (points - self._center.to(points)) / self._half
        return x, self._directions.to(points), self._phases.to(points)

    @property
    def count(self) -> int:
        return 1 + self._directions.shape[0] + self._directions.shape[1]

    def values(self, points: Tensor) -> Tensor:
        x, directions, phases = self._to(points)
        waves = torch.cos(x @ directions + phases)
        return torch.cat([torch.ones_like(x[:, :1]), x, waves], dim=1)

    def slopes(self, points: Tensor) -> Tensor:
        x, directions, phases = self._to(points)
        waves = -torch.sin(x @ directions + phases)[:, None, :] * directions
        n, dimension = points.shape
        straight = torch.eye(dimension, dtype=points.dtype, device=points.device).expand(n, -1, -1)
        return torch.cat([straight.new_zeros(n, dimension, 1), straight, waves], dim=2) / self._half

    def __repr__(self) -> str:
        d, waves = self._directions.shape
        dtype = str(self._directions.dtype).removeprefix("torch.")
        return f"CosineFeatures({waves} waves in {d} dimensions, {self.count} functions, {dtype})"
