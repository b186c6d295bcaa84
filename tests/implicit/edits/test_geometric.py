"""Geometric edits on shapes whose answer is known, and on a network."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from implicit import (
    Along,
    Area,
    Ball,
    Field,
    HalfSpace,
    Handle,
    RigidMotion,
    SurfaceSample,
    Volume,
    geometric_edit,
    sample_surface,
    shapes,
    surface_quadrature,
)
from implicit.edits.enough_points import MOST_POINTS
from implicit.evolve.edit import EditStatus, with_evidence
from tests.implicit.conftest import Occupancy, Wobbly, seeded_siren

EVERYWHERE = Ball((0, 0, 0), 10.0)
ALONE = {"off_surface_strength": 0.0}  # the surface alone; tied to the field around it, it is met to 1e-5 or so


def bump(field, height=0.1):
    """A smooth bump on top of the wobbly sphere."""
    return Handle(Ball((0, 0, 0.5), 0.15, falloff=0.35), Along(height))


BUMP = {"points": 400, "steps": 2, "resolution": 24}


def with_wide_cells(field):
    """In bounds of twice the length the cells of a quadrature are twice as wide, and a quarter as many."""
    return Field(field.module, bounds=((-2.0,) * 3, (2.0,) * 3))


@pytest.fixture(scope="module")
def raised():
    """One edit that several tests look at: the field, its parameters as they were, the edit, and what it told."""
    field, told = Field(Wobbly(seeded_siren(16))), []
    theta = field.theta.clone()
    edit = geometric_edit(field, bump(field), **BUMP, progress=lambda step, steps, row: told.append((step, steps)))
    return SimpleNamespace(field=field, theta=theta, edit=edit, told=told)


@pytest.mark.parametrize("steps", [1, 4])
def test_a_sphere_grows_exactly(steps):
    field = shapes.sphere(radius=0.5)
    edit = geometric_edit(field, Handle(EVERYWHERE, Along(0.1)), steps=steps, points=100, resolution=16)
    assert edit.status is EditStatus.DONE
    assert float(edit.error_field().abs().max()) < 1e-6
    assert shapes.exact_volume(edit.field) == pytest.approx(4 / 3 * math.pi * 0.6**3, rel=1e-5)


def test_a_sphere_moves_as_a_whole():
    """A translation is not a motion along the normal; the field must still end in the right place."""
    field = shapes.sphere(radius=0.4)
    edit = geometric_edit(field, Handle(EVERYWHERE, (0.2, 0.0, -0.1)), steps=4, points=300, **ALONE)
    center = (edit.tracked if edit.tracked is not None else edit.points + edit.displacement).mean(dim=0)
    assert float(edit.error_field().abs().max()) < 1e-6
    torch.testing.assert_close(
        center, edit.points.mean(dim=0) + torch.tensor([0.2, 0.0, -0.1], dtype=torch.float64), rtol=0, atol=1e-3
    )


def test_a_bump_is_raised_and_the_rest_stays(wobbly):
    edit = geometric_edit(wobbly, bump(wobbly), points=1500, steps=6)
    error = edit.error_field()
    assert float(error.square().mean().sqrt()) < 0.02
    still = edit.wanted.norm(dim=1) == 0
    moved = (edit.displacement * edit.normals).sum(dim=1)[still]
    assert float(moved.square().mean().sqrt()) < 0.02 * 0.1


def test_error_field_is_measured_on_the_edited_field(raised):
    """Without an edit the achieved displacement is zero, so the error is the whole target."""
    unedited = replace(raised.edit, field=raised.field)
    largest = unedited.error_field().abs().max()
    assert float(largest) == pytest.approx(1.0, abs=0.15)


def test_error_field_is_the_way_along_the_starting_normal():
    """A sphere was to grow to 0.6 and also slipped by s along x: on the ray from the centre at the angle a to x its
    radius is s cos a + sqrt(0.6^2 - s^2 sin^2 a)."""
    slip = 0.01
    edit = geometric_edit(shapes.sphere(radius=0.5), Handle(EVERYWHERE, Along(0.1)), steps=1, points=200)
    slipped = replace(edit, field=shapes.sphere(radius=0.6, center=(slip, 0, 0)))
    cosine = edit.normals[:, 0]
    reached = slip * cosine + (0.36 - slip**2 * (1 - cosine**2)).sqrt()
    torch.testing.assert_close(slipped.error_field(), (reached - 0.6) / 0.1, rtol=0, atol=2e-5)


def test_a_turned_region_is_judged_along_its_turned_normals():
    """A rotation of a sphere asks for nothing: turned by a quarter, normals and surface agree again."""
    field = shapes.sphere(radius=0.5)
    turn = Handle(EVERYWHERE, RigidMotion(rotation=(0, 0, math.pi / 2)))
    edit = geometric_edit(field, turn, steps=1, points=200)
    wanted, along = edit.asked(edit.points, edit.normals)
    torch.testing.assert_close(along, (edit.points + wanted) / 0.5, rtol=0, atol=1e-6)


def test_the_error_can_be_asked_for_at_other_points(raised):
    edit = raised.edit
    again = edit.error_field(SurfaceSample(edit.points, edit.normals, edit.weights))
    assert torch.equal(again, edit.error_field())
    dense = surface_quadrature(raised.field, 24)
    error = edit.error_field(dense)
    assert error.shape == dense.weights.shape
    assert bool(torch.isfinite(error).all())
    with pytest.raises(TypeError, match="must be a SurfaceSample, but is a Tensor"):
        edit.error_field(dense.points)


def test_a_larger_displacement_takes_more_parts():
    """The first part tries little; the linearity error of each sizes the next."""
    field = shapes.sphere(radius=0.3)
    small, large = (geometric_edit(field, Handle(EVERYWHERE, Along(h)), points=200) for h in (0.02, 0.3))
    assert len(small.history) < len(large.history) <= 24
    for edit in (small, large):
        fractions = [row["fraction"] for row in edit.history]
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1.0
        assert edit.status is EditStatus.DONE
        assert float(edit.error_field().abs().max()) < 1e-6


def test_points_are_drawn_anew_where_they_thin_out():
    """A ball drawn out to an ellipsoid three times as long: its area grows, and with it the number of points."""
    field = shapes.ellipsoid((0.25, 0.25, 0.25))
    stretch = Handle(EVERYWHERE, lambda points: points * torch.tensor([0.0, 0.0, 2.0], dtype=points.dtype))
    edit = geometric_edit(field, stretch, steps=8, points=400)
    assert edit.history[0]["points_used"] == 400
    assert edit.history[-1]["points_used"] > 600
    assert float(edit.error_field().abs().max()) < 1e-3


def test_points_that_only_slide_can_be_left_out():
    """Moved along x, the points of a sphere on the circle x = 0 slide along it."""
    field = shapes.sphere(radius=0.5)
    edit = geometric_edit(field, Handle(EVERYWHERE, (0.1, 0, 0)), steps=2, points=300, least_alignment=0.3, **ALONE)
    left_out = torch.isnan(edit.wanted).any(dim=1)
    assert torch.equal(left_out, edit.normals[:, 0].abs() < 0.3)
    assert float(edit.error_field()[~left_out].abs().max()) < 1e-6


def test_a_piece_of_surface_that_appears_is_reported():
    """Judged on a field with a second ball, which stands for what an edit might leave."""
    ball = shapes.sphere(radius=0.3, center=(-0.4, 0, 0))
    edit = geometric_edit(ball, Handle(EVERYWHERE, Along(0.01)), steps=1, points=100)
    assert (edit.status, edit.notes) == (EditStatus.DONE, ())
    assert (edit.before.topology.components, edit.after.topology.components) == (1, 1)
    assert edit.after.slope_median == pytest.approx(1.0, abs=1e-6)
    two = shapes.smooth_union(ball, shapes.sphere(radius=0.1, center=(0.6, 0, 0)), blend=0.01)
    stray = with_evidence(replace(edit, field=two), ball, edit.before, 48)
    assert stray.status is EditStatus.STRAY_PIECES
    assert "2 pieces" in stray.notes[0]


def test_volume_can_be_kept_while_a_bump_is_raised(wobbly):
    field = with_wide_cells(wobbly)
    before = Volume().value(field, surface_quadrature(field, 48))
    options = {"points": 300, "steps": 3, "resolution": 24}
    edit = geometric_edit(field, bump(field), rest="free", constraints=(Volume(),), **options)
    edited = wobbly.with_theta(edit.field.theta)
    after = Volume().value(edited, surface_quadrature(edited, 40))
    assert after == pytest.approx(Volume().value(wobbly, surface_quadrature(wobbly, 40)), rel=1e-5)
    assert edit.history[-1]["volume"] == pytest.approx(before, rel=1e-7)


def test_two_functionals_can_be_kept_at_once(wobbly):
    field = with_wide_cells(wobbly)
    sample = surface_quadrature(field, 48)
    before = Volume().value(field, sample), Area().value(field, sample)
    options = {"points": 300, "steps": 2, "resolution": 24}
    edit = geometric_edit(field, bump(field, 0.03), rest="free", constraints=(Volume(), Area()), **options)
    assert edit.history[-1]["volume"] == pytest.approx(before[0], rel=1e-7)
    assert edit.history[-1]["area"] == pytest.approx(before[1], rel=1e-7)


def test_tracked_points_end_on_the_edited_surface_and_follow_the_handle(wobbly):
    track = sample_surface(wobbly, 50, seed=9).points
    edit = geometric_edit(
        wobbly, Handle(HalfSpace((0, 0, -2), (0, 0, 1)), (0.1, 0, 0)), steps=4, points=400, track=track, resolution=24
    )
    assert float(edit.field.value(edit.tracked).abs().max()) < 1e-10
    way = edit.tracked - track
    torch.testing.assert_close(way, torch.tensor([0.1, 0.0, 0.0], dtype=torch.float64).expand(50, 3), rtol=0, atol=0.01)


def test_a_scaled_field_gives_the_same_edit(raised):
    """Whether f is a distance or five times one must not matter."""

    class Times(nn.Module):
        def __init__(self, module):
            super().__init__()
            self.module = module

        def forward(self, points):
            return 5 * self.module(points)

    times = geometric_edit(Field(Times(raised.field.module)), bump(raised.field), **BUMP)
    torch.testing.assert_close(times.displacement, raised.edit.displacement, rtol=0, atol=1e-6)


def test_an_occupancy_gives_the_same_edit(wobbly):
    """The same network as a distance and as an occupancy, level 0.5 and large inside."""
    occupancy = Field(Occupancy(wobbly.module), level=0.5, inside="positive")
    sample = sample_surface(wobbly, 400)  # the grids of the two fields would give other points of the same surface
    options = {"points": sample, "steps": 1, "damping": 1e-5, "resolution": 24}
    plain, other = (geometric_edit(field, bump(field), **options, **ALONE) for field in (wobbly, occupancy))
    torch.testing.assert_close(other.field.theta, plain.field.theta, rtol=0, atol=1e-9)
    # In several parts, and tied to a field off the surface that is another one, the surfaces still agree.
    tied = [geometric_edit(field, bump(field), points=sample, steps=4, resolution=24) for field in (wobbly, occupancy)]
    apart = (tied[0].error_field() - tied[1].error_field()).square().mean().sqrt()
    assert float(apart) < 0.02


def test_the_same_seed_gives_the_same_bits(raised):
    again = geometric_edit(raised.field, bump(raised.field), **BUMP)
    assert torch.equal(again.field.theta, raised.edit.field.theta)


def test_progress_is_told_of_each_part(raised):
    assert raised.told == [(1, 2), (2, 2)]


def test_the_callers_field_stays_as_it_is(raised):
    assert not torch.equal(raised.edit.field.theta, raised.theta)
    assert torch.equal(raised.field.theta, raised.theta)


@pytest.mark.parametrize(
    ("handles", "options", "message"),
    [
        ([], {}, "handles is empty"),
        (
            [Handle(Ball((5, 5, 5), 0.1), Along(0.1))],
            {},
            "No point of the surface lies in the region of handles\\[0\\]",
        ),
        ([Handle(EVERYWHERE, lambda points: points * float("inf"))], {}, "not finite"),
        ([Handle(EVERYWHERE, (1.0, 0))], {}, "must be a vector of 3"),
        ([Handle(EVERYWHERE, Along(0.1))], {"steps": 0}, "steps must be at least 1"),
        ([Handle(EVERYWHERE, Along(0.1))], {"rest": "loose"}, "rest must be"),
    ],
)
def test_bad_input_is_refused(wobbly, handles, options, message):
    with pytest.raises(ValueError, match=message):
        geometric_edit(wobbly, handles, points=200, **options)


def test_an_edit_that_would_lose_the_surface_stops_before():
    """Shrinking a sphere to nothing: the last good field is returned and the status says why."""
    edit = geometric_edit(shapes.sphere(radius=0.5), Handle(EVERYWHERE, Along(-0.9)), points=300, steps=6)
    assert edit.status in (EditStatus.SURFACE_LOST, EditStatus.UNSTABLE, EditStatus.NOT_FINITE)
    assert 0.04 < float(surface_quadrature(edit.field, 24).points.norm(dim=1).mean()) < 0.5


def test_a_target_that_the_field_cannot_express_is_said_not_to_be_reached():
    """A sphere's four parameters cannot raise a bump."""
    field = shapes.sphere(radius=0.5)
    edit = geometric_edit(field, Handle(Ball((0, 0, 0.5), 0.1, falloff=0.2), Along(0.1)), points=500, steps=2)
    assert edit.status is EditStatus.NOT_REACHED


