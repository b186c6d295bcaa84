"""Rigid editing: the handles go to their targets, and the rest follows as rigidly as the field allows.

Each step minimises E_K + alpha E_C over the parameters and the motion along the surface together [paper, section 4.3]:
E_K = int |J + J^T|^2 is zero just for infinitesimal rigid motions (Killing fields). The paper trains a second network
for the motion along the surface. Here the points that carry an edit become the vertices of a mesh, on which E_K is
taken and each of which is free along the surface (implicit.edits.connected_sample, implicit.step.vertex_equations):
what holds it are its neighbours alone, so that the equations are sparse but for those of the parameters. Where there is
no such mesh, or a basis is asked for, a linear one spans the motion, in one dense least squares.

So these steps are for small motions. Large ones are done by finite rotations (implicit.edits.finite_rigid); which way
is taken is said, or measured (implicit.edits.rigid_method).

The rigid motion that fits the handles' targets best, as a whole, is done first, and exactly, where the network has a
closed form; the steps have only the rest to do.

With a basis a wide network's step is sought among combinations of the sensitivities of some points, a narrow one's
among all parameters. All is computed in float64: the damping that suits these systems is below what single precision
resolves.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from implicit.arguments import require_positive, require_whole
from implicit.edits.connected_sample import FineMesh, connected
from implicit.edits.finite_rigid import VERTICES, FiniteProblem, finite_rigid_edit, vertices_of
from implicit.edits.handles import Handle
from implicit.edits.rigid_method import Choice, Method, chosen, measured
from implicit.edits.rigid_placement import Placement
from implicit.edits.targets import AveragedTargets, checked_handles
from implicit.evolve.constraints import checked_constraints
from implicit.evolve.edit import Edit, EditStatus, Progress, require_options, with_evidence
from implicit.evolve.evolve import evolve
from implicit.evolve.operation import Outcome, State, Taken
from implicit.field.field import Field, require_field
from implicit.models.warp import Warp
from implicit.sensitivity.moved_as_a_whole import moved_as_a_whole
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.sensitivity.shape_functionals import Area, Functional, Volume
from implicit.sensitivity.weak_curvature import IntArray, WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Energy, Killing, VectorTarget
from implicit.step.mesh_killing import MeshKilling
from implicit.step.off_surface import off_surface
from implicit.step.parameter_basis import spanned, spans_by_factors
from implicit.step.point_rows import room_for_rows
from implicit.step.problem import DampingRule, Row, StepProblem
from implicit.step.rest_shape import Deformation, RestShape
from implicit.step.tangential_basis import CosineFeatures, TangentialModel
from implicit.step.vertex_motion import VertexMotion
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.sampling import carrying_points, sample_surface
from implicit.surface.soundness import field_soundness, soundness_on_mesh

# Damping of a step relative to the trace of its normal matrix. Ten times less lets ripples in, which cost strain as
# soon as a motion is not small; ten times more holds the surface back. What is not linear in a step falls with the
# square of its motion, so where handles go less far than SMALL of the field's size the damping falls with the motion,
# down to the share LEAST.
DAMPING = 1e-8
SMALL = 0.004
LEAST = 0.1

# The same where the points are free along the surface, when only the parameters are damped, and the part of its motion
# by which a step may miss its prediction then and else: it is corrected after it, in the first case by the factor of
# the step itself.
VERTEX_DAMPING = 2.5e-9
VERTEX_LEAST = 1 / 3
VERTEX_ERROR, ERROR = 0.2, 0.3

# Of the energy off the surface beside the strain. It costs a small motion less than half a per cent of tangential
# energy. Without it stray pieces stand round a bar twisted by 135 degrees.
OFF_SURFACE_STRENGTH = 0.3

# Up to so many parameters, all are unknowns. Of more, a step is sought among the combinations of the sensitivities of
# some points: the normal matrix grows with the square of the unknowns, and the spectrum of the sensitivities falls so
# fast that all 8641 parameters of a network of 64 sines a layer leave 1 % less energy than 1500 combinations. Where the
# field has no closed form these are kept as a matrix, of at most so many numbers; with fewer combinations the motion
# gets stiff.
ALL_PARAMETERS = 4000
COMBINATIONS = 1500
FEWEST_COMBINATIONS = 500
NUMBERS = 100_000_000

# Points of the surface that are looked at to choose between the ways, and the cells along the bounds to draw them on.
LOOKED_AT = 1000
LOOKED_AT_CELLS = 32

# Weight of the bending part of E_K where none is asked for.
BENDING = 0.1

# Weight of the bending part of E_K on a mesh where `bending` is its default: there 1 is the energy of spokes and rims.
MESH_BENDING = 10.0

# Vertices of a mesh to an area of one cell squared, as marching makes them.
VERTICES_OF_CELLS = 1.5

# Cells along the longest side of the bounds of such a mesh: fewer lose the shape, more cost more than the points would.
FEWEST_CELLS, MOST_CELLS = 24, 64

# Part of the turning of the normals from which second derivatives need not explain more, for on a mesh of the points
# they are not asked: one step of a bar with sharp edges, of which sines explain 61 %, has a third of the energy that it
# has by the edges of a marched mesh. Of piecewise linear fields they explain nothing.
MOSTLY = 0.5

# Points off the surface, beside those on it.
OFF_SURFACE_POINTS = 500


def rigid_edit(
    field: Field,
    handles: Sequence[Handle],
    *,
    method: Method = "auto",
    steps: int = 1,
    alpha: float = 1e3,
    bending: float = BENDING,
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
    rest: Edit | None = None,
) -> Edit:
    """Move handles and let the rest follow rigidly.

    Args:
        field: A field in 2D or 3D; the caller's own stays as it is until `edit.field.write_back()`. In the plane the
            inside of the curve is deformed, always by finite rotations (implicit.step.planar_rigidity), and Volume()
            holds its area.
        handles: Regions with their motions, anchors among them as zero vectors. Weights scale the penalty.
        method: "linear" takes steps that are linear, by a Killing energy; "finite" minimises the energy of finite
            rotations against the rest shape and lets the field follow (implicit.edits.finite_rigid), for motions of
            any size; "warp" minimises the same energy, but leaves the parameters of the field as they are and warps
            its space: the edited field's module is an implicit.models.warp.Warp round the given one, whose surface
            stays what it is where it moves rigidly, however little the network can express; "coupled" minimises that
            energy over the parameters and the coefficients of `tangential` together, step by step
            (implicit.edits.coupled_rigid), for fields of up to 4000 parameters; "auto" chooses between "linear" and
            "finite" by how much of the motion is left to be bent and turned, says so in `notes`, and takes linear
            steps where an option is set that these alone have.
        steps: Sub-steps of the linear way; handles with a RigidMotion rotate along their path. Take one per 15 degrees
            or so. Finite rotations take as many stages as the path needs, but no fewer.
        alpha: Weight of the handles' squared error against the strain energy, per squared length. Both energies are
            integrals over the surface. With finite rotations it holds where a handle's weight is below 1: where it is
            1 they hold the points just where they are told.
        bending, thickness: Weights of the parts of E_K (see implicit.step.energies.Killing). On a mesh of the points
            `bending` weighs the bending of spokes and rims (implicit.step.mesh_killing), 1 as it does there. Where
            second derivatives of the field do not tell how its surface bends, E_K is taken on a marched mesh of the
            surface, whose bending is that of spokes and rims at the default, and it has no thickness. The paper's
            energy has 1 for both, at the points; what lies off the surface then costs as much as strain on it. The
            default leaves half the tangential energy on the bundled cow, with the same handles.
        tangential: Basis of the motion along the surface by linear steps. None leaves each point free, held by its
            neighbours on a mesh of the points; CosineFeatures(field) takes its place where these make no mesh of the
            surface or their weights are no areas, for more than 7500 points, where there is no room for the
            sensitivities of all parameters, for other weights of E_K than a mesh has (`bending=0`, a thickness), and
            where second derivatives do not tell how the surface bends. With points that are free, the rows of
            `history` have the method "vertices".
        points: Number of points that carry the energies, spread as far apart as can be, or the sample itself. Finite
            rotations take a mesh of as many vertices, or 4000 if that is more.
        damping: Penalty on the squares of the unknowns, of the parameters alone where the points are free along the
            surface; None adapts it to the linearity error.
        off_surface_strength: Weight by which the field off the surface is tied to the surface's motion, see
            implicit.step.off_surface. 0 leaves it alone.
        constraints: Functionals to hold, such as Volume().
        resolution: Cells a side of the quadrature that measures the constraints and counts the pieces of the surface.
        track: Further surface points (M, D) to carry along.
        progress: Called as progress(step, steps, row) after each step: its number from 1, how many there are, and its
            record.
        seed: Seed of the random points and features.
        rest: The edit by finite rotations that the field came from. The shape at rest stays the one before it, however
            many such edits follow each other, so that what is dragged back is as it was. None takes the field as it is
            for the shape at rest.

    Returns:
        The edit. `before` and `after` say how sound the field is, `notes` what has become worse, and whether the points
        are too few to see the strain.

    Raises:
        ValueError: Linear steps are asked of a field in 2D, a region misses the surface, the handles leave a rigid
            motion free (fewer than three points that are not on one line; two, in the plane), a thickness is asked of
            a field without second derivatives, or the field did not come from `rest`.
    """
    require_options(field, damping=damping, resolution=resolution, progress=progress, seed=seed)
    began = time.perf_counter()
    constraints = checked_constraints(constraints)
    precise = field.to(torch.float64)
    tracked = None if track is None else precise.require_points(precise.in_precision(track), "track")
    settings = RigidSettings(
        steps=steps,
        alpha=alpha,
        bending=bending,
        thickness=thickness,
        damping=damping,
        off_surface_strength=off_surface_strength,
        seed=seed,
    )
    start = None if rest is None else _deformation(field, rest)
    planar = precise.dimension == 2
    if start is not None and isinstance(field.module, Warp) and len(start.field.theta) != len(field.theta):
        method = _warp_again(method)
    elif planar or start is not None:
        method = _finite_alone(method, "a field in 2 dimensions" if planar else "a shape at rest of before")
    handles, points = checked_handles(handles), _checked_points(precise, points)
    choice = _choice(method, precise, handles, points, settings, tangential)
    if choice.coupled and len(precise.theta) > ALL_PARAMETERS:
        raise ValueError(
            f'method "coupled" takes up to {ALL_PARAMETERS:,} parameters, all of which are unknowns of a step, but the '
            f'field has {len(precise.theta):,}. Take method="finite".'
        )
    if choice.finite:
        vertices = max(VERTICES, points) if isinstance(points, int) else VERTICES
        if start is None:
            start = Deformation.none(precise, RestShape.of(precise, vertices))
        sample = points if isinstance(points, SurfaceSample) else vertices_of(precise, start)
        finite = FiniteProblem(
            field=field,
            precise=precise,
            handles=handles,
            sample=sample,
            targets=_targets(precise, handles, sample),
            track=tracked,
            constraints=constraints,
            steps=steps,
            alpha=alpha,
            resolution=resolution,
            progress=progress,
            seed=seed,
            start=start,
            coupled=_tangential_model(precise, tangential, seed) if choice.coupled else None,
            warp=choice.warp,
        )
        return finite_rigid_edit(finite, field_soundness(field, resolution), choice.notes, began)
    before, near_surface, faces = soundness_on_mesh(field, resolution)
    mesh = FineMesh(near_surface, faces, before.topology) if tangential is None else None
    operation = _operation(precise, handles, settings, tangential, points, mesh)
    edit = _by_linear_steps(precise, operation, constraints, resolution, tracked, progress)
    edit = replace(edit, field=edit.field.to(field.dtype), notes=(*choice.notes, *edit.notes))
    return with_evidence(edit, field, before, resolution)


def _operation(
    precise: Field,
    handles: Sequence[Handle],
    settings: RigidSettings,
    tangential: TangentialModel | None,
    points: int | SurfaceSample,
    mesh: FineMesh | None,
) -> RigidOperation:
    """Return what the linear steps minimise: on a mesh of the points where these can be connected by a finer mesh.

    Without bending such a mesh would crumple, and it knows no stretch across the surface; where second derivatives
    tell next to nothing of how the surface bends, the energy is that of a mesh of its own.
    """
    count = points if isinstance(points, int) else len(points)
    if settings.bending == 0 or settings.thickness > 0 or not room_for_rows(precise, count + OFF_SURFACE_POINTS):
        mesh = None
    spread = None
    if mesh is not None and isinstance(points, int):
        spread = mesh.spread(precise, points, settings.seed)
    operation = prepare(precise, handles, settings, tangential, points if spread is None else spread[0])
    turning = normal_turning(precise, operation.sample.points)
    cells = None if turning.is_smooth else _mesh_cells(precise, operation.sample, settings)
    faces = None
    if mesh is not None and (turning.is_smooth or turning.explained >= MOSTLY):
        faces = connected(precise, operation.sample, mesh) if spread is None else spread[1]
    return replace(operation, mesh_cells=cells) if faces is None else replace(operation, faces=faces)


def _by_linear_steps(
    precise: Field,
    operation: RigidOperation,
    constraints: Sequence[Functional],
    resolution: int,
    tracked: Float[Tensor, "m d"] | None,
    progress: Progress | None,
) -> Edit:
    """Return the edit by linear steps from the best rigid placement, in float64, without its evidence."""
    sample, settings = operation.sample, operation.settings
    target, whole = operation.targets.target(), operation.placement(1.0)
    if _can_be_placed(precise, whole, sample, constraints):
        start, operation = whole.field(precise), replace(operation, begin=whole)
    else:
        start, whole = precise, Placement.none(sample.points)
    edit = evolve(
        start,
        operation,
        whole.sample(sample),
        steps=settings.steps,
        constraints=constraints,
        resolution=resolution,
        track=None if tracked is None else whole.at(tracked),
        wanted=target + sample.points - whole.at(sample.points),
        progress=progress,
    )
    return replace(
        edit,
        points=sample.points,
        normals=sample.normals,
        displacement=edit.points + edit.displacement - sample.points,
        wanted=target,
        notes=(*edit.notes, *operation.notes(precise)),
    )


def _finite_alone(method: Method, what: str) -> Method:
    """Return the way of an edit that finite rotations alone can make, or refuse another."""
    if method in ("linear", "coupled"):
        raise ValueError(
            f'method must be "auto", "finite" or "warp" for {what}, but is "{method}": linear steps strain the surface '
            "as it is, along itself and as it bends in space, and coupled ones move its own points alone. Finite "
            "rotations deform the inside of a curve, and know a shape at rest."
        )
    return "finite" if method == "auto" else method


def _warp_again(method: Method) -> Method:
    """Return the way of an edit whose field at rest was warped before: by another warp in place of that one."""
    if method not in ("auto", "warp"):
        raise ValueError(
            f'method must be "auto" or "warp" for a shape at rest whose space was warped before, but is "{method}", '
            "which changes parameters: those of the field at rest are without the warp. Leave method or rest out."
        )
    return "warp"


def _deformation(field: Field, rest: Edit) -> Deformation:
    """Return the deformation that a field shows after an edit, or refuse another field or edit."""
    if not isinstance(rest, Edit):
        raise TypeError(f"rest must be the Edit that the field came from, but is a {type(rest).__name__}.")
    if rest.deformation is None:
        raise ValueError(
            "rest must be an edit by finite rotations that was made, but this one has no deformation. Take "
            'method="finite" for it, or leave rest out.'
        )
    if field.theta.shape != rest.field.theta.shape or not torch.equal(field.theta.cpu(), rest.field.theta.cpu()):
        raise ValueError(
            "The field must be that of the edit given as rest, but has other parameters: it has been changed since. "
            "Edit rest.field, or leave rest out."
        )
    return rest.deformation


def _checked_points(precise: Field, points: int | SurfaceSample) -> int | SurfaceSample:
    """Return the points that carry an edit in float64, or how many there are to be, or refuse them."""
    if not isinstance(points, SurfaceSample):
        require_whole("points", points)
        return points
    precise.require_points(precise.in_precision(points.points), "points")
    return points.to(torch.float64)


def _carried(
    precise: Field, handles: Sequence[Handle], points: int | SurfaceSample, seed: int
) -> tuple[SurfaceSample, AveragedTargets]:
    """Return the points that carry an edit by linear steps, and what the handles ask of them."""
    points = _checked_points(precise, points)
    sample = carrying_points(precise, points, "farthest", seed=seed)
    return sample, _targets(precise, checked_handles(handles), sample)


def _targets(precise: Field, handles: Sequence[Handle], sample: SurfaceSample) -> AveragedTargets:
    """Return what the handles ask of points of the surface.

    Raises:
        ValueError: A region misses them all, or they leave a rigid motion free.
    """
    targets = AveragedTargets(handles, sample.points, sample.normals)
    targets.require_points_in_each_region(precise.units)
    _require_rigid_motion_fixed(sample.points[targets.prescribed])
    return targets


def _choice(
    method: Method,
    precise: Field,
    handles: Sequence[Handle],
    points: int | SurfaceSample,
    settings: RigidSettings,
    tangential: TangentialModel | None,
) -> Choice:
    """Return the way that the edit goes, by a look at some points of the surface where that has to be measured."""
    told = chosen(method, len(precise.theta), linear_options(settings, tangential))
    if told is not None:
        return told
    _require_combinations(precise)  # before any work
    if isinstance(points, SurfaceSample):
        sample = points
    else:
        single = precise.to(torch.float32)
        sample = sample_surface(single, LOOKED_AT, resolution=LOOKED_AT_CELLS, seed=settings.seed).to(torch.float64)
        seen = AveragedTargets(handles, sample.points, sample.normals)
        if not all(bool((weights > 0).any()) for weights in seen.handle_weights):
            sample = carrying_points(precise, points, "farthest", seed=settings.seed)
    targets = _targets(precise, handles, sample)
    return measured(sample, targets, placement(sample, targets, 1.0))


def placement(sample: SurfaceSample, targets: AveragedTargets, fraction: float) -> Placement:
    """Return the rigid motion that takes the held points nearest to their targets after the fraction of their path."""
    held = targets.prescribed
    weights = (sample.weights * targets.total)[held]
    return Placement.fitting(sample.points[held], targets.positions(fraction)[held], weights)


def _mesh_cells(field: Field, sample: SurfaceSample, settings: RigidSettings) -> int:
    """Return the cells of a mesh with about as many vertices as the sample has points, of a field that needs one."""
    if settings.thickness > 0:
        raise ValueError(
            f"thickness must be 0 for this field, but is {settings.thickness}: it weighs the stretch across the "
            "surface, which takes second derivatives, and those of this field do not tell how its surface bends."
        )
    side = (VERTICES_OF_CELLS * float(sample.weights.sum()) / len(sample)) ** 0.5
    return min(max(round(field.size / side), FEWEST_CELLS), MOST_CELLS)


def _can_be_placed(field: Field, whole: Placement, sample: SurfaceSample, constraints: Sequence[Functional]) -> bool:
    """Return whether the field can first be moved as a whole: no constraint feels it, and it stays in its bounds."""
    if not all(isinstance(constraint, (Volume, Area)) for constraint in constraints):
        return False
    if moved_as_a_whole(field, whole.rotation, whole.translation) is None:
        return False
    moved = whole.at(sample.points)
    lower, upper = field.bounds + 0.01 * field.size * torch.tensor([[1.0], [-1.0]]).to(field.theta)
    return bool(((moved > lower) & (moved < upper)).all())


@dataclass(frozen=True, kw_only=True)
class RigidSettings:
    """Weights of the energies of a rigid edit's steps; see rigid_edit for each."""

    steps: int = 1
    alpha: float
    bending: float
    thickness: float
    damping: float | None = None
    off_surface_strength: float = 0.0
    seed: int

    def __post_init__(self) -> None:
        require_whole("steps", self.steps)
        require_positive("alpha", self.alpha)
        for name in ("bending", "thickness", "off_surface_strength"):
            require_positive(name, getattr(self, name), or_zero=True)


