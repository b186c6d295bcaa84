"""What handles ask of the points of a sphere, alone and where they overlap."""

import math
import re

import pytest
import torch

from implicit import (
    Along,
    Ball,
    Field,
    HalfSpace,
    Handle,
    RigidMotion,
    Units,
    expressibility,
    geometric_edit,
    prescribe,
    rigid_edit,
    shapes,
    trained_rigid_step,
)
from implicit.edits.targets import AveragedTargets, SummedTargets, checked_handles

# The six points of the unit sphere on the axes, where every answer can be said.
NORMALS = torch.cat([torch.eye(3), -torch.eye(3)]).double()
POINTS = NORMALS.clone()
EVERYWHERE = Ball((0, 0, 0), 2)
TOP = HalfSpace((0, 0, 0.5), (0, 0, 1))


def half(points):
    return torch.full_like(points[:, 0], 0.5)


def test_a_weight_scales_the_displacement():
    targets = SummedTargets([Handle(half, Along(0.2))], POINTS, NORMALS)
    torch.testing.assert_close(targets.displacement(), 0.1 * NORMALS)
    torch.testing.assert_close(targets.positions(0.5), 1.05 * POINTS)
    assert targets.largest() == pytest.approx(0.1)
    assert targets.weights.tolist() == [1] * 6


def test_displacements_add_where_handles_overlap():
    vector = torch.tensor([0.3, 0, 0], dtype=torch.float64)
    targets = SummedTargets([Handle(EVERYWHERE, Along(0.1)), Handle(TOP, vector)], POINTS, NORMALS)
    expected = 0.1 * NORMALS
    expected[2] += vector
    torch.testing.assert_close(targets.displacement(), expected)
    torch.testing.assert_close(targets.target(), expected)


@pytest.mark.parametrize(("rest", "weight"), [("fixed", 1.0), ("free", 0.0), (0.25, 0.25)])
def test_points_in_no_region_have_the_weight_of_the_rest(rest, weight):
    targets = SummedTargets([Handle(TOP, (0, 0, 0.1))], POINTS, NORMALS, rest)
    assert targets.prescribed.tolist() == [False, False, True, False, False, False]
    assert targets.weights.tolist() == [weight, weight, 1, weight, weight, weight]
    target = targets.target()
    assert target[2].tolist() == pytest.approx([0, 0, 0.1])
    assert bool(torch.isnan(target[[0, 1, 3, 4, 5]]).all()) == (weight == 0)
    assert weight == 0 or not target[[0, 1, 3, 4, 5]].any()


def test_without_handles_all_points_are_the_rest():
    targets = SummedTargets([], POINTS, NORMALS)
    assert targets.weights.tolist() == [1] * 6
    assert not targets.target().any()


def test_points_that_slide_along_the_surface_are_left_out():
    """A vector along x makes the cosines 1 at the poles of x, 0 at the others."""
    targets = SummedTargets([Handle(EVERYWHERE, (0.1, 0, 0))], POINTS, NORMALS, least_alignment=0.5)
    assert targets.weights.tolist() == [1, 0, 0, 1, 0, 0]


def test_normals_turn_with_a_turned_region_and_halfway_at_half_the_weight():
    turn = RigidMotion(rotation=(0, 0, math.pi / 2))
    whole = SummedTargets([Handle(EVERYWHERE, turn)], POINTS, NORMALS).directions()
    assert whole[0].tolist() == pytest.approx([0, 1, 0])
    part = SummedTargets([Handle(half, turn)], POINTS, NORMALS).directions()
    assert part[0].tolist() == pytest.approx([math.sqrt(0.5), math.sqrt(0.5), 0])


def test_an_average_of_two_handles_lies_between_them():
    """Weights 1 and 1/2 of the displacements a and b come to (a + b / 2) / 1.5, and count as one."""
    a, b = torch.tensor([0.3, 0, 0]).double(), torch.tensor([0, 0.6, 0]).double()
    targets = AveragedTargets([Handle(EVERYWHERE, a), Handle(half, b)], POINTS, NORMALS)
    torch.testing.assert_close(targets.positions(1.0), POINTS + (a + b / 2) / 1.5)
    assert targets.total.tolist() == [1.5] * 6
    assert targets.weights.tolist() == [1] * 6


def test_a_weight_of_an_average_scales_no_displacement_but_how_firmly_it_is_held():
    targets = AveragedTargets([Handle(half, Along(0.2))], POINTS, NORMALS)
    torch.testing.assert_close(targets.positions(0.5), 1.1 * POINTS)
    assert targets.weights.tolist() == [0.5] * 6


def test_points_that_no_handle_holds_have_no_target_and_stay():
    targets = AveragedTargets([Handle(TOP, (0, 0, 0.1))], POINTS, NORMALS)
    rest = [0, 1, 3, 4, 5]
    assert bool(torch.isnan(targets.target()[rest]).all())
    assert torch.equal(targets.positions(1.0)[rest], POINTS[rest])
    assert targets.weights.tolist() == [0, 0, 1, 0, 0, 0]


BALL = shapes.sphere(0.5)
FAR = [Handle(Ball((0, 0, 0), 1), (0, 0, 0.1)), Handle(Ball((5, 5, 5), 0.1), (0, 0, 0))]


@pytest.mark.parametrize(
    "edit",
    [
        lambda: geometric_edit(BALL, FAR, points=100),
        lambda: expressibility(BALL, FAR, points=100),
        lambda: prescribe(BALL, FAR, 10, resolution=16),
        lambda: rigid_edit(BALL, FAR, points=100),
        lambda: trained_rigid_step(BALL, FAR, points=100),
    ],
    ids=["geometric", "expressibility", "semantic", "rigid", "trained"],
)
def test_every_editor_refuses_a_region_that_misses_the_surface_in_the_same_words(edit):
    words = r"No point of the surface lies in the region of handles\[1\]\. .* spans .*; move or widen the region\."
    with pytest.raises(ValueError, match=words):
        edit()


@pytest.mark.parametrize("rest", ["loose", -1.0, math.inf, None])
def test_a_rest_that_is_no_weight_is_refused(rest):
    with pytest.raises(ValueError, match="rest must be"):
        SummedTargets([Handle(TOP, (0, 0, 0.1))], POINTS, NORMALS, rest)


def test_one_handle_is_a_list_of_one():
    handle = Handle(TOP, (0, 0, 0.1))
    assert checked_handles(handle) == checked_handles((handle,)) == [handle]
    with pytest.raises(ValueError, match="handles is empty"):
        checked_handles([])
    with pytest.raises(TypeError, match="handles must be Handle"):
        checked_handles([TOP])


def test_a_region_in_the_users_coordinates_is_told_where_the_surface_is_in_both():
    """A unit sphere that is 40 x + (100, 50, -20) to the user."""
    field = Field(shapes.sphere(1.0).module, bounds=((-2,) * 3, (2,) * 3), units=Units(40.0, (100.0, 50.0, -20.0)))
    with pytest.raises(ValueError, match="No point of the surface") as refused:
        geometric_edit(field, [Handle(Ball((100, 50, 10), 8), Along(0.1))], points=2000, steps=1, resolution=16)
    words = str(refused.value)
    corners = [float(x) for x in re.findall(r"-?[0-9.]+", words.partition("it spans")[2])[:6]]
    assert corners == pytest.approx([60, 10, -60, 140, 90, 20], abs=1.0)
    own = [float(x) for x in re.findall(r"-?[0-9.]+", words.partition("surface spans")[2])[:6]]
    assert own == pytest.approx([-1, -1, -1, 1, 1, 1], abs=0.03)
    assert "field.units.to_field" in words
