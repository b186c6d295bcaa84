"""The least squares of a step whose motion along the surface is free at each vertex of a mesh (VertexMotion).

Over z, the motion of each vertex along its axes, the energies on the mesh are sparse: z . A z - 2 r . z + constant. The
speeds u of z are those of the parameters, u = B d_theta, and O d_theta is what is asked to be zero off the surface.
With K what is left of A where the motion along the surface is the best for given speeds, and u* = (A^-1 r)_u the speeds
of least energy, the step minimises

    (B d_theta - u*) . K (B d_theta - u*) + |O d_theta - o|^2 + ridge |d_theta|^2.

With S = [B; O] and y = [u*; o] that is d_theta = S^T c, where, one unknown an equation,

    (S S^T + ridge M^-1) c = y,      M^-1 = [K^-1 0; 0 1],     K^-1 v = (A^-1 [v at u])_u.

So one sparse factor of A serves for K, which is never made, and the products S S^T come from the layers, so that the
number of parameters does not matter. Conjugate gradients with the Cholesky factor of S S^T + ridge [1 / A_uu 0; 0 1]
as preconditioner take a few products with A^-1; how far they are from the minimum is told by the dual energy

    ridge (2 y . c - c . (S S^T + ridge M^-1) c)  <=  least energy above that of u*,      equal at the minimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu
from torch import Tensor

from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.energies import Energy, FieldTarget, VectorTarget
from implicit.step.equations import Equations, Rows
from implicit.step.factors import Factor
from implicit.step.factors.cholesky import Cholesky
from implicit.step.factors.traces import estimated_trace, random_signs
from implicit.step.mesh_killing import MeshKilling
from implicit.step.point_rows import PointRows
from implicit.step.symmetric import times
from implicit.step.vertex_motion import VertexMotion

# Added to the diagonal of A, relative to its largest entry: a piece of the surface that nothing holds moves freely.
LEAST = 1e-11

# Distance of the energy from its minimum at which the step is taken, relative to it, and the residual of other solves,
# relative to their right-hand sides. And products with A^-1 that are taken for either at most.
GAP, RESIDUAL = 1e-3, 1e-10
ITERATIONS = 200

# Distance that rounding hides, relative to the energy of a surface that stays: handles that move as one body ask for
# none at all.
ROUNDING = 1e-12

# Scale of a relative damping over the area, in squares of half the field's size: the strains of the default waves have
# this trace where these span the motion along the surface. That of the parameters' own strains would not do: how far a
# field is linear in its parameters, which is what the damping is for, it does not tell, and it is 23,000 over the area
# of the bundled cow, 200 of a network of 16 sines a layer, which take the same damping.
SCALE = 5e5

# Part of random signs that a factor in single precision may leave: what it lacks costs products, not accuracy.
ROUGH = 0.5

# Parameters from which the matrix S S^T in float64 is made once, for a product with it costs less than two with S.
WIDE = 10_000

# Entries of the strain whose weights a step's residual is relative to, as at points: three along the surface, and two
# that bend it.
ENTRIES = 5


@dataclass(frozen=True, eq=False)
class VertexEnergy:
    """z . A z - 2 r . z + constant, of the motion z of the vertices along their axes (tangents first).

    Attributes:
        matrix: A (3 V, 3 V), symmetric and positive semidefinite.
        force: r (3 V,).
        constant: So that the least value of what is asked for is a sum of squares.
        weight: Sum of the weights of these squares.
    """

    matrix: sparse.csc_array
    force: FloatArray
    constant: float
    weight: float

    def value(self, z: FloatArray) -> float:
        """Return the energy of a motion."""
        return float(z @ (self.matrix @ z) - 2 * (self.force @ z)) + self.constant

    @cached_property
    def factor(self) -> SuperLU | None:
        """Triangular factor of A, a little stiffer; None where that is singular."""
        matrix, diagonal = self.matrix.copy(), self.matrix.diagonal()
        matrix.setdiag(diagonal + LEAST * diagonal.max())
        try:
            return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # a pivot is exactly zero
            return None


def vertex_equations(space: VertexMotion, energies: Iterable[Energy]) -> VertexEquations:
    """Return the equations of a step of energies on the mesh, at its vertices, and of the field off it.

    Raises:
        TypeError: An energy is of another kind.
        ValueError: One is at points that are no vertices.
    """
    on: list[MeshKilling | VectorTarget] = []
    off: list[FieldTarget] = []
    for energy in energies:
        if isinstance(energy, FieldTarget):
            off.append(energy)
        elif isinstance(energy, (MeshKilling, VectorTarget)):
            on.append(energy)
        else:
            raise TypeError(
                "Motion that is free at each vertex takes energies of a mesh, targets for vectors and targets of the "
                f"field, but was given a {type(energy).__name__}."
            )
    theta = space.field.theta
    targets = torch.cat([theta[:0], *(target.weights.sqrt() * target.target for target in off)])
    weight = float(sum(target.weights.sum() for target in off))
    return VertexEquations(space, _on_mesh(space, on), _rows(space, off), targets, weight)


def _on_mesh(space: VertexMotion, energies: Iterable[MeshKilling | VectorTarget]) -> VertexEnergy:
    """Return the sum of energies of the vertices."""
    count, axes = len(space.points), _double(space.axes)
    matrix: sparse.csc_array | None = None
    force, stiffness, constant, weight = np.zeros((count, 3)), np.zeros(count), 0.0, 0.0
    for energy in energies:
        if isinstance(energy, MeshKilling):
            found = energy.matrix(axes)
            matrix = found if matrix is None else matrix + found
            weight += ENTRIES * float(energy.surface.contents.sum())
            continue
        at, weights, target = space.vertices_at(energy.points), _double(energy.weights), _double(energy.target)
        np.add.at(stiffness, at, weights)
        np.add.at(force, at, weights[:, None] * np.einsum("nax,nx->na", axes[at], target))
        constant += float(weights @ (target**2).sum(axis=1))
        weight += 3 * float(weights.sum())
    matrix = sparse.csc_array((3 * count, 3 * count)) if matrix is None else matrix
    matrix.setdiag(matrix.diagonal() + np.repeat(stiffness, 3))
    return VertexEnergy(matrix, force.ravel(), constant, weight)


def _rows(space: VertexMotion, targets: Iterable[FieldTarget]) -> PointRows:
    """Return S: the speeds of the vertices, then the targets of the field by the roots of their weights."""
    lengths = space.gradient_lengths
    points, own = [space.points], [-1 / lengths]
    tied, other = [lengths[:0]], [torch.zeros(0, dtype=torch.int64, device=lengths.device)]
    for target in targets:
        root = target.weights.sqrt()
        points.append(target.points)
        own.append(root / target.scale)
        free = target.tied is None
        tied.append(torch.zeros_like(root) if free else root)
        at = np.zeros(len(root), dtype=np.int64) if target.tied is None else space.vertices_at(target.tied)
        other.append(_on(root, at))
    return PointRows.of(space.field, torch.cat(points), torch.cat(own), torch.cat(tied), torch.cat(other))


def _double(tensor: Tensor) -> FloatArray:
    return np.asarray(tensor.detach().double().cpu().numpy())


def _on(like: Tensor, numbers: NDArray[Any]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(numbers)).to(like.device)


class VertexEquations(Equations):
    """The equations of a step: energies on the mesh, and those of the parameters off it.

    Args:
        space: The motions to choose from.
        energy: On the mesh.
        rows: S, one row a vertex and then one an equation off the surface, weighted.
        targets: o, weighted as these are (M,).
        weight: Sum of their weights.
    """

    def __init__(
        self, space: VertexMotion, energy: VertexEnergy, rows: PointRows, targets: Float[Tensor, " m"], weight: float
    ) -> None:
        super().__init__(space.size, space.field.theta)
        self.space, self.energy, self.rows, self.targets = space, energy, rows, targets.double()
        force = _on(self.right, energy.force).view(-1, 3)
        self.asked = torch.cat([force[:, 2], self.targets])
        self.right = torch.cat([rows.transposed(self.asked), force[:, :2].flatten()])
        self.weight = energy.weight + weight
        self._grams: dict[torch.dtype, Tensor] = {}

    def add(self, rows: Rows) -> None:
        """Refuse further equations: those of a price on functionals have no place here.

        Raises:
            TypeError: Always.
        """
        raise TypeError(
            f"A step with motion free at each vertex takes no further equations, but was given {rows!r}. Hold "
            "functionals by hard rows, or give the edit a tangential basis."
        )

    @cached_property
    def stiffness(self) -> Float[Tensor, " q"]:
        """Diagonal of A of the speeds, and 1 for each equation off the surface."""
        of_speeds = _on(self.right, self.energy.matrix.diagonal()).view(-1, 3)[:, 2]
        return torch.cat([of_speeds, torch.ones_like(self.targets)])

    def _gram(self, dtype: torch.dtype) -> Float[Tensor, "q q"]:
        """Return the lower triangle of S S^T, which serves every damping; of many parameters by that in float64."""
        if dtype not in self._grams:
            wide = dtype != torch.float64 and self.space.parameters >= WIDE
            self._grams[dtype] = self._gram(torch.float64).to(dtype) if wide else self.rows.gram(dtype)
        return self._grams[dtype]

    def products(self, c: Float[Tensor, " q"]) -> Float[Tensor, " q"]:
        """Return S S^T c."""
        known = self._grams.get(torch.float64)
        return self.rows.times(self.rows.transposed(c)) if known is None else times(known, c)

    def trace(self) -> float:
        """Return the scale that a relative damping refers to, see SCALE."""
        space = self.space
        return SCALE * float(space.surface.contents.sum()) / (space.field.size / 2) ** 2

    def objective(self, x: Float[Tensor, " s"]) -> float:
        d_theta, along = self.space.split(x.double())
        made = self.rows.times(d_theta)
        z = torch.cat([along, made[: len(along), None]], dim=1).flatten().cpu().numpy()
        return max(0.0, self.energy.value(z) + float((made[len(along) :] - self.targets).square().sum()))

    def factorise(self, ridge: Float[Tensor, " n"]) -> Factor | None:
        """Return the inverse with the ridge of the parameters; the motion along the surface has none."""
        damping = float(ridge[0])
        if damping <= 0 or self.energy.factor is None:
            return None
        for dtype in (torch.float32, torch.float64):
            damped = self._gram(dtype).clone()
            damped.diagonal().add_((damping / self.stiffness).to(dtype))
            near = Cholesky.of(damped)
            if near is not None and (dtype == torch.float64 or self._is_inverse(near, damping)):
                return VertexFactor(self, near, self.energy.factor, damping)
        return None

    def _is_inverse(self, near: Cholesky, damping: float) -> bool:
        """Return whether a factor in single precision will do: what it leaves of random signs, relative to these."""
        signs = random_signs(len(self.stiffness), 1, self.seed)[:, 0].to(self.right)
        found = near.solve(signs[:, None])[:, 0]
        left = signs - self.products(found) - damping / self.stiffness * found
        return float(left.norm() / signs.norm()) < ROUGH

    def __repr__(self) -> str:
        return f"VertexEquations({self.space!r}, {len(self.targets)} equations off the surface)"


class VertexFactor(Factor):
    """The inverse of a step's damped normal matrix by conjugate gradients, near to an inverse that is factored.

    Args:
        equations: Of the step.
        near: Factor of S S^T + ridge / stiffness.
        mesh: Factor of A.
        damping: The ridge.
    """

    name = "vertices"

    def __init__(self, equations: VertexEquations, near: Cholesky, mesh: SuperLU, damping: float) -> None:
        self._equations, self._near, self._mesh, self._damping = equations, near, mesh, damping
        self.condition = near.condition()
        self.gap = float("nan")  # of the last minimiser, relative to its energy

    def _compliant(self, forces: Float[Tensor, " q"], along: FloatArray | None = None) -> tuple[Tensor, Tensor]:
        """Return M^-1 of forces, and the motion of the vertices along the surface under these (V, 2).

        Args:
            forces: On the speeds, and off the surface.
            along: Further ones along the surface (V, 2).
        """
        count = len(self._equations.space.points)
        load = np.zeros((count, 3))
        load[:, 2] = forces[:count].cpu().numpy()
        if along is not None:
            load[:, :2] = along
        z = torch.from_numpy(self._mesh.solve(load.ravel())).to(forces.device).view(count, 3)
        return torch.cat([z[:, 2], forces[count:]]), z[:, :2]

    def _precondition(self, residual: Float[Tensor, " q"]) -> Tensor:
        return self._near.solve(residual[:, None])[:, 0]

    def _solve(
        self, y: Float[Tensor, " q"], enough: Callable[[Tensor, Tensor, Tensor, Tensor], bool]
    ) -> tuple[Tensor, Tensor]:
        """Return c with (S S^T + ridge M^-1) c = y, and the motion along the surface under the forces c.

        Args:
            enough: Whether to stop, of c, what is left of y, S S^T c, and that motion.
        """
        # At what the factored inverse makes of y the speeds are near already. Conjugate gradients from zero would begin
        # at the multiple of it that is the best for the dual energy, which is not nearly as good for the energy itself.
        c = self._precondition(y)
        image = self._equations.products(c)
        yielding, along = self._compliant(c)
        left = y - image - self._damping * yielding
        toward = direction = self._precondition(left)
        square = float(left @ toward)
        for _ in range(ITERATIONS):
            if not square > 0 or enough(c, left, image, along):
                return c, along
            product = self._equations.products(direction)
            yielding, aside = self._compliant(direction)
            full = product + self._damping * yielding
            stiff = float(direction @ full)
            if not stiff > 0:  # rounding has made the factor of A indefinite
                break
            length = square / stiff
            c, image, left = c + length * direction, image + length * product, left - length * full
            along = along + length * aside
            toward = self._precondition(left)
            new = float(left @ toward)
            direction, square = toward + (new / square) * direction, new
        self.converged = False
        return c, along

    def minimiser(self, right: Float[Tensor, " n"], target: Float[Tensor, " k"]) -> Float[Tensor, " n"]:
        equations, damping = self._equations, self._damping
        y, free = self._compliant(equations.asked, equations.energy.force.reshape(-1, 3)[:, :2])
        count = len(free)

        def value(along: Tensor, made: Tensor) -> float:
            """Return the energy, undamped, of a motion along the surface and of what the parameters make."""
            z = torch.cat([along, made[:count, None]], dim=1).flatten().cpu().numpy()
            return equations.energy.value(z) + float((made[count:] - equations.targets).square().sum())

        least, at_rest = value(free, y), value(torch.zeros_like(free), torch.zeros_like(y))

        def enough(c: Tensor, left: Tensor, image: Tensor, along: Tensor) -> bool:
            primal = value(free - damping * along, image) + damping * float(c @ image)
            dual = least + damping * float(y @ c + c @ left)
            self.gap = (primal - dual) / max(abs(primal), 1e-300)
            return primal - dual <= max(GAP * abs(primal), ROUNDING * at_rest)

        c, along = self._solve(y, enough)
        return torch.cat([equations.rows.transposed(c), (free - damping * along).flatten()])

    def inverse(self, right: Float[Tensor, "n m"]) -> Float[Tensor, "n m"]:
        return torch.stack([self._one(column) for column in right.T], dim=1)

    def _one(self, right: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Return H^-1 right.

        The part of it that the rows make, S^T a, is taken out first, for what is subtracted of the rest loses as many
        digits as the damping is below the trace: with right = S^T a + b and the forces f along the surface,
        d_theta = S^T c + b / ridge, (S S^T + ridge M^-1) c = M^-1 a + (A^-1 f)_u - S b / ridge.
        """
        equations, damping = self._equations, self._damping
        rows, (of_theta, along) = equations.rows, equations.space.split(right)
        a = self._precondition(rows.times(of_theta))
        beyond = (of_theta - rows.transposed(a)) / damping
        yielding, at_rest = self._compliant(a, along.cpu().numpy())
        y = yielding - rows.times(beyond)
        goal = RESIDUAL * float(y.norm())
        c, aside = self._solve(y, lambda c, left, image, along: float(left.norm()) <= goal)
        return torch.cat([rows.transposed(c) + beyond, (at_rest - damping * aside).flatten()])

    def fitted(self, speeds: Float[Tensor, " v"]) -> Float[Tensor, " p"]:
        """Return a change of the parameters that moves the vertices nearly by such speeds, and nothing off them."""
        equations = self._equations
        y = torch.cat([speeds.double(), torch.zeros_like(equations.targets)])
        return equations.rows.transposed(self._precondition(y)).to(equations.like)

    def rank(self) -> float:
        """Estimate the trace of S S^T (S S^T + ridge / stiffness)^-1, and the motion along the surface beside it."""
        count, tangential = len(self._near), 2 * len(self._equations.space.points)
        ridge = self._damping / self._equations.stiffness
        lost = estimated_trace(count, lambda z: ridge[:, None] * self._near.solve(z), ridge, self._equations.seed)
        return min(float(count), max(0.0, count - lost)) + tangential