def linear_options(settings: RigidSettings, tangential: TangentialModel | None) -> list[str]:
    """Return the names of the options that differ from their defaults and that linear steps alone have."""
    usual = {"bending": BENDING, "thickness": 0.0, "damping": None, "off_surface_strength": OFF_SURFACE_STRENGTH}
    named = [name for name, value in usual.items() if getattr(settings, name) != value]
    return named if tangential is None else [*named, "tangential"]


def prepare(
    precise: Field,
    handles: Sequence[Handle],
    settings: RigidSettings,
    tangential: TangentialModel | None,
    points: int | SurfaceSample,
) -> RigidOperation:
    """Return what each step minimises, of a field in float64, with the points that carry the energies; see rigid_edit.

    Raises:
        ValueError: As rigid_edit.
    """
    if require_field(precise).dimension != 3:
        raise ValueError(f"rigid_edit needs a field in 3 dimensions, but this one has {precise.dimension}.")
    model = _tangential_model(precise, tangential, settings.seed)
    _require_combinations(precise)
    sample, targets = _carried(precise, handles, points, settings.seed)
    return RigidOperation(sample, targets, settings, model)


@dataclass(frozen=True, eq=False)
class RigidOperation:
    """Energies that the steps of a rigid edit minimise, for the loop.

    Attributes:
        sample: The points that carry the energies, on the unedited surface.
        targets: Targets that the handles set them.
        settings: The weights of the energies.
        tangential: Basis of the motion along the surface.
        begin: The rigid motion that took the field and the sample to where the loop begins; None is none.
        mesh_cells: Cells along the longest side of the bounds of the mesh on which E_K is taken; None takes it at the
            points of the sample.
        faces: Triangles between the points of the sample (m, 3), on which E_K is then taken, and whose vertices move
            freely along the surface; None spans that motion by `tangential`.
    """

    columns: ClassVar[tuple[str, ...]] = ()

    sample: SurfaceSample
    targets: AveragedTargets
    settings: RigidSettings
    tangential: TangentialModel
    begin: Placement | None = None
    mesh_cells: int | None = None
    faces: IntArray | None = None

    def placement(self, fraction: float) -> Placement:
        """Return the rigid motion that takes the held points nearest to their targets after the fraction."""
        return placement(self.sample, self.targets, fraction)

    def _path(self, fraction: float) -> Tensor:
        """Return where the points are to be after the fraction of what the loop has left to do."""
        positions = self.targets.positions(fraction)
        if self.begin is None or fraction == 1:
            return positions
        return self.begin.at(self.placement(fraction).undone(positions))

    def notes(self, field: Field) -> tuple[str, ...]:
        """Return what to know of the answer: whether the strain is seen at fewer places than could hide it."""
        if self.faces is not None:
            return self._few_points(field)
        combinations = _combinations(field)
        count = len(field.theta) if combinations is None else combinations
        unknowns = count + 3 * self.tangential.count
        entries = 3 + 2 * (self.settings.bending > 0) + (self.settings.thickness > 0)
        notes: tuple[str, ...] = ()
        if self.mesh_cells is not None:
            entries = 3  # the mesh has about as many vertices as there are points, of three coordinates each
            notes = (
                f"The strain was taken on a mesh of the surface at {self.mesh_cells} cells, for second derivatives of "
                "the field do not tell how it bends.",
            )
        if entries * len(self.sample) >= unknowns:
            return notes
        return (
            *notes,
            f"The strain at {len(self.sample)} points is {entries * len(self.sample)} equations for {unknowns} "
            f"unknowns, so that between the points the surface may be strained unseen. Take {-(-unknowns // entries)} "
            "points or more, or fewer waves.",
        )

    def _few_points(self, field: Field) -> tuple[str, ...]:
        """Return whether a mesh of the points has fewer strains than there are unknowns; of many, COMBINATIONS count.

        Of three strains to a triangle, six to a vertex, two decide how that moves along the surface.
        """
        strains, unknowns = 4 * len(self.sample), min(len(field.theta), ALL_PARAMETERS)
        if strains >= unknowns:
            return ()
        return (
            f"The strain between {len(self.sample)} points leaves {strains} equations for {unknowns} parameters, so "
            "that between the points the surface may be strained unseen. "
            f"Take {-(-unknowns // 4)} points or more.",
        )

    def step(self, state: State[None]) -> StepProblem:
        """Return the problem of this step."""
        held, settings = self.targets.prescribed, self.settings
        target = (self._path((state.step + 1) / settings.steps) - state.points)[held]
        reach = VectorTarget(
            state.points[held], target, settings.alpha * (self.sample.weights * self.targets.weights)[held]
        )
        strain = self._strain(state)
        largest = float(target.norm(dim=1).max()) / (SMALL * state.field.size)
        most, least, error = (DAMPING, LEAST, ERROR)
        if self.faces is not None:
            most, least, error = (VERTEX_DAMPING, VERTEX_LEAST, VERTEX_ERROR)
        damping = most * min(max(largest, least), 1.0)
        energies: list[Energy] = [strain, reach]
        here = SurfaceSample(state.points, state.field.normal(state.points), self.sample.weights)
        strength = settings.off_surface_strength
        away = off_surface(
            state.field, here, strength=strength, points=OFF_SURFACE_POINTS, seed=settings.seed + state.step
        )
        if strength > 0:
            energies.append(away)
        return StepProblem(
            self._space(state.field, state.points, away.points),
            energies,
            # A large error will do, for the surface is brought to where the step sends it.
            DampingRule(settings.damping, first=damping, least=damping, allowed_error=error),
            correction_weights=self.sample.weights,
        )

    def _space(self, field: Field, points: Tensor, away: Tensor) -> DeformationSpace:
        """Return the displacements that a step chooses from, of a field at points on its surface and off it."""
        if self.faces is not None:
            return VertexMotion(field, points, self.faces)
        count = _combinations(field)
        basis = None if count is None else spanned(field, points, away, count)
        return DeformationSpace(field, self.tangential, basis)

    def _strain(self, state: State[None]) -> Energy:
        """Return E_K of the current surface."""
        settings = self.settings
        if self.faces is not None:
            points = state.points.detach().double().cpu().numpy()
            return MeshKilling(WeakSurface(points, self.faces), settings.bending)
        if self.mesh_cells is None:
            return Killing(state.points, self.sample.weights, settings.bending, settings.thickness)
        return MeshKilling(WeakSurface.extracted(state.field, self.mesh_cells), MESH_BENDING * settings.bending)

    def start(self, field: Field, points: Tensor) -> None:
        """Return no memory: the steps need none."""

    def finished(self, state: State[None], history: Sequence[Row]) -> EditStatus | None:
        """Return that the edit goes on, up to its last step."""
        return None

    def taken(self, state: State[None], taken: Taken) -> Outcome[None]:
        """Return nothing to keep or to record."""
        return Outcome(None)


