"""Energies that a step minimises: each gives rows of the least squares over the unknowns of a deformation space.

    E_C = int w (n . D - target)^2          reach a prescribed normal displacement       [paper, eq. 4, 5]
    int w (df / scale - target)^2           change the field itself, on the surface or off it
    E_C = int w |D - target|^2              the same for whole vectors
    int w |grad_surface (n . D)|^2          keep the motion even                          [section 4.4, implicit]
    E_K = int |J + J^T|^2                   stay rigid: zero for Killing fields           [paper, section 4.3]

The integrals carry quadrature weights, so a result does not depend on how many points were drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float
from scipy.sparse import csr_array
from torch import Tensor

from implicit.field.field import Field
from implicit.sensitivity.boundary_sensitivity import adjoint, normal_displacement
from implicit.sensitivity.closed_form import factors, fits
from implicit.sensitivity.sparse_rows import sparse_parameter_gradient
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import Operator, Rows
from implicit.step.sparse_equations import SparseRows


class Energy(Protocol):
    """A quadratic energy of the displacement."""

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        """Yield its weighted equations over the unknowns of the space, in blocks."""


@dataclass(frozen=True, eq=False)
class NormalTarget:
    """E_C for motion along the normal: n . D = target at the points."""

    points: Float[Tensor, "n d"]
    target: Float[Tensor, " n"]
    weights: Float[Tensor, " n"]

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        for where, matrix in space.normal_rows(self.points):
            yield Rows(matrix, self.target[where], self.weights[where])

    def of_field(self, field: Field) -> FieldTarget:
        """Return the same as changes of the field: a surface point moves outward by -df / |df/dx|."""
        lengths = field.gradient_length(field.gradient(self.points))
        return FieldTarget(self.points, self.target, self.weights, -lengths)

    def __repr__(self) -> str:
        return _shown(self, f"largest target {_largest(self.target):.3g}")


@dataclass(frozen=True, eq=False)
class FieldTarget:
    """int w (df / scale + u(tied) - target)^2: how the field itself is to change at points anywhere.

    Args:
        points: Anywhere in the bounds, (N, D).
        target: Change of f over the scale, a length if the scale is that of |df/dx|.
        weights: Quadrature weights of the points.
        scale: Units of f to a length (N,).
        tied: Points of the surface (N, D) whose outward motion u is added to the change; None adds nothing.
    """

    points: Float[Tensor, "n d"]
    target: Float[Tensor, " n"]
    weights: Float[Tensor, " n"]
    scale: Float[Tensor, " n"]
    tied: Float[Tensor, "n d"] | None = None

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        for where, matrix in space.value_rows(self.points):
            rows = matrix.div_(self.scale[where, None])
            if self.tied is not None:
                rows += torch.cat([part for _, part in space.normal_rows(self.tied[where])])
            yield Rows(rows, self.target[where], self.weights[where])

    def sparse_rows(self, space: DeformationSpace) -> SparseRows:
        """Return the same equations with a sparse matrix, for fields in which few parameters act at a point."""
        field = space.field
        matrix = _divided(sparse_parameter_gradient(field, self.points), self.scale)
        if self.tied is not None:
            lengths = field.gradient_length(field.gradient(self.tied))
            matrix = csr_array(matrix - _divided(sparse_parameter_gradient(field, self.tied), lengths))
        return SparseRows(matrix, self.target, self.weights)

    def operator(self, space: DeformationSpace) -> Operator:
        """Return the same equations by their products, for networks whose rows do not fit in memory."""
        field, p = space.field, space.parameters
        if fits(field, len(self.points) * (1 if self.tied is None else 2)):
            return self._factored(space)

        def forward(x: Tensor) -> Tensor:
            change = normal_displacement(field, self.points, x[:p], -self.scale)
            return change if self.tied is None else change + normal_displacement(field, self.tied, x[:p])

        def back(weights: Tensor) -> Tensor:
            theta = adjoint(field, self.points, weights, -self.scale)
            if self.tied is not None:
                theta = theta + adjoint(field, self.tied, weights)
            return torch.cat([theta, theta.new_zeros(space.size - p)])

        return Operator(forward, back, self.target, self.weights)

    def _factored(self, space: DeformationSpace) -> Operator:
        """Return `operator`'s answer for a field whose rows are known by their factors."""
        field, p = space.field, space.parameters
        rows = factors(field, self.points).scaled(1 / self.scale)
        if self.tied is not None:
            lengths = field.gradient_length(field.gradient(self.tied))
            rows = rows.plus(factors(field, self.tied).scaled(-1 / lengths))

        def back(weights: Tensor) -> Tensor:
            theta = rows.transposed_times(weights)
            return torch.cat([theta, theta.new_zeros(space.size - p)])

        return Operator(lambda x: rows.times(x[:p]), back, self.target, self.weights, rows.gram)

    def __repr__(self) -> str:
        tied = "" if self.tied is None else ", tied to the surface"
        return _shown(self, f"largest target {_largest(self.target):.3g}{tied}")