def test_a_network_too_large_for_a_matrix_is_edited_by_products(monkeypatch, wobbly):
    """The same edit with the limit lowered below the network's size."""
    options = {"points": 200, "steps": 2, "damping": 1e-3, "resolution": 24}
    dense = geometric_edit(wobbly, bump(wobbly), **options)
    monkeypatch.setattr("implicit.step.problem.DENSE_LIMIT", 100)
    free = geometric_edit(wobbly, bump(wobbly), **options)
    assert free.history[0]["method"] == "cg"
    torch.testing.assert_close(free.displacement, dense.displacement, rtol=0, atol=1e-4)


def test_points_that_lose_their_neighbours_are_not_drawn_without_end(monkeypatch):
    """As under a scaling that tears the surface apart: the area that a point stands for has no bound then."""
    drawn = []

    def draw(field, count, **options):
        drawn.append(count)
        return sample_surface(field, 60, **options)

    monkeypatch.setattr("implicit.edits.geometric_parts._Coverage.stretch", lambda *_: 1e12)
    monkeypatch.setattr("implicit.edits.geometric_parts.sample_surface", draw)
    geometric_edit(shapes.sphere(0.5), Handle(EVERYWHERE, Along(0.05)), steps=3, points=60, resolution=16)
    assert drawn
    assert max(drawn) <= MOST_POINTS


