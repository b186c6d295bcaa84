"""Smoothing by geometric flows, of which the first is by mean curvature:

    n . dx/dt = -kappa                       [paper, section 4.4]

One explicit step aims at n . D = -step_size kappa, and is stable up to explicit_step_limit. The implicit step adds
step_size int |grad_surface (n . D)|^2, the change of curvature during the step [Desbrun et al. 1999], and has no such
limit. Other flows are in implicit.edits.flows.

Each step seeks d_theta among combinations of the sensitivities of a few hundred points, spread over the surface and
the space about it: the spectrum of the sensitivities falls so fast that more say little, and the least squares then
costs a tenth.

Where second derivatives of the field do not tell how its surface bends (implicit.sensitivity.pointwise_curvature), the
same is stated on the mesh of the current surface, in weak form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_callable, require_choice, require_positive, require_whole
from implicit.edits.flow_promises import AskedFlow, area_growth, promise_kept
from implicit.edits.flows import Flow, MeanCurvature, WeakFlow
from implicit.edits.regions import Region
from implicit.evolve.constraints import Holding, checked_constraints
from implicit.evolve.edit import Edit, EditStatus, Progress, edit_status, require_options
from implicit.evolve.evolve import evolve
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field, require_field
from implicit.renamed import renamed
from implicit.sensitivity.pointwise_curvature import NormalTurning, normal_turning
from implicit.sensitivity.shape_functionals import Functional, Volume
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, NormalTarget, Smoothness
from implicit.step.mesh_energies import MeshNormalMotion
from implicit.step.off_surface import off_surface
from implicit.step.parameter_basis import spanned
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.surface.quadrature import MeshedSample, SurfaceSample
from implicit.surface.sampling import sample_surface, subsample

# Time of an implicit step in units of the area, where none is given: 86 of them take four fifths of a bunny's volume.
STEP_OF_AREA = 1e-4

# Least damping, relative to the trace. Less of it follows the thin edge of a bunny's ear so closely that it frays, and
# crumbs come off; ten times as much does not keep up with the flow there, and a piece pinches off.
DAMPING = 1e-5

# The sensitivities of a field with jumps in its gradient are each felt by few facets, so that a step in weak form takes
# so many times as many points and directions, and of so few parameters all. Measured on a ReLU network of 7 x 32 whose
# area falls by a quarter in ten steps: 200 directions stay 5 % behind the flow of a mesh, 400 at most 2 %.
WEAK_FACTOR = 2
WEAK_ALL_PARAMETERS = 1500

Curvature = Literal["auto", "pointwise", "weak"]


@dataclass(frozen=True)
class Until:
    """Rule for stopping before the last step, by whatever is met first. None asks for nothing.

    Attributes:
        time: Flow time, a squared length (for Bending its square, for Offset a length over the speed).
        area: The area has come down to this.
        sphericity: It has come up to this; 1 is a ball.
    """

    time: float | None = None
    area: float | None = None
    sphericity: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("time", self.time), ("area", self.area), ("sphericity", self.sphericity)):
            if value is not None:
                require_positive(name, value)

    def met(self, row: Row) -> bool:
        """Return whether a step's record fulfils it."""
        return (
            (self.time is not None and row["time"] >= self.time * (1 - 1e-9))
            or (self.area is not None and row["area"] <= self.area)
            or (self.sphericity is not None and row["sphericity"] >= self.sphericity)
        )


