"""Rigid edits of any size: the energy of finite rotations is minimised on points, and the field then follows them.

    points    spokes and rims of a mesh of the field's own surface, in the plane of its inside, against the rest shape
              (implicit.edits.rest_shape, implicit.step.local_global)
    field     trained on samples of the map that the points give, from the best rigid placement
              (implicit.fitting.follow), or its space warped and its parameters left alone (implicit.fitting.warping)
    end       steps of boundary sensitivity in the metric of that energy, functionals restored
              (implicit.edits.towards_points)

Nothing is linear in the motion and nothing adds up over steps, so that a bend of 90 degrees, or a twist, ends where one
small solve after another would not: these forget what the earlier ones have strained.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy import sparse
from torch import Tensor

from implicit.edits.coupled_rigid import Asked, coupled_minimum, stages_of
from implicit.edits.handles import Handle
from implicit.edits.rigid_placement import Placement
from implicit.edits.targets import AveragedTargets
from implicit.edits.towards_points import MOST, TowardsPoints, nearer
from implicit.evolve.constraints import ConstraintSet, Holding
from implicit.evolve.damping import AdaptiveDamping
from implicit.evolve.edit import Edit, EditStatus, Progress, edit_status, reached_target, with_evidence
from implicit.evolve.evolve import Loop
from implicit.evolve.trial import StepRefused
from implicit.field.field import Field, SurfaceError
from implicit.fitting.follow import FOLLOWED, Follower, Following, is_distance
from implicit.fitting.training import FitStatus
from implicit.fitting.warping import Back, all_parameters, require_module
from implicit.sensitivity.moved_as_a_whole import moved_as_a_whole
from implicit.sensitivity.shape_functionals import Area, Functional, Volume
from implicit.sensitivity.weak_curvature import FloatArray
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.filled import Filled
from implicit.step.local_global import STAGE_ITERATIONS, Hold, LocalGlobal, Minimum, MinimumStatus
from implicit.step.problem import Row
from implicit.step.rest_shape import Deformation
from implicit.step.surface_area import SurfaceArea
from implicit.step.surface_map import SurfaceMap
from implicit.step.tangential_basis import TangentialModel
from implicit.surface.projection import newton_to_surface
from implicit.surface.quadrature import SurfaceSample
from implicit.surface.soundness import Soundness, field_soundness
from implicit.surface.topology import Topology

# Vertices of the mesh that carries the energy, unless more points are asked for. Spokes and rims bend the more easily
# the finer the mesh.
VERTICES = 4000

# Largest move of a vertex in an iteration, over the size, at which the points have come to rest: a stem bends so softly
# that at three times as much its end may still be 0.4 % away.
TOLERANCE = 3e-6

# Angle of a stage of the path, which makes the first guess, in radians, and most of them.
STAGE_ANGLE = 0.5
MOST_STAGES = 60

# Fractions of the path at which its turning is measured.
LOOKS = 64

# Energy of the displacement's strain over that of spokes and rims, for small motions.
KILLING_SHARE = 0.75

# Steps of the optimiser in each round by which the field follows: a further one is taken where the surface is not that
# near to the points (root mean square over the size) but comes nearer, or has not followed at all, as of a bar turned
# once after half of them, or has other pieces. What it learns from.
ROUNDS = (150, 300, 600, 1200)
NEAR, STALLED = 1e-3, 0.7
SAMPLES, BATCH = 20_000, 2048

# Price of the handles' squared errors in coupled steps, of alpha: a field that is to hold them is held back by them.
COUPLED_PRICE = 10.0

# Most steps of boundary sensitivity at the end, the strain between surface and points over the energy of these at which
# no more are taken, and how many times the damping is tried where one breaks the surface.
LAST_STEPS = 6
STRAIN_LEFT = 0.055
FIRMNESS = (1.0, 1e2, 1e4)

# Widths of the weights of a warp, in spacings of the vertices: the first is taken whose strain, over the energy of the
# points, is below the last number, else the one of least strain. Where all of a shape bends, the centres stand apart,
# and what their rotations miss, over the size, says so: the wider weights then come first.
WARP_WIDTHS = (1.5, 3.0)
WARP_MISSED = 5e-3
WARP_LEFT = 0.1

# Lots of steps by which a wide field comes nearer, and the damping of all but the first, over that.
LOTS_OF_WIDE, LATER_FIRMNESS = 8, 0.06

# The same ratio from which the ripples that are left are told of.
RIPPLED = 0.3

# Energy of the points on their way over that at the goal from which they are said to have unwound: a path that turns
# back gives some of it up as well. An energy below the least is rounding.
UNWOUND = 1.5
LEAST_ENERGY = 1e-9

# Firmness of the inside over that of the surface where it is filled, the softest that holds; angle of a stage, in
# radians, and most iterations of each: these are not a first guess alone, for who strays passes through.
FILLINGS = (1.0, 10.0)
FILLED_ANGLE = 0.35
FILLED_ITERATIONS = 60

# Part of the points' surface inside another part of it that is told of.
CROSSED = 2e-3
CROSSING_NOTE = (
    "The points of least energy pass through each other, and do so with the volume held and the inside filled. Move "
    "the handles less, or in another way."
)

# Least distance of the moved surface from the bounds, over the field's size.
MARGIN = 0.01


@dataclass(frozen=True, eq=False)
class FiniteProblem:
    """Request for a rigid edit by finite rotations.

    Attributes:
        field: As given, in its own precision.
        precise: The same in float64.
        handles: Regions with their motions.
        sample: Points of the unedited surface that judge the edit.
        targets: What the handles ask of them.
        track: The caller's points, or None.
        constraints: Functionals to hold.
        steps: Least number of stages of the path.
        alpha: Price of the squared distance from its goal of a point that a handle weighs by 1, against the strain
            energy; holds for weights below 1, a full weight holds firmly.
        resolution: Cells of the evidence and of the quadrature of the functionals.
        progress: Called with step, steps and a row.
        seed: Of the random samples.
        start: Deformation that the field shows, of a shape at rest.
        coupled: Basis of the motion along the surface where field and points are to go together; None takes the points
            first.
        warp: Whether the space of the field at rest is warped instead of its parameters changed.
    """

    field: Field
    precise: Field
    handles: Sequence[Handle]
    sample: SurfaceSample
    targets: AveragedTargets
    track: Float[Tensor, "m d"] | None
    constraints: Sequence[Functional]
    steps: int
    alpha: float
    resolution: int
    progress: Progress | None
    seed: int
    start: Deformation
    coupled: TangentialModel | None = None
    warp: bool = False


def finite_rigid_edit(problem: FiniteProblem, before: Soundness, notes: Sequence[str], began: float) -> Edit:
    """Return the edit by finite rotations.

    Args:
        problem: What is asked.
        before: How sound the field is.
        notes: Sentences that the edit is to have beside its own.
        began: Reading of perf_counter when the work began.

    Raises:
        ValueError: A region holds no vertex of the mesh, or the field cannot be trained.
    """
    tell, start = _Teller(problem.progress), problem.start
    if problem.coupled is not None:
        return _coupled_edit(problem, problem.coupled, before, notes, began)
    if problem.warp:
        require_module(start.field)
    own: list[str] = []

    def untouched(status: EditStatus, *words: str) -> Edit:
        edit = replace(_untouched(problem, status, began), notes=(*notes, *own, *words))
        return with_evidence(edit, problem.field, before, problem.resolution, before)

    points = _points(problem, start, *_volume(problem, start), tell)
    if points.minimum.status is MinimumStatus.NOT_FINITE:
        return untouched(EditStatus.NOT_FINITE)
    if not _stays_inside(problem.precise, start.map_to(points.minimum).moved):
        words = "The surface would leave the bounds of the field. Widen the bounds, or move the handles less."
        return untouched(EditStatus.SURFACE_LOST, words)
    way = _apart(problem, start, points, tell)
    if way is None:
        return untouched(EditStatus.SELF_CROSSING, CROSSING_NOTE)
    minimum, follower = way.points.minimum, way.follower
    own += way.notes
    surface_map = start.map_to(minimum)
    if minimum.status is not MinimumStatus.CONVERGED:
        own.append(_minimum_note(minimum))
    seconds_points = time.perf_counter() - began
    if problem.warp:
        edited, following = _warped(problem, start, minimum, follower, before.topology)
    else:
        edited, following = _followed(problem, follower, before.topology, tell)
    # Its samples were made while points that cross were sought for.
    following = replace(following, seconds=time.perf_counter() - began - seconds_points)
    row = _row(problem, edited.field, surface_map, minimum, following, seconds_points)
    end = _polished(problem, edited, surface_map, start.rest.laplacian, before.topology, row)
    if problem.warp:
        end = replace(end, field=all_parameters(end.field, start.field))
    following = _at_the_end(following, end.field, surface_map)
    own += _following_notes(problem.field, following)
    edit = _with_stages(_edit(problem, surface_map, end, began), problem, way.points)
    reached = reached_target(edit, _way(problem.targets)) and following.miss_rms <= FOLLOWED * problem.field.size
    reached = reached and following.status is not FitStatus.DIVERGED
    edit = replace(
        edit,
        status=edit_status(end.status, reached=reached),
        notes=(*notes, *own, *_strain_notes(end.history[0], problem.warp), *end.notes),
        deformation=Deformation(start.field, start.rest, minimum.positions),
    )
    return with_evidence(edit, problem.field, before, problem.resolution, end.soundness)


def vertices_of(field: Field, start: Deformation) -> SurfaceSample:
    """Return the vertices of the mesh that carries the energy, on the field's surface: points that judge an edit."""
    surface = start.surface
    here = torch.from_numpy(surface.vertices).to(field.theta)
    found, arrived = newton_to_surface(field, here, reach=field.size / 20)
    points = torch.where(arrived[:, None], found, here)
    return SurfaceSample(points, field.normal(points), torch.from_numpy(surface.masses).to(points))


