"""Displacements of the surface that an edit may choose from, all linear in a few unknowns.

    D(x) = n u + (I - n n^T) T(x),    u = b . d_theta    normal part, spanned by the parameters
                                      T = phi c          tangential part, spanned by a linear basis (optional)

With s = u - n . T this is D = T + n s, so its Jacobian needs no derivative of the projection:

    J = dT/dx + n (ds/dx)^T + s dn/dx
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import normal_displacement, row_blocks
from implicit.sensitivity.frame import Frame, axes_of, normal_component
from implicit.step.parameter_basis import AllParameters, ParameterBasis
from implicit.step.strain import strain
from implicit.step.tangential_basis import TangentialModel


class DeformationSpace:
    """Displacements of a field's surface, linear in (d_theta, c).

    Args:
        field: Field whose parameters span the normal part.
        tangential: Basis of the tangential part; None allows normal motion alone.
        basis: Changes of the parameters that span the normal part; None is all of them.
    """

    def __init__(
        self,
        field: Field,
        tangential: TangentialModel | None = None,
        basis: ParameterBasis | None = None,
    ) -> None:
        self.field = field
        self.tangential = tangential
        self.basis: ParameterBasis = AllParameters(field) if basis is None else basis
        self.parameters = self.basis.count
        self.size = self.parameters + (field.dimension * tangential.count if tangential is not None else 0)
        self._width = max(self.size, self.basis.width(field))

    @property
    def is_reduced(self) -> bool:
        """True if the normal part is spanned by fewer changes than there are parameters."""
        return not isinstance(self.basis, AllParameters)

    def split(self, x: Float[Tensor, " s"]) -> tuple[Float[Tensor, " p"], Float[Tensor, "d k"] | None]:
        """Return the unknowns as d_theta and the tangential coefficients, one row a coordinate."""
        d_theta = self.basis.change(x[: self.parameters])
        if self.tangential is None:
            return d_theta, None
        return d_theta, x[self.parameters :].view(self.field.dimension, self.tangential.count)

    def displacement(self, points: Float[Tensor, "n d"], x: Float[Tensor, " s"]) -> Float[Tensor, "n d"]:
        """Return D at surface points, a length."""
        d_theta, c = self.split(x)
        n = self.field.normal(points)
        moved = n * normal_displacement(self.field, points, d_theta)[:, None]
        if c is not None and self.tangential is not None:
            T = self.tangential.values(points) @ c.T
            moved = moved + T - normal_component(T, n)
        return moved

    def normal_rows(self, points: Float[Tensor, "n d"]) -> Iterator[tuple[slice, Float[Tensor, "k p"]]]:
        """Yield n . D as rows over the unknowns of the normal part, in blocks of points."""
        start = 0
        for part in row_blocks(points, self._width):
            length = self.field.gradient_length(self.field.gradient(part))
            yield slice(start, start + len(part)), self.basis.rows(self.field, part).div_(-length[:, None])
            start += len(part)

    def value_rows(self, points: Float[Tensor, "n d"]) -> Iterator[tuple[slice, Float[Tensor, "k p"]]]:
        """Yield the change of f itself, at points anywhere, as rows over the unknowns of the normal part, in blocks."""
        start = 0
        for part in row_blocks(points, self._width):
            yield slice(start, start + len(part)), self.basis.rows(self.field, part)
            start += len(part)

    def normal_slope_rows(
        self, points: Float[Tensor, "n d"]
    ) -> Iterator[tuple[slice, Float[Tensor, "k t d"], Float[Tensor, "k t p"]]]:
        """Yield tangent axes (one in the plane, two in space), and the slopes of n . D along them as rows."""
        start = 0
        for part in row_blocks(points, 2 * self.field.dimension * self._width):
            frame = Frame.at(self.field, part)
            rows = self.basis.rows(self.field, part, frame.axes[:, :-1] @ frame.quotient_rule[:, 1:])
            yield slice(start, start + len(part)), frame.axes[:, :-1], rows
            start += len(part)

    def tangent_rows(
        self, points: Float[Tensor, "n d"]
    ) -> Iterator[tuple[slice, Float[Tensor, "k t d"], Float[Tensor, "k t c"]]]:
        """Yield tangent axes, and D along them as rows over the tangential coefficients, if there are any."""
        start = 0
        for part in row_blocks(points, self.field.dimension * self.size):
            axes = axes_of(self.field.normal(part))[:, :-1]
            rows = axes.new_zeros(*axes.shape[:2], 0)
            if self.tangential is not None:
                rows = (axes[:, :, :, None] * self.tangential.values(part)[:, None, None, :]).flatten(2)
            yield slice(start, start + len(part)), axes, rows
            start += len(part)

    def strain_rows(
        self, points: Float[Tensor, "n d"], shares: Mapping[tuple[int, int], float]
    ) -> Iterator[tuple[slice, Float[Tensor, "r k s"], Float[Tensor, "q k t"]]]:
        """Yield weighted entries (a, b) of J + J^T in the surface's own axes (tangents first, normal last), turned.

        The parameters move a point's strain only through the speed u and its slope in space, the tangential functions
        through their values and slopes. So a rotation among a point's entries, which changes no sum of squares, leaves
        all but a few of them free of the parameters: of the five entries without the normal one, two.

        Args:
            shares: Weight of the square of each entry.

        Yields:
            Rows over all unknowns, and rows over the tangential ones alone, whose squares add up to those of the
            entries times their shares.
        """
        start = 0
        last = self.field.dimension - 1
        entries = list(shares)
        roots = torch.tensor([shares[entry] ** 0.5 for entry in entries], dtype=torch.float64).to(self.field.theta)
        # A slope of the speed shows only in the entry of its axis with the normal.
        used = [0, *(1 + a for a in range(last + 1) if (a, last) in shares)]
        touched = min(len(entries), len(used))
        for part in row_blocks(points, (len(entries) + 4) * self._width):
            frame = Frame.at(self.field, part)
            form = strain(frame).entries(entries)
            turn, speed = torch.linalg.qr(roots[:, None] * form.speed_coefficients[:, :, used], mode="complete")
            tangential = torch.einsum("nfe,nfij->neij", turn * roots[:, None], form.tangential_coefficients)
            rows = torch.empty(touched, len(part), self.size, dtype=part.dtype, device=part.device)
            rows[:, :, : self.parameters] = self._speed_rows(frame, speed[:, :touched], used).transpose(0, 1)
            rest = rows.new_zeros(len(entries) - touched, len(part), self.size - self.parameters)
            if self.tangential is not None:
                phi, dphi = self.tangential.values(part), self.tangential.slopes(part)
                functions = torch.cat([phi[:, None], frame.axes @ dphi], dim=1)
                turned = torch.einsum("neij,njk->enik", tangential, functions).flatten(2)
                rows[:, :, self.parameters :] = turned[:touched]
                rest = turned[touched:]
            yield slice(start, start + len(part)), rows, rest
            start += len(part)

    def _speed_rows(
        self, frame: Frame, coefficients: Float[Tensor, "n r j"], used: list[int]
    ) -> Float[Tensor, "n r k"]:
        """Return coefficients . (u, du along the axes)[used] as rows over the unknowns of the normal part."""
        from_field = frame.quotient_rule.clone()
        from_field[:, 1:] = frame.axes @ from_field[:, 1:]
        # Small factors first: the rows of the parameters are the one large product.
        from_field = coefficients @ from_field[:, used]
        return self.basis.rows(self.field, frame.points, from_field)

    def __repr__(self) -> str:
        tangential = 0 if self.tangential is None else self.size - self.parameters
        return f"DeformationSpace({self.parameters} unknowns of the normal part, {tangential} of the tangential part)"