def _combinations(field: Field) -> int | None:
    """Return how many combinations of its parameters a step chooses among; None for all, 0 where there are too many."""
    if len(field.theta) <= ALL_PARAMETERS:
        return None
    if spans_by_factors(field, COMBINATIONS):
        return COMBINATIONS
    room = NUMBERS // len(field.theta)
    return 0 if room < FEWEST_COMBINATIONS else min(COMBINATIONS, room)


def _tangential_model(precise: Field, tangential: TangentialModel | None, seed: int) -> TangentialModel:
    """Return the basis of the motion along the surface, or refuse what is none."""
    if tangential is not None and not callable(getattr(tangential, "slopes", None)):
        raise TypeError(f"tangential must be None or a model such as CosineFeatures(field), but is {tangential!r}.")
    return CosineFeatures(precise, seed=seed) if tangential is None else tangential


def _require_combinations(precise: Field) -> None:
    """Refuse a field of which a linear step could choose among too few combinations of its parameters."""
    if _combinations(precise) == 0:
        raise ValueError(
            f"The field has {len(precise.theta):,} parameters and no closed form of its derivatives; a rigid edit of "
            f"such a field takes up to {NUMBERS // FEWEST_COMBINATIONS:,}. Edit some of them alone, such as those of "
            "the last layers: Field(module, parameters=[...])."
        )


def _require_rigid_motion_fixed(points: Tensor) -> None:
    """Refuse points on one line: three off it pin all rigid motions in space, two that differ those in the plane."""
    planar = points.shape[1] == 2
    spread = torch.linalg.svdvals((points - points.mean(dim=0)).double()) if len(points) >= 3 - planar else None
    if spread is None or not bool(spread[0] > 0 if planar else spread[1] > 1e-6 * spread[0]):
        needed = "at least two that differ" if planar else "at least three that are not on one line"
        raise ValueError(
            f"The handles hold {len(points)} sample points, which do not fix a rigid motion: {needed} are needed. "
            "Widen the regions, add an anchor, or raise points."
        )