@dataclass(frozen=True, eq=False)
class _Stage:
    """End of a stage of the points' way.

    Attributes:
        positions: Of all vertices of the energy of the shape at rest (V, 3).
        energy: A squared length.
        seconds: Wall time of the stage.
    """

    positions: FloatArray
    energy: float
    seconds: float


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of least energy.

    Attributes:
        minimum: The deformation.
        stages: What came before it, a stage each but the last.
    """

    minimum: Minimum
    stages: tuple[_Stage, ...]

    @property
    def highest(self) -> float:
        """Energy at the end of a stage of their way, 0 where there was but one."""
        return max((stage.energy for stage in self.stages), default=0.0)

    @property
    def unwound(self) -> bool:
        return self.highest > UNWOUND * self.minimum.energy + LEAST_ENERGY


@dataclass(frozen=True, eq=False)
class _Way:
    """Points for the field to follow, the field on its way there, and what to know of how they were found."""

    points: _Points
    follower: Follower
    notes: tuple[str, ...]


def _apart(problem: FiniteProblem, start: Deformation, points: _Points, tell: _Teller) -> _Way | None:
    """Return points that do not pass through each other, nor have done so on their way; None where they must.

    Where they do, the volume is held; where they still do, the inside is filled, more firmly each time.
    """
    follower = _follower(problem, start, points.minimum)
    crossed = follower.crossed
    if crossed <= CROSSED and not points.unwound:
        return _Way(points, follower, ())
    held, _ = _volume(problem, start)
    own = start.rest.volume.value(start.positions)
    tries = [] if held is not None else [("the volume held", own, 0.0)]
    if problem.field.dimension == 3:
        words = "the volume held and the inside filled"
        tries += [(words, own if held is None else held, firmness) for firmness in FILLINGS]
    for words, volume, firmness in tries:
        tried = _points(problem, start, volume, "equal", tell, firmness)
        moved = start.map_to(tried.minimum).moved
        if (
            tried.unwound
            or tried.minimum.status is MinimumStatus.NOT_FINITE
            or not _stays_inside(problem.precise, moved)
        ):
            continue
        other = _follower(problem, start, tried.minimum)
        if other.crossed <= CROSSED:
            return _Way(tried, other, (_apart_note(crossed, words, held is None),))
    if crossed > CROSSED:
        return None
    return _Way(points, follower, (_unwound_note(points.highest, points.minimum.energy),))


def _points(
    problem: FiniteProblem,
    start: Deformation,
    held: float | None,
    bound: str,
    tell: _Teller,
    firmness: float = 0.0,
) -> _Points:
    """Return the deformation of least energy.

    Args:
        problem: What is asked.
        start: What the field shows.
        held: Volume to hold; None holds none.
        bound: On which side of it.
        tell: Told of each iteration.
        firmness: Of the inside, over that of the surface; 0 leaves it out.
    """
    rest, surface = start.rest, start.surface
    targets = _targets_of_vertices(problem, start)
    weights = targets.weights.cpu().numpy()
    soft = np.where(weights < 1, KILLING_SHARE * problem.alpha * surface.masses * weights, 0.0)
    angle, iterations = (FILLED_ANGLE, FILLED_ITERATIONS) if firmness > 0 else (STAGE_ANGLE, STAGE_ITERATIONS)
    stages = max(problem.steps, min(MOST_STAGES, round(turning(targets) / angle)), 1)
    energy, volume_of, positions = rest.energy, rest.volume, start.positions
    if firmness > 0:
        energy = Filled.of(start.field.to(torch.float64), rest.energy, firmness, problem.seed)
        inside = energy.vertices[len(positions) :]
        volume_of = EnclosedVolume(rest.energy.faces, len(energy.vertices))
        positions = np.concatenate([positions, start.carried(inside)])
    count = len(positions)

    def everywhere(values: FloatArray) -> FloatArray:
        spread = rest.spread(values)
        return np.concatenate([spread, np.zeros((count - len(spread), *spread.shape[1:]))])

    area = _area(problem, start)
    hold = Hold(everywhere((weights >= 1).astype(np.float64)) > 0, everywhere(soft))
    solver = LocalGlobal(energy, hold, volume_of)

    def found(volume: float | None) -> _Points:
        way: list[_Stage] = []
        clock = time.perf_counter()

        def passed(positions: FloatArray) -> None:
            nonlocal clock
            now, own = time.perf_counter(), positions[: len(start.positions)].copy()
            way.append(_Stage(own, energy.energy(positions), now - clock))
            clock = now

        minimum = solver.minimum(
            lambda fraction: everywhere(targets.positions(fraction).cpu().numpy()),
            positions,
            stages=stages,
            stage_iterations=iterations,
            tolerance=TOLERANCE,
            volume=volume,
            area=area,
            report=tell.points,
            passed=passed,
        )
        whole = minimum.energy
        if firmness > 0:  # what the inside has held apart is the surface's alone again
            B = len(start.positions)
            u, R = minimum.positions[:B], minimum.rotations[:B]
            minimum = replace(minimum, positions=u, rotations=R, energy=rest.energy.energy(u, R))
            way = [replace(stage, energy=stage.energy * minimum.energy / whole) for stage in way] if whole > 0 else way
        return _Points(minimum, tuple(way))

    if held is None or bound == "equal":
        return found(held)
    free = found(None)
    reached = solver.volume.value(free.minimum.positions)
    broken = reached < held if bound == "at least" else reached > held
    return found(held) if broken else free


def _targets_of_vertices(problem: FiniteProblem, start: Deformation) -> AveragedTargets:
    """Return what the handles ask of the vertices of the mesh."""
    vertices = torch.from_numpy(start.surface.vertices).to(problem.precise.theta)
    targets = AveragedTargets(problem.handles, vertices, torch.from_numpy(start.surface.normals).to(vertices))
    targets.require_points_in_each_region(problem.precise.units)
    return targets


def _coupled_edit(
    problem: FiniteProblem, tangential: TangentialModel, before: Soundness, notes: Sequence[str], began: float
) -> Edit:
    """Return the edit in which field and points go together."""
    start, tell = problem.start, _Teller(problem.progress)
    targets = _targets_of_vertices(problem, start)
    weights = targets.weights.cpu().numpy()
    whole = (targets.positions(1.0) - targets.points)[targets.prescribed].norm(dim=1)
    volume, bound = _volume(problem, start)
    asked = Asked(
        rest=start.rest,
        places=lambda fraction: targets.positions(fraction).cpu().numpy(),
        prices=COUPLED_PRICE * KILLING_SHARE * problem.alpha * start.surface.masses * weights,
        stages=stages_of(float(whole.max()) / problem.precise.size, turning(targets), problem.steps),
        volume=volume if bound == "equal" else None,
        area=_area(problem, start),
        tangential=tangential,
        seed=problem.seed,
        is_distance=is_distance(problem.precise, start.surface),
    )
    edited, minimum = coupled_minimum(problem.precise, start.positions, asked, tell.points)
    surface_map = start.map_to(minimum)
    row = _row(problem, edited, surface_map, minimum, None, time.perf_counter() - began)
    found = _Found.of(problem, edited, before.topology)
    end = _End(edited, [row], EditStatus.DONE, (), found.soundness)
    if problem.constraints or not found.sound:
        goals = torch.from_numpy(surface_map.moved).to(edited.theta)
        masses = torch.from_numpy(surface_map.rest.masses).to(edited.theta)
        operation = TowardsPoints(goals, masses, start.rest.laplacian, problem.seed)
        end = _mended(problem, found, operation, before.topology, row)
    edit = _edit(problem, surface_map, end, began)
    own = [_minimum_note(minimum)] if minimum.status is not MinimumStatus.CONVERGED else []
    edit = replace(
        edit,
        status=edit_status(end.status, reached=reached_target(edit)),
        notes=(*notes, *own, *end.notes),
        deformation=Deformation(start.field, start.rest, minimum.positions),
    )
    return with_evidence(edit, problem.field, before, problem.resolution, end.soundness)


def _area(problem: FiniteProblem, start: Deformation) -> float | None:
    """Return the area that the mesh is to hold, in space; of one-sided bounds the end takes care."""
    for functional in problem.constraints:
        if type(functional) is Area and functional.bound == "equal" and problem.field.dimension == 3:
            own = SurfaceArea(start.rest.energy.faces, len(start.positions)).value(start.positions)
            return _as_the_mesh_measures(problem, own, Area(), functional.target)
    return None


def _volume(problem: FiniteProblem, start: Deformation) -> tuple[float | None, str]:
    """Return the volume that the mesh is to hold, and on which side; of other functionals the end takes care."""
    for functional in problem.constraints:
        if type(functional) is Volume:
            own = start.rest.volume.value(start.positions)
            return _as_the_mesh_measures(problem, own, Volume(), functional.target), functional.bound
    return None, "equal"


def _as_the_mesh_measures(problem: FiniteProblem, own: float, functional: Functional, target: float | None) -> float:
    """Return what the mesh is to measure for a target, from what it measures now; None is to keep that.

    The mesh lies within its surface: what it measures is in proportion.
    """
    if target is None:
        return own
    measured = ConstraintSet.of(problem.precise, [functional], Holding(resolution=problem.resolution)).targets[0]
    return own * target / measured


def turning(targets: AveragedTargets) -> float:
    """Return by how much the handles turn against each other along their path, in radians.

    It is the largest sum, over small parts of the path, of the angles by which the best rigid motion of a handle's
    points and that of all of them turn against each other.
    """
    groups = [weights > 0 for weights in targets.handle_weights]
    if len(groups) < 2:
        return 0.0
    total = [0.0] * len(groups)
    before = targets.positions(0.0)
    for k in range(1, LOOKS + 1):
        after = targets.positions(k / LOOKS)
        whole = _rotation(before, after, targets.prescribed)
        for number, group in enumerate(groups):
            total[number] += _angle(whole.T @ _rotation(before, after, group))
        before = after
    return max(total)


def _way(targets: AveragedTargets) -> float:
    """Return how far from its place a handle takes a point at most, on its path."""
    at, start = targets.prescribed, targets.points
    return max(float((targets.positions(k / LOOKS) - start)[at].norm(dim=1).max()) for k in range(1, LOOKS + 1))


def _rotation(before: Tensor, after: Tensor, which: Tensor) -> Tensor:
    weights = torch.ones_like(before[which][:, 0])
    return Placement.fitting(before[which], after[which], weights).rotation


def _angle(rotation: Tensor) -> float:
    return float(torch.arccos(((rotation.trace() - (len(rotation) - 2)) / 2).clamp(-1, 1)))


def _stays_inside(field: Field, positions: FloatArray) -> bool:
    lower, upper = field.bounds.double().cpu().numpy()
    margin = MARGIN * field.size
    return bool(((positions > lower + margin) & (positions < upper - margin)).all())


def _follower(problem: FiniteProblem, start: Deformation, minimum: Minimum) -> Follower:
    """Return the field on its way to the moved surface.

    It learns what the field at rest is carried to, so that of many edits none adds its own misses to the next.
    """
    begin = start.field if problem.warp else _start(problem, start.map_to(minimum))
    return Follower(
        start.field.to(torch.float32),
        start.map_from_rest(minimum),
        values="auto",
        start=begin.to(torch.float32),
        samples=SAMPLES,
        batch=BATCH,
        seed=problem.seed,
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """A field in float64, how sound it is (None where it cannot be meshed), and whether it has the pieces of before."""

    field: Field
    soundness: Soundness | None
    sound: bool

    @classmethod
    def of(cls, problem: FiniteProblem, field: Field, wanted: Topology) -> _Found:
        try:  # in the precision of the field that was given, so that this is also the evidence of the end
            soundness = field_soundness(field.to(problem.field.dtype), problem.resolution)
        except SurfaceError:
            return cls(field, None, False)
        return cls(field, soundness, soundness.topology.same_type(wanted))


def _followed(problem: FiniteProblem, follower: Follower, rest: Topology, tell: _Teller) -> tuple[_Found, Following]:
    """Return the field on the moved surface, trained until it is there in as many pieces as before."""
    last = float("inf")
    for number, steps in enumerate(ROUNDS):
        tell.round(number)
        trained, following = follower.train(steps, tell.field)
        found = None
        stalled = following.miss_rms > STALLED * last and following.miss_rms <= FOLLOWED * trained.size
        if (
            following.miss_rms <= NEAR * trained.size
            or stalled
            or following.status is FitStatus.DIVERGED
            or number == len(ROUNDS) - 1
        ):
            found = _Found.of(problem, problem.precise.with_theta(trained.theta.double()), rest)
            if found.sound or following.status is FitStatus.DIVERGED:
                break
        last = following.miss_rms
    assert found is not None
    return found, following


def _warped(
    problem: FiniteProblem, start: Deformation, minimum: Minimum, follower: Follower, rest: Topology
) -> tuple[_Found, Following]:
    """Return the field at rest in warped space, of the width that leaves least strain in as many pieces as before."""
    found = None
    least = float("inf")
    there = start.map_from_rest(minimum)
    goals, masses = (torch.from_numpy(part).to(problem.precise.theta) for part in (there.moved, there.rest.masses))
    towards = TowardsPoints(goals, masses, start.rest.laplacian, problem.seed)
    ways = [Back(there, width) for width in WARP_WIDTHS]
    if ways[0].missed > WARP_MISSED:
        ways.reverse()
    for way in ways:
        field = way.warped(start.field, problem.seed)
        tried, left = _Found.of(problem, field, rest), towards.left(field).energy()
        if found is None or (tried.sound, -left) > (found.sound, -least):
            found, least = tried, left
        if found.sound and least <= WARP_LEFT * minimum.energy:
            break
    assert found is not None
    return found, follower.judged(found.field)


def _start(problem: FiniteProblem, surface_map: SurfaceMap) -> Field:
    """Return the field after the rigid motion that goes nearest to the map, where that can be had in closed form."""
    field, rest = problem.precise, surface_map.rest
    start, moved, masses = (
        torch.from_numpy(part).to(field.theta) for part in (rest.vertices, surface_map.moved, rest.masses)
    )
    whole = Placement.fitting(start, moved, masses)
    if moved_as_a_whole(field, whole.rotation, whole.translation) is None:
        return field
    return whole.field(field)


@dataclass(frozen=True, eq=False)
class _End:
    """A field at the end of an edit, with its rows, how the last steps ended, and what is not known of what is held.

    How sound it is stands beside it, where that is known.
    """

    field: Field
    history: list[Row]
    status: EditStatus
    notes: tuple[str, ...]
    soundness: Soundness | None


def _polished(
    problem: FiniteProblem,
    found: _Found,
    surface_map: SurfaceMap,
    laplacian: sparse.csc_array,
    rest: Topology,
    row: Row,
) -> _End:
    """Return the field nearer to the least energy, with the functionals at their targets."""
    goals = torch.from_numpy(surface_map.moved).to(found.field.theta)
    masses = torch.from_numpy(surface_map.rest.masses).to(found.field.theta)
    operation = TowardsPoints(goals, masses, laplacian, problem.seed)
    enough, began = (WARP_LEFT if problem.warp else STRAIN_LEFT) * row["energy"], time.perf_counter()
    taken = 0
    if found.sound:
        found, taken = _nearer(problem, found, operation, enough, rest)
    row = {**row, "strain_left": operation.left(found.field).energy()}
    row["seconds"] += time.perf_counter() - began
    done = taken > 0 or len(found.field.theta) <= MOST or row["strain_left"] <= enough
    if found.sound and not problem.constraints and done:
        return _End(found.field, [row], EditStatus.DONE, (), found.soundness)
    return _mended(problem, found, operation, rest, row)


def _nearer(
    problem: FiniteProblem, found: _Found, operation: TowardsPoints, enough: float, rest: Topology
) -> tuple[_Found, int]:
    """Return a sound field with less strain between its surface and the points, and how many steps were taken.

    Of a wide field they are taken in lots, and the last sound one counts: on their way thin parts may come off and grow
    together again.
    """
    lots = LOTS_OF_WIDE if len(found.field.theta) > MOST else 1
    field, taken = found.field, 0
    for lot in range(lots):
        field, steps = nearer(replace(operation, firmness=1.0 if lot == 0 else LATER_FIRMNESS), field, enough)
        taken += steps
        if steps == 0:
            break
        moved = _Found.of(problem, field, rest)
        found = moved if moved.sound else found
        if moved.sound and operation.left(field).energy() <= enough:
            break
    return found, taken


def _mended(problem: FiniteProblem, found: _Found, operation: TowardsPoints, rest: Topology, row: Row) -> _End:
    """Return the field after steps of boundary sensitivity that restore the functionals, or mend the pieces."""
    held = ConstraintSet.of(problem.precise, problem.constraints, Holding(resolution=problem.resolution), tuple(row))
    loop = Loop(operation, held, changing=False)
    left = operation.left(found.field)
    state = loop.start(found.field, SurfaceSample(left.points, left.normals, operation.weights), None)
    rows: list[Row] = []
    status, notes, first = EditStatus.DONE, tuple[str, ...](), found.field
    for number in range(LAST_STEPS):
        needed = bool(problem.constraints) and not rows
        # Steps of wide fields know no strain, and cost much.
        near = left.energy() <= STRAIN_LEFT * row["energy"] or (len(found.field.theta) > MOST and bool(rows))
        if not needed and found.sound and near:
            break
        for firmness in FIRMNESS:
            fresh = replace(state, damping=AdaptiveDamping.of_precision(first.dtype)) if firmness > 1 else state
            try:
                step = replace(loop, operation=replace(operation, firmness=firmness)).step(fresh)
            except StepRefused as refusal:
                refused = refusal.status
                continue
            after = operation.left(step.state.field)
            # What mends the pieces may cost energy, but what breaks them is not taken, nor what only costs energy.
            moved = _Found.of(problem, step.state.field, rest)
            better = moved.sound > found.sound or needed or after.energy() < left.energy()
            if (moved.sound or not found.sound) and better:
                break
            refused = EditStatus.STRAY_PIECES if found.sound and not moved.sound else EditStatus.DONE
        else:
            status = refused if needed else status
            break
        state, left, found = step.state, after, moved
        rows.append({**step.row, "step": number + 2})
    if not rows or not problem.constraints:
        return _End(state.field, [row, *rows], status, notes, found.soundness)
    state, rows[-1] = loop.polished(state, rows[-1])
    row = {**row, **held.values(held.measure(first))}
    notes = tuple(held.unresolved(rows[-1]["constraint_error"]))
    return _End(state.field, [row, *rows], status, notes, None)


def _edit(problem: FiniteProblem, surface_map: SurfaceMap, end: _End, began: float) -> Edit:
    """Return the edit without its evidence."""
    sample = problem.sample
    points = _placed(end.field, surface_map, sample.points)
    tracked = None if problem.track is None else _placed(end.field, surface_map, problem.track)
    return Edit(
        field=end.field.to(problem.field.dtype),
        points=sample.points,
        normals=sample.normals,
        weights=sample.weights,
        displacement=points - sample.points,
        wanted=problem.targets.target(),
        tracked=tracked,
        trail=() if tracked is None else (tracked,) * len(end.history),
        history=end.history,
        status=end.status,
        seconds=time.perf_counter() - began,
    )


def _with_stages(edit: Edit, problem: FiniteProblem, points: _Points) -> Edit:
    """Return the edit with a row, and where the tracked points were, for each stage of the points' way."""
    if not points.stages:
        return edit
    start, nan = problem.start, float("nan")
    track = None if problem.track is None else problem.track.double().cpu().numpy()
    foot = None if track is None else start.map_to(points.minimum).foot(track)
    rows: list[Row] = []
    trail: list[Tensor] = []
    for stage in points.stages:
        turned = start.rest.energy.rotations(stage.positions)
        here = Minimum(stage.positions, turned, stage.energy, 0, nan, nan, MinimumStatus.ITERATIONS_SPENT)
        there = start.map_to(here)
        row = _row(problem, problem.precise, there, here, None, stage.seconds)
        rows.append({**row, "method": f"{row['method']}, on the way"})
        if foot is not None:
            trail.append(torch.from_numpy(there.at(foot)).to(problem.track))
    first, *others = edit.history
    spent = sum(stage.seconds for stage in points.stages)
    last = {key: first[key] - spent for key in ("seconds", "seconds_points", "seconds_solve")}
    rows = [{**row, "step": number} for number, row in enumerate((*rows, {**first, **last}, *others), 1)]
    return replace(edit, history=rows, trail=(*trail, *edit.trail))


