"""Steps of boundary sensitivity that take a surface the last of the way to the positions of least energy.

A field that has followed a large deformation is off by its fit, and so are the functionals to hold. Each step moves the
surface along its normals to where the vertices are to be [paper, eq. 4, 5], in the metric of their energy
(implicit.step.rigidity_target), and then restores the functionals (see implicit.evolve.evolve), so that these end as
near as those of other edits. With more parameters than MOST the gaps count by area instead, for the least squares then
knows only targets along the normal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from scipy import sparse
from torch import Tensor

from implicit.evolve.edit import EditStatus
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, NormalTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.step.rigidity_target import RigidityTarget
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample

# Of the energy off the surface beside that on it.
OFF_SURFACE_STRENGTH = 0.1
OFF_SURFACE_POINTS = 1000

# Damping of the first step, and the least of later ones, relative to the trace of the normal matrix. A step may miss
# its prediction by so many times its motion: what decides is whether the energy falls.
FIRST_DAMPING, LEAST_DAMPING, ALLOWED = 1e-6, 3e-8, 3.0

# Parameters up to which the metric of the energy is taken: its equations are a matrix.
MOST = 4000


@dataclass(frozen=True, eq=False)
class TowardsPoints:
    """The operation that takes the vertices of a mesh of the surface along its normals to their goals.

    Attributes:
        goals: Where the starting points are to be (V, D).
        weights: Area that each stands for (V,).
        laplacian: L of the energy whose minimum the goals are (V, V).
        seed: Of the random points off the surface.
        firmness: Factor of the damping.
    """

    columns: ClassVar[tuple[str, ...]] = ("strain_left",)

    goals: Float[Tensor, "v d"]
    weights: Float[Tensor, " v"]
    laplacian: sparse.csc_array
    seed: int
    firmness: float = 1.0

    def start(self, field: Field, points: Tensor) -> None:
        """Return no memory: the steps need none."""

    def finished(self, state: State[None], history: Sequence[Row]) -> EditStatus | None:
        """Return that the edit goes on, up to its last step."""
        return None

    def step(self, state: State[None]) -> StepProblem:
        """Return the problem of a step: the whole way that is left."""
        field, target = state.field, self.left(state.field)
        sample = SurfaceSample(target.points, target.normals, self.weights)
        if len(field.theta) > MOST:
            on: Energy = NormalTarget(target.points, target.gaps, self.weights)
            strength = OFF_SURFACE_STRENGTH
        else:
            on = target
            # Strains of the surface are gaps over the spacing.
            strength = OFF_SURFACE_STRENGTH / float(self.weights.mean())
        away = off_surface(
            field, sample, target.gaps, strength=strength, points=OFF_SURFACE_POINTS, seed=self.seed + state.step
        )
        rule = DampingRule(
            None, first=self.firmness * FIRST_DAMPING, least=self.firmness * LEAST_DAMPING, allowed_error=ALLOWED
        )
        row = {"strain_left": target.energy()}
        return StepProblem(DeformationSpace(field), [on, away], rule, row=row)

    def left(self, field: Field) -> RigidityTarget:
        """Return what is left between the field's surface and the goals; of a goal that finds no surface, nothing."""
        points, arrived = newton_to_surface(field, self.goals, reach=field.size / 20)
        points = torch.where(arrived[:, None], points, self.goals)
        slopes = field.gradient(points)
        normals = slopes / slopes.norm(dim=1, keepdim=True).clamp(min=torch.finfo(slopes.dtype).tiny)
        gaps = ((self.goals - points) * normals).sum(dim=1)
        return RigidityTarget(points, normals, gaps, self.laplacian)

    def taken(self, state: State[None], taken: Taken) -> Outcome[None]:
        """Return nothing to keep or to record."""
        return Outcome(None)