def united(field: Field, energies: Iterable[NormalTarget | FieldTarget]) -> list[FieldTarget]:
    """Return the same targets in as few as can be: the untied ones become one, whose Gram matrix is known."""
    targets = [energy.of_field(field) if isinstance(energy, NormalTarget) else energy for energy in energies]
    free = [target for target in targets if target.tied is None]
    tied = [target for target in targets if target.tied is not None]
    if len(free) > 1:
        parts = zip(*((part.points, part.target, part.weights, part.scale) for part in free), strict=True)
        free = [FieldTarget(*(torch.cat(part) for part in parts))]
    return free + tied


@dataclass(frozen=True, eq=False)
class VectorTarget:
    """E_C for whole vectors: D = target at the points."""

    points: Float[Tensor, "n d"]
    target: Float[Tensor, "n d"]
    weights: Float[Tensor, " n"]

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        # Along the normal the parameters alone move the points, along the surface the tangential functions alone.
        for where, matrix in space.normal_rows(self.points):
            along = (self.target[where] * space.field.normal(self.points[where])).sum(dim=1)
            yield Rows(matrix, along, self.weights[where])
        for where, axes, matrix in space.tangent_rows(self.points):
            along = torch.einsum("nai,ni->na", axes, self.target[where])
            weights = self.weights[where].repeat_interleave(along.shape[1])
            yield Rows(matrix.flatten(0, 1), along.flatten(), weights, space.parameters)

    def __repr__(self) -> str:
        return _shown(self, f"largest target {_largest(self.target.norm(dim=1)):.3g}")


@dataclass(frozen=True, eq=False)
class Smoothness:
    """int w |grad_surface (n . D) - target|^2, the second variation of area without its curvature terms.

    Added to a mean-curvature target with the step size as weight it makes the step implicit [Desbrun et al. 1999].

    Args:
        points, weights: Quadrature of the surface.
        target: Slope that the motion is to have, a tangent vector at each point; None is zero.
    """

    points: Float[Tensor, "n d"]
    weights: Float[Tensor, " n"]
    target: Float[Tensor, "n d"] | None = None

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        for where, axes, slopes in space.normal_slope_rows(self.points):
            target = slopes.new_zeros(slopes.shape[:2])
            if self.target is not None:
                target = torch.einsum("nai,ni->na", axes, self.target[where])
            for a in range(slopes.shape[1]):
                yield Rows(slopes[:, a], target[:, a], self.weights[where])

    def __repr__(self) -> str:
        return _shown(self, "towards zero slope" if self.target is None else "towards given slopes")


@dataclass(frozen=True, eq=False)
class Killing:
    """E_K, the strain energy of the displacement, by parts.

    Args:
        points, weights: Quadrature of the surface.
        bending: Weight of the mixed part, tangent with normal: it charges the turning of the normal against
            the turning of the surface, and so resists bending. 1 is the paper's ambient energy.
        thickness: Weight of the normal part, stretch across the surface. 1 is the paper's ambient energy.
        stretch: Weight of the tangential part. With 0 here and for the thickness the bending is left alone. A space
            without tangential part then charges the turning of the surface's normals by the field alone: of a
            distance field 2 |grad_surface u|^2. Rigid motions cost nothing only where the space can slide the points
            along.
    """

    points: Float[Tensor, "n d"]
    weights: Float[Tensor, " n"]
    bending: float = 1.0
    thickness: float = 1.0
    stretch: float = 1.0

    def rows(self, space: DeformationSpace) -> Iterator[Rows]:
        d = self.points.shape[1]
        entries = [(a, b) for a in range(d) for b in range(a, d)]
        # Off the diagonal each entry stands twice in the matrix, so it counts twice.
        shares = {(a, b): (1.0 if a == b else 2.0) * self.share(a, b, d - 1) for a, b in entries}
        used = {entry: share for entry, share in shares.items() if share > 0}
        for where, turned, rest in space.strain_rows(self.points, used):
            for rows, first in ((turned, 0), (rest, space.parameters)):
                weights = self.weights[where].repeat(len(rows))
                yield Rows(rows.flatten(0, 1), torch.zeros_like(weights), weights, first)

    def share(self, a: int, b: int, normal: int) -> float:
        """Return the weight of the entry (a, b), a <= b, of J + J^T in the surface's axes; `normal` is the last."""
        if b < normal:
            return self.stretch
        return self.bending if a < normal else self.thickness

    def __repr__(self) -> str:
        return _shown(self, f"bending={self.bending:g}, thickness={self.thickness:g}, stretch={self.stretch:g}")


def total_energy(energies: Iterable[Energy], space: DeformationSpace, x: Float[Tensor, " s"]) -> float:
    """Return the value of some energies at a displacement, without solving."""
    return float(
        sum(
            (rows.weights * (rows.matrix @ x[rows.columns] - rows.target) ** 2).sum()
            for energy in energies
            for rows in energy.rows(space)
        )
    )


def _shown(energy: NormalTarget | FieldTarget | VectorTarget | Smoothness | Killing, words: str) -> str:
    """Return an energy in one line: its points, their weight and what matters else."""
    points, weight = energy.points, float(energy.weights.sum())
    dtype = str(points.dtype).removeprefix("torch.")
    return f"{type(energy).__name__}({len(points)} points, {dtype}, total weight {weight:.3g}, {words})"


def _divided(rows: csr_array, by: Float[Tensor, " n"]) -> csr_array:
    return csr_array(rows.multiply(1 / by.double().cpu().numpy()[:, None]))


def _largest(values: Tensor) -> float:
    return float(values.abs().max()) if len(values) else 0.0