def _untouched(problem: FiniteProblem, status: EditStatus, began: float) -> Edit:
    """Return an edit that took no step."""
    sample = problem.sample
    return Edit(
        field=problem.field.with_theta(problem.field.theta),
        points=sample.points,
        normals=sample.normals,
        weights=sample.weights,
        displacement=torch.zeros_like(sample.points),
        wanted=problem.targets.target(),
        tracked=problem.track,
        trail=(),
        history=[],
        status=status,
        seconds=time.perf_counter() - began,
    )


def _mapped(surface_map: SurfaceMap, points: Tensor) -> Tensor:
    return torch.from_numpy(surface_map.at(points.double().cpu().numpy())).to(points)


def _placed(field: Field, surface_map: SurfaceMap, points: Tensor) -> Tensor:
    """Return points of the unedited surface where the map takes them, brought onto the edited field's."""
    goals = _mapped(surface_map, points)
    found, arrived = newton_to_surface(field, goals, reach=field.size / 20)
    return torch.where(arrived[:, None], found, goals)


def _row(
    problem: FiniteProblem,
    edited: Field,
    surface_map: SurfaceMap,
    minimum: Minimum,
    following: Following | None,
    seconds_points: float,
) -> Row:
    """Return the record of the points and of the field that followed, in the columns that every edit has.

    Args:
        following: None where field and points went together.
    """
    nan = float("nan")
    seconds = seconds_points + (0.0 if following is None else following.seconds)
    return {
        "step": 1,
        "energy": minimum.energy,
        "iterations": minimum.iterations,
        "largest_move": minimum.largest_move,
        "volume_gap": minimum.volume_gap,
        "follow_steps": 0 if following is None else following.steps,
        "miss_rms": 0.0 if following is None else following.miss_rms,
        "miss_max": 0.0 if following is None else following.miss_max,
        "crossed": nan if following is None else following.crossed,
        "values_off_surface": "carried" if following is None else following.values,
        "seconds_points": seconds_points,
        "seconds_field": seconds - seconds_points,
        "constraint_gap": minimum.volume_gap,
        "residual": 0.0 if following is None else following.miss_rms,
        "objective": minimum.energy,
        "condition": nan,
        "rank": nan,
        "damping": 0.0,
        "method": _method(problem),
        "largest_motion": float(np.linalg.norm(surface_map.moved - surface_map.rest.vertices, axis=1).max()),
        "linearity_error": nan,
        "d_theta_norm": nan if problem.warp else float((edited.theta - problem.precise.theta).norm()),
        "points_lost": 0,
        "solve_status": minimum.status.value,
        "solves": minimum.iterations,
        "seconds_solve": seconds_points,
        "seconds": seconds,
    }


