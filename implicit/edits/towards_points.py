"""Steps of boundary sensitivity that take a surface the last of the way to given points, its functionals held.

A field that has followed a large deformation is off by its fit, and so are the functionals to hold. Each step moves
the surface along its normals to the points' goals [paper, eq. 4, 5], and then restores the functionals (see
implicit.evolve.evolve), so that both end as near as those of other edits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from implicit.evolve.edit import EditStatus
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.surface.quadrature import SurfaceSample

# Of the energy off the surface beside that on it, as for geometric edits.
OFF_SURFACE_STRENGTH = 1e-2


@dataclass(frozen=True, eq=False)
class TowardsPoints:
    """The operation that takes points of the surface along its normals to their goals.

    Attributes:
        goals: Where the starting points are to be (I, D).
        weights: Area that each stands for (I,).
        damping: Least damping of a step, relative to the trace of its normal matrix.
        seed: Of the random points off the surface.
    """

    columns: ClassVar[tuple[str, ...]] = ()

    goals: Float[Tensor, "i d"]
    weights: Float[Tensor, " i"]
    damping: float
    seed: int

    def start(self, field: Field, points: Tensor) -> None:
        """Return no memory: the steps need none."""

    def finished(self, state: State[None], history: Sequence[Row]) -> EditStatus | None:
        """Return that the edit goes on, up to its last step."""
        return None

    def step(self, state: State[None]) -> StepProblem:
        """Return the problem of a step: the whole way that is left."""
        field, points = state.field, state.points
        normals = field.normal(points)
        gaps = ((self.goals - points) * normals).sum(dim=1)
        sample = SurfaceSample(points, normals, self.weights)
        away = off_surface(field, sample, gaps, strength=OFF_SURFACE_STRENGTH, seed=self.seed + state.step)
        rule = DampingRule(None, first=self.damping, least=self.damping)
        return StepProblem(DeformationSpace(field), [NormalTarget(points, gaps, self.weights), away], rule)

    def taken(self, state: State[None], taken: Taken) -> Outcome[None]:
        """Return nothing to keep or to record."""
        return Outcome(None)
