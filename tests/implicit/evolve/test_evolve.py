"""The loop on balls that move and grow, and steps that change nothing but what they return."""

from dataclasses import dataclass

import pytest
import torch

from implicit import Area, EditStatus, Handle, Holding, Volume, decoder_field, prescribe, sample_surface, shapes
from implicit.edits.flows import MeanCurvature
from implicit.edits.geometric_parts import GeometricOperation, PartSchedule
from implicit.edits.handles import Along
from implicit.edits.regions import Ball
from implicit.edits.semantic import SemanticOperation
from implicit.edits.smoothing import SmoothingOperation, Until
from implicit.edits.targets import SummedTargets, checked_handles
from implicit.evolve.constraints import ConstraintSet
from implicit.evolve.evolve import Loop, evolve, first_solve
from implicit.evolve.operation import Outcome, State
from implicit.evolve.record import COLUMNS
from implicit.evolve.trial import StepRefused
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import Projection, StepProblem


@dataclass(frozen=True)
class Growth:
    """Moves the surface outward by the same distance in each step; the memory counts the steps taken."""

    distance: float
    most: int | None = None

    columns = ("taken_before",)

    def start(self, field, points):
        return 0

    def finished(self, state, history):
        return EditStatus.REACHED if state.memory == self.most else None

    def step(self, state):
        points = state.points
        target = NormalTarget(points, torch.full_like(points[:, 0], self.distance), torch.ones_like(points[:, 0]))
        return StepProblem(DeformationSpace(state.field), [target], row={"taken_before": state.memory})

    def taken(self, state, taken):
        return Outcome(state.memory + 1, steps=7)


def ball():
    return shapes.sphere(0.4, parameters=["radius"])


def start_of(field, count=40):
    return sample_surface(field, count, resolution=16)


def test_a_ball_grows_by_what_each_step_asks_and_its_points_ride_along():
    field = ball()
    start, track = start_of(field), start_of(field, 9).points
    told = []
    edit = evolve(
        field,
        Growth(0.02),
        start,
        steps=3,
        track=track,
        wanted=0.06 * start.normals,
        progress=lambda step, steps, row: told.append((step, steps, row["step"])),
    )
    assert edit.status is EditStatus.DONE
    assert float(edit.field.theta) == pytest.approx(0.46, abs=1e-8)
    torch.testing.assert_close(edit.displacement, 0.06 * start.normals, atol=1e-8, rtol=0)
    for k, trail in enumerate(edit.trail, start=1):
        torch.testing.assert_close(
            trail.norm(dim=1), torch.full((9,), 0.4 + 0.02 * k, dtype=torch.float64), atol=1e-8, rtol=0
        )
    assert torch.equal(edit.trail[-1], edit.tracked)
    assert [row["taken_before"] for row in edit.history] == [0, 1, 2]
    assert told == [(1, 7, 1), (2, 7, 2), (3, 7, 3)]  # the operation knows how many there will be


def test_a_step_short_of_its_target_is_told_from_a_rule_that_is_met():
    field = ball()
    start = start_of(field)
    options = {"steps": 3, "wanted": 0.04 * start.normals}
    assert evolve(field, Growth(0.02, most=2), start, **options).status is EditStatus.REACHED
    short = evolve(field, Growth(0.02, most=1), start, **options)
    assert (short.status, len(short.history)) == (EditStatus.NOT_REACHED, 1)
    none = evolve(field, Growth(0.02, most=0), start, steps=3)
    assert (none.status, none.history, none.trail) == (EditStatus.REACHED, [], ())
    assert torch.equal(none.displacement, torch.zeros_like(start.points))


def test_a_ball_whose_volume_is_held_does_not_grow():
    field = ball()
    edit = evolve(field, Growth(0.02), start_of(field), steps=2, constraints=(Volume(),), resolution=24)
    assert float(edit.field.theta) == pytest.approx(0.4, abs=1e-8)
    assert edit.history[-1]["volume"] == pytest.approx(shapes.exact_volume(field), rel=1e-5)
    assert edit.history[-1]["constraint_gap"] < 1e-8


def test_a_volume_is_restored_within_each_step():
    """To first order a tenth more volume is a thirtieth more radius; after each step it is the cube root of 1.1."""
    field = ball()
    more = Volume(1.1 * shapes.exact_volume(field))
    track = start_of(field, 5).points
    edit = evolve(field, Growth(0.0), start_of(field), steps=2, constraints=(more,), resolution=24, track=track)
    for trail in edit.trail:
        radius = torch.full((5,), 0.4 * 1.1 ** (1 / 3), dtype=torch.float64)
        torch.testing.assert_close(trail.norm(dim=1), radius, atol=1e-5, rtol=0)


def test_the_columns_of_a_row_are_in_their_order():
    field = ball()
    edit = evolve(field, Growth(0.02), start_of(field), steps=1, constraints=(Area(),), resolution=16, changing=True)
    named = list(edit.history[0])
    assert named[:5] == ["step", "taken_before", "components", "euler", "area"]
    assert [name for name in named if name in COLUMNS] == [name for name in COLUMNS if name != "event"]


def test_the_first_solve_is_that_of_the_first_step():
    field = ball()
    system, solution = first_solve(field, Growth(0.02), start_of(field))
    assert float(solution.x) == pytest.approx(0.02, rel=1e-6)
    assert float(system.inverse(system.right)) == pytest.approx(0.02, rel=1e-6)