def _method(problem: FiniteProblem) -> str:
    """Return the name of the way in the records."""
    if problem.coupled is not None:
        return "finite rotations, coupled"
    return "finite rotations, warp" if problem.warp else "finite rotations"


def _minimum_note(minimum: Minimum) -> str:
    return (
        f"The points had not come to rest: {minimum.status.value} The last of {minimum.iterations} iterations moved "
        f"one by {minimum.largest_move:.2g} of the size. Move the handles less, or in several edits."
    )


def _apart_note(crossed: float, words: str, told: bool) -> str:
    how = f"{crossed:.2g} of their surface inside another part," if crossed > CROSSED else "on their way,"
    more = " Take constraints=[Volume()] to hold it to the field's own digits." if told else ""
    return (
        f"The points of least energy pass through each other, {how} which no field can show. With {words} they do "
        f"not, and so it was done.{more}"
    )


def _unwound_note(highest: float, end: float) -> str:
    return (
        f"The energy of the points fell from {highest:.2g} on their way to {end:.2g} at the goal: what was turned has "
        "unwound, through itself, for so much turning in so short a part has no rest. Turn less, or a longer part."
    )


def _strain_notes(row: Row, warp: bool) -> list[str]:
    """Return what to know of the strain between the field's surface and the points."""
    part = row["strain_left"] / row["energy"] if row["energy"] > 0 else 0.0
    if part <= RIPPLED:
        return []
    if warp:
        return [
            f"The warp does not take the surface just where the points are: a strain of {part:.2g} times the energy of "
            "the points is left. Move the handles less."
        ]
    return [
        f"The field's surface ripples about where the points are, a strain of {part:.2g} times the energy of the "
        "points. A wider network follows better, and of shapes with planes and sharp edges one of softplus units; "
        'method="warp" leaves the network as it is and warps its space, which keeps the surface.'
    ]


