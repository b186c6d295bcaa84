"""Rigid editing: the handles go where they are told, and the rest follows as rigidly as the field allows.

Each step minimises E_K + alpha E_C over the parameters and the coefficients of a tangential basis together
[paper, section 4.3]: E_K = int |J + J^T|^2 is zero just for infinitesimal rigid motions (Killing fields). The paper
trains a second network for the tangential part; a linear basis makes each step one least squares.

What the handles ask of the shape as a whole, the rigid motion that fits their goals best, is done first, and exactly,
where the network is a plain one; the steps have only the rest to do.

A wide network's step is sought among combinations of the sensitivities of some points, a narrow one's among all
parameters. All is computed in float64: the damping that suits these systems is below what single precision resolves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.handles import Handle
from implicit.edits.rigid_placement import Placement
from implicit.edits.targets import checked_handles
from implicit.evolve.constraints import checked_constraints
from implicit.evolve.edit import Edit, Progress, require_options
from implicit.evolve.evidence import with_evidence
from implicit.evolve.evolve import evolve
from implicit.field.field import Field, require_field
from implicit.sensitivity.moved_as_a_whole import moved_as_a_whole
from implicit.sensitivity.shape_functionals import Area, Functional, Volume
from implicit.step.deformation import DeformationSpace, spanned
from implicit.step.energies import Energy, Killing, VectorTarget
from implicit.step.off_surface import off_surface
from implicit.step.problem import Row, State, StepProblem
from implicit.step.tangential_basis import CosineFeatures, TangentialModel
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import carrying_points
from implicit.surface.soundness import field_soundness

# Damping of a step relative to the trace of its normal matrix. Ten times less lets ripples in, which cost strain as
# soon as a motion is not small; ten times more holds the surface back. What is not linear in a step falls with the
# square of its motion, so where handles go less far than SMALL of the field's size the damping falls with the motion,
# down to the share LEAST.
DAMPING = 1e-8
SMALL = 0.004
LEAST = 0.1

# Of the energy off the surface beside the strain. It costs a small motion less than half a per cent of tangential
# energy. Without it stray pieces stand round a bar twisted by 135 degrees.
OFF_SURFACE_STRENGTH = 0.3

# Up to so many parameters, all are unknowns. Of more, a step is sought among the combinations of the sensitivities of
# some points: the normal matrix grows with the square of the unknowns, and the spectrum of the sensitivities falls so
# fast that all 8641 parameters of a network of 64 sines a layer leave 1 % less energy than 1500 combinations. These
# are kept as a matrix, of at most so many numbers; with fewer combinations the motion gets stiff.
ALL_PARAMETERS = 4000
COMBINATIONS = 1500
FEWEST_COMBINATIONS = 500
NUMBERS = 100_000_000


def rigid_edit(
    field: Field,
    handles: Sequence[Handle],
    *,
    steps: int = 1,
    alpha: float = 1e3,
    bending: float = 0.1,
    thickness: float = 0.0,
    tangential: TangentialModel | None = None,
    points: int | SurfaceSample = 2000,
    damping: float | None = None,
    off_surface_strength: float = OFF_SURFACE_STRENGTH,
    constraints: Sequence[Functional] = (),
    resolution: int = 48,
    track: Float[Tensor, "m d"] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
) -> Edit:
    """Move handles and let the rest follow rigidly.

    Args:
        field: A field in 3D; the caller's own stays as it is until `edit.field.write_back()`.
        handles: Regions with their motions, anchors among them as zero vectors. Weights scale the penalty.
        steps: Sub-steps; handles with a RigidMotion rotate along their path. Take one per 15 degrees or so.
        alpha: Weight of the handles' squared error against the strain energy, per squared length. Both energies are
            integrals over the surface.
        bending, thickness: Weights of the parts of E_K (see implicit.step.energies.Killing). The paper's energy has
            1 for both; what lies off the surface then costs as much as strain on it. The default leaves half the
            tangential energy on the bundled cow, with the same handles.
        tangential: Basis of the motion along the surface; None takes CosineFeatures(field).
        points: How many points carry the energies, spread as far apart as can be, or the sample itself.
        damping: Penalty on the squares of the unknowns; None adapts it to the linearity error.
        off_surface_strength: How firmly the field away from the surface is tied to the surface's motion, see
            implicit.step.off_surface. 0 leaves it alone.
        constraints: Functionals to hold, such as Volume().
        resolution: Of the quadrature that measures the constraints, and of the pieces of the surface that are counted.
        track: Further surface points (M, D) to carry along.
        progress: Called after each step.
        seed: Of the random points and features.

    Returns:
        The edit. `before` and `after` say how sound the field is, `notes` what has become worse, and whether the points
        are too few to see the strain.

    Raises:
        ValueError: The field is not 3D, a region misses the surface, or the handles leave a rigid motion free
            (fewer than three points that are not on one line).
    """
    require_options(field, damping=damping, resolution=resolution, progress=progress, seed=seed)
    constraints = checked_constraints(constraints)
    if track is not None:
        field.to(torch.float64).require_points(field.to(torch.float64).in_precision(track), "track")
    settings = RigidSettings(steps, alpha, bending, thickness, damping, off_surface_strength, seed)
    precise, sample, operation = prepare(field, handles, settings, tangential, points)
    tracked = None if track is None else track.to(precise.theta)
    before = field_soundness(field, resolution)
    whole = operation.placement(1.0)
    if _can_be_placed(precise, whole, sample, constraints):
        start = whole.field(precise)
        operation.begin_at(whole)
    else:
        start, whole = precise, Placement.none(sample.points)
    edit = evolve(
        start,
        operation,
        whole.sample(sample),
        steps=steps,
        constraints=constraints,
        resolution=resolution,
        track=None if tracked is None else whole.at(tracked),
        wanted=operation.wanted() + sample.points - whole.at(sample.points),
        progress=progress,
    )
    edit = replace(
        edit,
        field=edit.field.to(field.dtype),
        points=sample.points,
        normals=sample.normals,
        displacement=edit.points + edit.displacement - sample.points,
        wanted=operation.wanted(),
        notes=(*edit.notes, *operation.notes(len(field.theta))),
    )
    return with_evidence(edit, before, resolution)


def _can_be_placed(field: Field, whole: Placement, sample: SurfaceSample, constraints: Sequence[Functional]) -> bool:
    """Whether the field can first be moved as a whole: no constraint may feel it, and it must stay in its bounds."""
    if not all(isinstance(constraint, (Volume, Area)) for constraint in constraints):
        return False
    if moved_as_a_whole(field, whole.rotation, whole.translation) is None:
        return False
    moved = whole.at(sample.points)
    lower, upper = field.bounds + 0.01 * field.size * torch.tensor([[1.0], [-1.0]]).to(field.theta)
    return bool(((moved > lower) & (moved < upper)).all())


@dataclass(frozen=True)
class RigidSettings:
    """What the steps of a rigid edit weigh; see there."""

    steps: int
    alpha: float
    bending: float
    thickness: float
    damping: float | None
    off_surface_strength: float
    seed: int

    def __post_init__(self) -> None:
        require_whole("steps", self.steps)
        require_positive("alpha", self.alpha)
        for name in ("bending", "thickness", "off_surface_strength"):
            require_positive(name, getattr(self, name), or_zero=True)


def prepare(
    field: Field,
    handles: Sequence[Handle],
    settings: RigidSettings,
    tangential: TangentialModel | None,
    points: int | SurfaceSample,
) -> tuple[Field, SurfaceSample, RigidOperation]:
    """The field in float64, the points that carry the energies, and what each step minimises; see rigid_edit."""
    if require_field(field).dimension != 3:
        raise ValueError(f"rigid_edit needs a field in 3 dimensions, but this one has {field.dimension}.")
    handles = checked_handles(handles)
    if tangential is not None and not callable(getattr(tangential, "slopes", None)):
        raise TypeError(f"tangential must be None or a model such as CosineFeatures(field), but is {tangential!r}.")
    most = NUMBERS // FEWEST_COMBINATIONS
    if len(field.theta) > most:
        raise ValueError(
            f"The field has {len(field.theta):,} parameters; a rigid edit takes up to {most:,}. Edit some "
            "of them alone, such as those of the last layers: Field(module, parameters=[...])."
        )
    precise = field.to(torch.float64)
    points = points.to(torch.float64) if isinstance(points, SurfaceSample) else points
    sample = carrying_points(precise, points, "farthest", seed=settings.seed)
    model = CosineFeatures(precise, seed=settings.seed) if tangential is None else tangential
    return precise, sample, RigidOperation(handles, sample, settings, model)


class RigidOperation:
    """What the steps of a rigid edit minimise, for the loop."""

    def __init__(
        self, handles: list[Handle], sample: SurfaceSample, settings: RigidSettings, tangential: TangentialModel
    ) -> None:
        self._handles, self._sample, self._settings, self._tangential = handles, sample, settings, tangential
        self._weights = [handle.weights(sample.points) for handle in handles]
        self._total = torch.stack(self._weights).sum(dim=0) if handles else torch.zeros_like(sample.weights)
        for k, weights in enumerate(self._weights):
            if not bool((weights > 0).any()):
                raise ValueError(
                    f"No point of the surface lies in the region of handles[{k}]. The surface spans "
                    f"{sample.points.amin(dim=0).tolist()} to {sample.points.amax(dim=0).tolist()}; move or widen it."
                )
        _require_rigid_motion_fixed(sample.points[self.held])
        self._begin: Placement | None = None

    @property
    def held(self) -> Tensor:
        """Which points the handles hold, (I,) bool."""
        return self._total > 0

    def goal(self, fraction: float) -> Tensor:
        """Where the held points are to be after the fraction; where handles overlap, their weighted mean."""
        total = torch.zeros_like(self._sample.points)
        for handle, weights in zip(self._handles, self._weights, strict=True):
            total += weights[:, None] * handle.position(fraction, self._sample.points, self._sample.normals)
        return total / self._total.clamp(min=torch.finfo(total.dtype).tiny)[:, None]

    def placement(self, fraction: float) -> Placement:
        """The rigid motion that takes the held points nearest to their goals after the fraction."""
        held = self.held
        weights = (self._sample.weights * self._total)[held]
        return Placement.fitting(self._sample.points[held], self.goal(fraction)[held], weights)

    def begin_at(self, whole: Placement) -> None:
        """Let the loop begin with all points where this motion takes them, so that it has the rest to do alone."""
        self._begin = whole

    def _path(self, fraction: float) -> Tensor:
        """Where the held points are to be after the fraction of the way from where the loop began."""
        goal = self.goal(fraction)
        if self._begin is None or fraction == 1:
            return goal
        return self._begin.at(self.placement(fraction).undone(goal))

    def wanted(self) -> Tensor:
        """The whole displacement of the held points; NaN elsewhere."""
        whole = self.goal(1.0) - self._sample.points
        return torch.where(self.held[:, None], whole, torch.full_like(whole, float("nan")))

    def notes(self, parameters: int) -> tuple[str, ...]:
        """What the caller should know of the answer: whether the strain is seen at fewer places than could hide it."""
        combinations = _combinations(parameters)
        count = parameters if combinations is None else combinations
        unknowns = count + 3 * self._tangential.count
        entries = 3 + 2 * (self._settings.bending > 0) + (self._settings.thickness > 0)
        if entries * len(self._sample) >= unknowns:
            return ()
        return (
            f"The strain at {len(self._sample)} points is {entries * len(self._sample)} equations for {unknowns} "
            f"unknowns, so that between the points the surface may be strained unseen. Take {-(-unknowns // entries)} "
            "points or more, or fewer waves.",
        )

    def step(self, state: State) -> StepProblem:
        held, settings = self.held, self._settings
        target = (self._path((state.step + 1) / settings.steps) - state.points)[held]
        reach = VectorTarget(
            state.points[held], target, settings.alpha * (self._sample.weights * self._total.clamp(max=1))[held]
        )
        strain = Killing(state.points, self._sample.weights, settings.bending, settings.thickness)
        way = float(target.norm(dim=1).max()) / (SMALL * state.field.size)
        damping = DAMPING * min(max(way, LEAST), 1.0)
        energies: list[Energy] = [strain, reach]
        here = SurfaceSample(state.points, state.field.normal(state.points), self._sample.weights)
        strength = settings.off_surface_strength
        away = off_surface(state.field, here, strength=strength, seed=settings.seed + state.step)
        if strength > 0:
            energies.append(away)
        count = _combinations(len(state.field.theta))
        directions = None if count is None else spanned(state.field, state.points, away.points, count)
        return StepProblem(
            DeformationSpace(state.field, self._tangential, directions),
            energies,
            settings.damping,
            first_damping=damping,
            least_damping=damping,
            allowed_miss=0.3,  # for the surface settles where the step sends it
            settle=self._sample.weights,
        )

    def finished(self, state: State, history: Sequence[Row]) -> bool:
        return False


def _combinations(parameters: int) -> int | None:
    """How many combinations of so many parameters a step chooses among; None for all."""
    return None if parameters <= ALL_PARAMETERS else min(COMBINATIONS, NUMBERS // parameters)


def _require_rigid_motion_fixed(points: Tensor) -> None:
    """Three points off one line pin all six rigid motions; fewer leave the least squares singular."""
    spread = torch.linalg.svdvals((points - points.mean(dim=0)).double()) if len(points) >= 3 else None
    if spread is None or not bool(spread[1] > 1e-6 * spread[0]):
        raise ValueError(
            f"The handles hold {len(points)} sample points, which do not fix a rigid motion: at least three that are "
            "not on one line are needed. Widen the regions, add an anchor, or raise points."
        )
