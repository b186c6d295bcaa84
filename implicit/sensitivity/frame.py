"""Directions at a point of the surface, and derivatives in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import parameter_gradient_and_slope


@dataclass(frozen=True, eq=False)
class Frame:
    """The surface's first and second derivatives at some of its points."""

    points: Float[Tensor, "n d"]
    gradients: Float[Tensor, "n d"]
    lengths: Float[Tensor, " n"]  # |df/dx|
    hessians: Float[Tensor, "n d d"]

    @classmethod
    def at(cls, field: Field, points: Float[Tensor, "n d"]) -> Frame:
        """Evaluate the field at the points."""
        gradients, hessians = field.gradient_and_hessian(points)
        return cls(points, gradients, field.gradient_length(gradients), hessians)

    @cached_property
    def normals(self) -> Float[Tensor, "n d"]:
        """Outward unit normals."""
        return self.gradients / self.lengths[:, None]

    @cached_property
    def normal_slopes(self) -> Float[Tensor, "n d d"]:
        """dn/dx, row i the slope of n_i; on the tangent plane it is the shape operator."""
        scaled = self.hessians / self.lengths[:, None, None]
        return scaled - self.normals[:, :, None] * torch.einsum("ni,nij->nj", self.normals, scaled)[:, None, :]

    @cached_property
    def normal_slopes_in_axes(self) -> Float[Tensor, "n d d"]:
        """dn/dx in the axes, the normal last."""
        return self.axes @ self.normal_slopes @ self.axes.transpose(1, 2)

    @property
    def shape_operator(self) -> Float[Tensor, "n t t"]:
        """dn/dx on the tangent plane, in its axes; its eigenvalues are the principal curvatures."""
        return self.normal_slopes_in_axes[:, :-1, :-1]

    @cached_property
    def quotient_rule(self) -> Float[Tensor, "n e e"]:
        """The matrices that take df/dtheta and its slope in space to those of u = -(df/dtheta) / |df/dx|."""
        rule = torch.diag_embed(-1 / self.lengths[:, None].expand(-1, 1 + self.points.shape[1]))
        # Of log |df/dx| the slope is H n / |df/dx|, and u loses its share of it.
        rule[:, 1:, 0] = torch.einsum("nij,nj->ni", self.hessians, self.normals) / self.lengths[:, None].square()
        return rule

    @cached_property
    def axes(self) -> Float[Tensor, "n d d"]:
        """Rows: an orthonormal basis of the tangent plane, then the normal."""
        return axes_of(self.normals)

    def __repr__(self) -> str:
        n, d = self.points.shape
        return f"Frame({n} points in {d} dimensions, {str(self.points.dtype).removeprefix('torch.')})"


def normal_component(vectors: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """Return the part n (n . v) of vectors along the normals."""
    return normals * (normals * vectors).sum(dim=1, keepdim=True)


def tangential_component(vectors: Float[Tensor, "n d"], normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d"]:
    """Return the part (I - n n^T) v of vectors along the surface."""
    return vectors - normal_component(vectors, normals)


def axes_of(normals: Float[Tensor, "n d"]) -> Float[Tensor, "n d d"]:
    """Return as rows an orthonormal basis of the tangent plane, then the normal."""
    n = normals
    if n.shape[1] == 2:
        return torch.stack([torch.stack([-n[:, 1], n[:, 0]], dim=1), n], dim=1)
    least = torch.nn.functional.one_hot(n.abs().argmin(dim=1), 3).to(n)
    first = torch.nn.functional.normalize(torch.linalg.cross(n, least), dim=1)
    return torch.stack([first, torch.linalg.cross(n, first), n], dim=1)


def speed_and_slope(field: Field, frame: Frame) -> Float[Tensor, "n e p"]:
    """Return u = b and, after it, du/dx, (N, 1 + D, P)."""
    return frame.quotient_rule @ parameter_gradient_and_slope(field, frame.points)