@pytest.mark.parametrize("motion", [(9.0, 0.0, 0.0), lambda points: 1e6 * points])
def test_a_displacement_longer_than_the_bounds_is_refused(motion):
    with pytest.raises(ValueError, match="from corner to corner"):
        geometric_edit(shapes.sphere(0.5), Handle(EVERYWHERE, motion), points=60, resolution=16)


def test_parts_chosen_by_the_edit_approach_at_shares_of_the_points_and_finish_at_the_goal():
    """The cow's top raised: parts take every other point, finishing ones all, and leave less than the approach."""
    field = shapes.bundled("spot")
    lift = Handle(HalfSpace((0, 0.35, 0), (0, 1, 0), falloff=0.3), (0.0, 0.05, 0.0))
    edit = geometric_edit(field, lift, points=1600, resolution=16)
    fractions = [row["fraction"] for row in edit.history]
    finishing = fractions.count(1.0) - 1
    assert finishing >= 1
    assert [row["points_used"] for row in edit.history] == [800] * (len(fractions) - finishing) + [1600] * finishing
    assert edit.status is EditStatus.DONE
    own, others = (
        edit.error_field(sample).square().mean().sqrt() for sample in (None, sample_surface(field, 500, seed=3))
    )
    assert float(others) < 4e-3
    approached = geometric_edit(field, lift, points=1600, resolution=16, steps=len(fractions) - finishing)
    assert float(own) < 0.7 * float(approached.error_field().square().mean().sqrt())