@renamed(off="off_surface_strength")
def smooth(
    field: Field,
    *,
    steps: int,
    step_size: float | None = None,
    method: Literal["implicit", "explicit"] = "implicit",
    flow: Flow | None = None,
    curvature: Curvature = "auto",
    where: Region | None = None,
    constraints: Sequence[Functional] = (),
    holding: Holding | None = None,
    until: Until | None = None,
    off_surface_strength: float = 1e-2,
    restore: float = 0.0,
    points: int = 400,
    directions: int | None = 200,
    damping: float | None = None,
    resolution: int = 48,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Edit:
    """Smooth the surface.

    Args:
        field: The field to edit; the caller's own stays as it is until `edit.field.write_back()`.
        steps: The most steps to take.
        step_size: Time of one step, for mean curvature a squared length: a sphere of radius R shrinks by 2 step_size
            / R (3D). None takes, for the implicit method, 1e-4 of the area (in the plane, of the squared length over
            4 pi); for the explicit one half of explicit_step_limit, if that is less.
        method: "implicit" is stable at any step size, "explicit" is the paper's and half the cost.
        flow: The law of motion, of implicit.edits.flows; None is MeanCurvature().
        curvature: "pointwise" takes it from second derivatives at `points` points, "weak" from the mesh of the current
            surface. "auto" measures on the starting surface whether second derivatives tell how the surface bends,
            and takes the weak form where they do not: of ReLU networks, grids, and operations that torch can
            differentiate only once.
        where: Smooth only here: the region's weight in [0, 1] scales the speed, and the rest is held.
        constraints: Functionals to hold, such as Volume().
        holding: How they are held; None is by hard rows, restored by Newton's method.
        until: When to stop before.
        off_surface_strength: Strength of the energy that lets the field off the surface follow the surface (see
            implicit.step.off_surface).
        restore: Share of the field's deviation from a distance that a step undoes; 0 for fields that are none.
        points: Points at which the flow is prescribed, chosen anew for each step.
        directions: How many sensitivities span the step, three quarters of them on the surface; None takes all
            parameters. The weak form takes twice as many, of twice as many points, or all of up to 1500 parameters.
        damping: Penalty on |d_theta|^2; None adapts it to the linearity error.
        resolution: Of the quadrature of each step, unless `holding` says.
        track: Surface points (M, D) to carry along. Where a piece vanishes they go on from the nearest point.
        progress: Called as progress(step, steps, row) after each step: its number from 1, how many there are, and its
            row of the record, as in Edit.record.
        seed: Of the random points; step k uses seed + k.

    Returns:
        The edit. Each row of its history has the time, volume, area, sphericity, largest curvature, the number of
        pieces and the Euler number after the step, `event` where these two have changed, and `flow` where the step did
        what the flow never does. Where curvature was taken in weak form each row has `curvature`: "weak", and the notes
        say why. The status is NOT_FOLLOWED where the surface stood still though the flow asked for motion, or its area
        grew beyond the error of the quadrature though nothing but the volume was held.

    Raises:
        ValueError: The flow has no weak form, but needs one.
    """
    require_field(field)
    track = field.in_precision(track)
    require_options(field, damping=damping, resolution=resolution, track=track, progress=progress, seed=seed)
    constraints = checked_constraints(constraints)
    require_whole("steps", steps)
    require_choice("method", method, ("implicit", "explicit"))
    require_choice("curvature", curvature, get_args(Curvature))
    _check_numbers(step_size, off_surface_strength, restore, points, directions)
    _check_objects(flow, where, until, holding)
    start = sample_surface(field, points, seed=seed)
    turning = normal_turning(field, start.points)
    weak = curvature == "weak" or (curvature == "auto" and not turning.is_smooth)
    flow = flow or MeanCurvature()
    if weak:
        _require_weak_form(flow, turning)
    holding = holding or Holding(resolution=resolution)
    size = _default_step(field, start, method) if step_size is None else step_size
    operation = SmoothingOperation(
        flow,
        size,
        implicit=method == "implicit",
        where=where,
        until=until or Until(),
        off_surface_strength=off_surface_strength,
        restore=restore,
        points=points,
        directions=directions,
        damping=damping,
        seed=seed,
        weak=weak,
        constraints=constraints,
    )
    edit = evolve(
        field,
        operation,
        start,
        steps=steps,
        constraints=constraints,
        holding=holding,
        changing=True,
        track=track,
        progress=progress,
    )
    broken = promise_kept(field, edit, AskedFlow(flow, size, constraints, where, holding.resolution, turning.is_smooth))
    notes = (*edit.notes, *_form_used(curvature, weak, turning, holding.resolution), *broken)
    return replace(edit, notes=notes, status=edit_status(edit.status, followed=not broken))


def explicit_step_limit(field: Field, *, points: int = 400, directions: int = 200, seed: int = 0) -> float:
    """Return the largest stable step_size of explicit mean-curvature flow, a squared length.

    A step changes the motion u by step_size times its surface Laplacian, so it is stable up to 2 over the largest
    int |grad_surface u|^2 / (int u^2 + damping |d_theta|^2) of the motions that the step can choose from.

    Args:
        field: The field at the start.
        points, directions, seed: Of smooth; the limit is that of its explicit steps with the same ones.
    """
    require_whole("points", points)
    require_whole("directions", directions)
    sample = sample_surface(field, points, seed=seed)
    space = DeformationSpace(field, basis=spanned(field, sample.points, sample.points[:0], directions))
    mass, stiffness = (_gram(energy, space) for energy in _mass_and_stiffness(field, sample))
    mass.diagonal().add_(1e-7 * mass.trace())
    root = torch.linalg.inv(torch.linalg.cholesky(mass))
    return 2 / float(torch.linalg.eigvalsh(root @ stiffness @ root.T)[-1])


def _mass_and_stiffness(field: Field, sample: SurfaceSample) -> tuple[Energy, Energy]:
    """Return int u^2 and int |grad_surface u|^2, on the mesh of the surface where slopes cannot be had at points."""
    if normal_turning(field, sample.points).is_smooth:
        zero = torch.zeros_like(sample.weights)
        return NormalTarget(sample.points, zero, sample.weights), Smoothness(sample.points, sample.weights)
    surface = WeakSurface.extracted(field)
    none, still = np.zeros(len(surface.vertices)), np.ones(len(surface.faces))
    return MeshNormalMotion(surface, none, surface.masses), MeshNormalMotion(surface, none, none, still)


def _gram(energy: Energy, space: DeformationSpace) -> Tensor:
    rows = torch.cat([r.matrix * r.weights.sqrt()[:, None] for r in energy.rows(space)]).double()
    return rows.T @ rows


def _require_weak_form(flow: Flow, turning: NormalTurning) -> None:
    if not callable(getattr(flow, "weak_energies", None)):
        raise ValueError(
            f"The flow {type(flow).__name__} has no weak form (weak_energies), but this field needs one: {turning}. "
            'Give it one as MeanCurvature has, or take the curvature at points all the same: curvature="pointwise".'
        )


def _form_used(curvature: Curvature, weak: bool, turning: NormalTurning, resolution: int) -> list[str]:
    """Return what to know of the form of the curvature; nothing where it is the usual one."""
    if weak:
        asked = "as asked" if curvature == "weak" else str(turning)
        return [f"Curvature was taken in weak form, from the mesh of the surface at {resolution} cells: {asked}."]
    if not turning.is_smooth:
        return [f"Curvature was taken at points, as asked, though {turning}."]
    return []


def _default_step(field: Field, sample: SurfaceSample, method: str) -> float:
    content = float(sample.weights.sum())
    size = STEP_OF_AREA * (content if field.dimension == 3 else content**2 / (4 * math.pi))
    return size if method == "implicit" else min(size, 0.5 * explicit_step_limit(field))


def _check_numbers(
    step_size: float | None, off_surface_strength: float, restore: float, points: int, directions: int | None
) -> None:
    if step_size is not None:
        require_positive("step_size", step_size, "time, for mean curvature a squared length")
    require_positive("off_surface_strength", off_surface_strength, or_zero=True)
    require_positive("restore", restore, or_zero=True)
    require_whole("points", points)
    if directions is not None:
        require_whole("directions", directions)


def _check_objects(flow: object, where: object, until: object, holding: object) -> None:
    if where is not None:
        require_callable("where", where, "a region")
    for name, value, kind in (("until", until, Until), ("holding", holding, Holding)):
        if value is not None and not isinstance(value, kind):
            raise TypeError(f"{name} must be None or made by {kind.__name__}(...), but is {value!r}.")
    if flow is not None and (isinstance(flow, type) or not callable(getattr(flow, "energies", None))):
        raise TypeError(f"flow must be a law of motion such as MeanCurvature() or Bending(), but is {flow!r}.")


@dataclass(frozen=True)
class FlowMemory:
    """Memory of a flow from step to step.

    Attributes:
        time: Of the flow so far.
        least_area: Least area so far; infinite before the first step.
    """

    time: float = 0.0
    least_area: float = math.inf


@dataclass(frozen=True)
class SmoothingOperation:
    """The steps of smooth, for the loop; its options are told of there."""

    flow: Flow
    step_size: float
    implicit: bool
    where: Region | None
    until: Until
    off_surface_strength: float
    restore: float
    points: int
    directions: int | None
    damping: float | None
    seed: int
    weak: bool = False
    constraints: tuple[Functional, ...] = ()

    columns = ("largest_curvature", "curvature", "time", "volume", "area", "sphericity", "flow")

    def start(self, field: Field, points: Tensor) -> FlowMemory:
        """Return the memory before the first step."""
        return FlowMemory()

    def finished(self, state: State[FlowMemory], history: Sequence[Row]) -> EditStatus | None:
        """Return REACHED where the last step's record meets the stopping rule."""
        return EditStatus.REACHED if history and self.until.met(history[-1]) else None

    def step(self, state: State[FlowMemory]) -> StepProblem:
        """Return the problem of this step."""
        field, seed = state.field, self.seed + state.step
        points, count = self.points, self.directions
        if self.weak:
            points *= WEAK_FACTOR
            all_parameters = count is None or len(field.theta) <= WEAK_ALL_PARAMETERS
            count = None if all_parameters or count is None else WEAK_FACTOR * count
        sample = subsample(field, state.sample, points, seed=seed)
        energies, row = self._weak_energies(state) if self.weak else self._energies(field, sample)
        strength = self.off_surface_strength
        away = off_surface(field, sample, strength=strength, restore=self.restore, points=points // 4, seed=seed)
        if strength > 0:
            energies.append(away)
        basis = None if count is None else spanned(field, sample.points, away.points, count)
        return StepProblem(
            DeformationSpace(field, basis=basis),
            energies,
            DampingRule(self.damping, first=DAMPING, least=DAMPING, allowed_error=0.2),
            probe=sample.points[::2],
            row=row,
        )

    def _energies(self, field: Field, sample: SurfaceSample) -> tuple[list[Energy], Row]:
        """Return the flow's energies at the points of a sample, and their record."""
        kappa = field.mean_curvature(sample.points)
        share = torch.ones_like(kappa) if self.where is None else self.where(sample.points)
        energies = [*self.flow.energies(field, sample, kappa, self.step_size, share, self.implicit)]
        return energies, {"largest_curvature": float(kappa.abs().max())}

    def _weak_energies(self, state: State[FlowMemory]) -> tuple[list[Energy], Row]:
        """Return the flow's energies on the mesh of the current surface, and their record."""
        flow, measured = self.flow, state.measured
        if not isinstance(flow, WeakFlow) or measured is None:
            raise ValueError("The weak form takes a flow that has one, and a measured surface.")
        vertices = measured.surface.vertices
        surface = WeakSurface.of(vertices, measured.surface.faces)
        share = torch.ones_like(vertices[:, 0]) if self.where is None else self.where(vertices)
        weights = share.detach().double().cpu().numpy()
        energies = [*flow.weak_energies(surface, self.step_size, weights, self.implicit)]
        return energies, {"largest_curvature": float(abs(surface.mean_curvature).max()), "curvature": "weak"}

    def taken(self, state: State[FlowMemory], taken: Taken) -> Outcome[FlowMemory]:
        """Return the time after the step, and the record of the surface."""
        if taken.surface is None:
            raise ValueError("Smoothing records the surface of each step; call evolve with changing=True.")
        time = state.memory.time + taken.part * self.step_size
        known = taken.values.get("volume")
        volume = Volume().value(taken.field, taken.surface.sample) if known is None else known
        row = surface_record(taken.field, taken.surface, volume)
        least = min(state.memory.least_area, float(state.sample.weights.double().sum()))
        grown = area_growth(self.flow, self.constraints, least, taken.surface)
        after = FlowMemory(time, min(least, row["area"]))
        return Outcome(after, {"time": time, **row, **({} if grown is None else {"flow": grown})})


def surface_record(field: Field, surface: MeshedSample, volume: float) -> Row:
    """Return volume, area and sphericity of a surface; in the plane area, length and roundness."""
    area = float(surface.sample.weights.double().sum())
    if field.dimension == 3:
        round_area = math.pi ** (1 / 3) * (6 * max(volume, 0.0)) ** (2 / 3)
    else:
        round_area = 2 * math.sqrt(math.pi * max(volume, 0.0))
    return {"volume": volume, "area": area, "sphericity": round_area / area}