def test_a_ball_that_would_leave_its_bounds_stays_as_it_was():
    """From 0.4 to 0.9, and not on to 1.4 where the field ends at 1."""
    field = ball()
    edit = evolve(field, Growth(0.5), start_of(field), steps=3, resolution=16, changing=True)
    assert (edit.status, len(edit.history)) == (EditStatus.SURFACE_LOST, 1)
    assert float(edit.field.theta) == pytest.approx(0.9, abs=1e-6)
    assert float(edit.displacement.norm(dim=1).mean()) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(("changing", "lost"), [(True, 3), (False, 1)])
def test_lost_points_go_on_from_the_nearest_of_the_surface_or_end_the_edit(changing, lost):
    """Of 40 points, one lost is more than the fiftieth that an edit may lose where no piece can vanish."""
    field = ball()
    loop = Loop(Growth(0.02), ConstraintSet.of(field, (), Holding(resolution=16)), changing)
    state = loop.start(field, start_of(field), None)
    arrived = torch.ones(40, dtype=torch.bool)
    arrived[:lost] = False
    astray = state.tracked.clone()
    astray[:lost] *= 1.5
    projection = Projection(astray, arrived)
    if not changing:
        with pytest.raises(StepRefused, match="surface would vanish"):
            loop._found_again(projection, state.measured)
        return
    points = loop._found_again(projection, state.measured)
    assert torch.equal(points[lost:], astray[lost:])
    assert float((points[:lost] - state.tracked[:lost]).norm(dim=1).max()) < 0.05  # a cell of the quadrature
    assert bool((astray[:lost].norm(dim=1) > 0.59).all())  # the projection is left as it was


def geometric(field):
    start = start_of(field, 80)
    handles = checked_handles(Handle(Ball((0.4, 0, 0), 0.3, falloff=0.1), Along(0.05)))

    def targets_of(points, normals):
        return SummedTargets(handles, points, normals)

    return GeometricOperation(field, targets_of, start, PartSchedule.of(None, 0.05), None, 1e-2, None, 0), start


def smoothing(field):
    start = start_of(field, 80)
    operation = SmoothingOperation(MeanCurvature(), 1e-3, True, None, Until(time=2e-3), 1e-2, 0.0, 80, 40, None, seed=0)
    return operation, start


def semantic(field):
    points, displacements = prescribe(field, Handle(Ball((0.4, 0, 0), 0.3), Along(0.05)), 20, resolution=16)
    start = sample_surface(field, 20, resolution=16)
    start = type(start)(points, field.normal(points), torch.ones_like(points[:, 0]))
    return SemanticOperation(start, displacements, 0.02, 0.1, None, None, 0.5, 0.05), start


def decoded():
    def decoder(points, code):
        return (points * (1 + code[:3])).norm(dim=1) - 0.4 - code[3]

    return decoder_field(decoder, torch.zeros(4, dtype=torch.float64))


@pytest.mark.parametrize("kind", [geometric, smoothing, semantic])
def test_a_step_can_be_taken_again_from_its_state(wobbly, kind):
    """With the same bits, after others were taken and after the operation was asked whether it is finished."""
    field = decoded() if kind is semantic else wobbly
    operation, start = kind(field)
    changing = kind is smoothing
    loop = Loop(operation, ConstraintSet.of(field, (), Holding(resolution=16)), changing)
    first = loop.step(loop.start(field, start, None))
    before = first.state
    assert isinstance(before, State)
    once = loop.step(before)
    for _ in range(2):
        operation.finished(before, [once.row])
    loop.step(once.state)
    again = loop.step(before)
    assert torch.equal(once.state.field.theta, again.state.field.theta)
    assert torch.equal(once.state.tracked, again.state.tracked)
    times = ("seconds", "seconds_solve")
    assert {k: v for k, v in once.row.items() if k not in times} == {
        k: v for k, v in again.row.items() if k not in times
    }


def test_equal_parts_and_parts_by_the_error_end_at_one():
    equal = PartSchedule.of(3)
    assert [equal.advance(1, 0.5, 9).then, equal.advance(1, 0.5, 9).advance(2, 0.5, 1).then] == [2 / 3, 1.0]
    assert equal.count(1) == 3
    free, step = PartSchedule.of(None, largest=0.1), 0
    assert free.then == pytest.approx(1 / 16)
    while free.now < 1:
        step += 1
        free = free.advance(step, 0.024, 1)  # twice the error that is aimed at: each part half as long
    assert step == 24  # the most parts there may be
    kinked = PartSchedule.of(None, largest=0.1, kinked=True)
    assert kinked.advance(1, 0.2, 1).share == kinked.share  # no smaller part would be more linear
    assert kinked.advance(2, 0.2, 2).share < kinked.share  # but those after one that had to be damped are
    quick = PartSchedule.of(None, largest=0.1).advance(1, 1e-9, 1)
    assert quick.share == pytest.approx(1.5 / 16)
    even = PartSchedule.of(None, largest=0.1).advance(1, 0.012, 1)  # just the error that is aimed at
    assert (even.now, even.then, even.count(2)) == (pytest.approx(1 / 16), pytest.approx(2 / 16), 16)