def _at_the_end(following: Following, field: Field, surface_map: SurfaceMap) -> Following:
    """Return how near a field that could not follow has come by the last steps."""
    if following.miss_rms <= FOLLOWED * field.size:
        return following
    goals, reach = torch.from_numpy(surface_map.moved).to(field.theta), field.size / 20
    found, arrived = newton_to_surface(field, goals, reach=reach)
    apart = torch.where(arrived, (found - goals).norm(dim=1), reach)
    rms, most = float(apart.square().mean().sqrt()), float(apart.max())
    return replace(following, miss_rms=rms, miss_max=most, lost=float((~arrived).double().mean()))


def _following_notes(field: Field, following: Following) -> list[str]:
    """Return what to know of how the field followed."""
    notes = []
    size = field.size
    if following.miss_rms > FOLLOWED * size or following.status is FitStatus.DIVERGED:
        notes.append(
            f"The field could not follow: its surface is {following.miss_rms / size:.2g} of the size away from where "
            f"the points are (root mean square; {following.miss_max / size:.2g} at most). A wider network can."
        )
    return notes


class _Teller:
    """Tells the caller's progress of both parts of the work, in hundredths of the whole.

    Args:
        progress: The caller's, or None.
    """

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._last = 0
        self._round = 0

    def round(self, number: int) -> None:
        """Begin a round of the optimiser."""
        self._round = number

    def points(self, iteration: int, energy: float, move: float) -> None:
        """Tell of an iteration of the points; how many there will be is not known."""
        done = round(20 * iteration / (iteration + 40))
        self._tell(done, {"phase": "points", "iteration": iteration, "largest_move": move})

    def field(self, step: int, steps: int, loss: float) -> None:
        """Tell of a step of the optimiser."""
        done = 1 - 0.5**self._round * (1 - 0.5 * step / steps)
        self._tell(20 + round(75 * done), {"phase": "field", "iteration": step, "loss": loss})

    def _tell(self, done: int, row: Row) -> None:
        if self._progress is not None and done > self._last:
            self._last = done
            self._progress(done, 100, {"step": done, **row})
