"""The operation as the loop sees it: what it tells the loop, and what it hears from it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from jaxtyping import Float
from torch import Tensor

from implicit.evolve.constraints import Correction, Measurement
from implicit.evolve.damping import AdaptiveDamping, LinearisationError
from implicit.evolve.edit import EditStatus
from implicit.field.field import Field
from implicit.step.deformation import DeformationSpace
from implicit.step.problem import Row, StepProblem
from implicit.surface.quadrature import MeshedSample, SurfaceSample
from implicit.surface.topology import Topology

Memory = TypeVar("Memory")


@dataclass(frozen=True, eq=False)
class State(Generic[Memory]):
    """State of an edit at the start of a step.

    Attributes:
        field: As edited so far.
        step: Steps taken so far.
        tracked: Points carried along with the surface (I + M, D): the starting points, then the caller's.
        starting: How many of them are starting points, I.
        memory: What the operation needs from step to step.
        measured: The current surface, where it is measured.
        topology: Its pieces, where they are watched.
        damping: From the step before.
        correction: Of the last step's least squares, with the space of its unknowns.
        curved: What the last step changed each held value by beyond the first order; empty where that is not known.
    """

    field: Field
    step: int
    tracked: Float[Tensor, "n d"]
    starting: int
    memory: Memory
    measured: Measurement | None = None
    topology: Topology | None = None
    damping: AdaptiveDamping = dataclasses.field(default_factory=AdaptiveDamping)
    correction: tuple[Correction, DeformationSpace] | None = None
    curved: tuple[float, ...] = ()

    @property
    def points(self) -> Float[Tensor, "i d"]:
        """Starting points, carried along."""
        return self.tracked[: self.starting]

    @property
    def further(self) -> Float[Tensor, "m d"]:
        """The caller's points, carried along."""
        return self.tracked[self.starting :]

    @property
    def sample(self) -> SurfaceSample:
        """Quadrature of the current surface.

        Raises:
            ValueError: The surface is not measured.
        """
        if self.measured is None:
            raise ValueError("The surface is not measured in this edit; call evolve with changing=True.")
        return self.measured.sample


@dataclass(frozen=True, eq=False)
class Taken:
    """A step that was taken.

    Attributes:
        field: After it.
        points: The starting points on its surface (I, D).
        part: Of the solved step that was taken, at most 1.
        error: How far the surface missed where the linear model sent it.
        solves: Tries of the damping.
        surface: After the step, where it is measured.
        values: Of the functionals that are held, by name.
        space: The field's deformation space at the points, where the projection has made one.
    """

    field: Field
    points: Float[Tensor, "i d"]
    part: float
    error: LinearisationError
    solves: int
    surface: MeshedSample | None
    values: Mapping[str, float]
    space: DeformationSpace | None


@dataclass(frozen=True)
class Outcome(Generic[Memory]):
    """An operation's answer to a step that was taken.

    Attributes:
        memory: For the next step.
        row: What it adds to the record of this one.
        steps: How many steps there will be, as far as it knows; None is as many as the loop was told.
    """

    memory: Memory
    row: Row = dataclasses.field(default_factory=dict)
    steps: int | None = None


class Operation(Protocol[Memory]):
    """A user's wish as the loop sees it. No call changes it: what changes is the memory in the state."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of what it adds to the records."""

    def start(self, field: Field, points: Float[Tensor, "i d"]) -> Memory:
        """Return the memory before the first step."""

    def finished(self, state: State[Memory], history: Sequence[Row]) -> EditStatus | None:
        """Return how the edit ended if it is to stop before this step, else None."""

    def step(self, state: State[Memory]) -> StepProblem:
        """Return the problem of this step."""

    def taken(self, state: State[Memory], taken: Taken) -> Outcome[Memory]:
        """Return what to make of the step from this state, now that it is taken."""
