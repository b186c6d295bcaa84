"""Regions, their combinations, and motions."""

import math

import pytest
import torch

from implicit import Along, Ball, Box, HalfSpace, Handle, NearPoints, RigidMotion

POINTS = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [0, 2.0, 0]], dtype=torch.float64)


def weights(region):
    return region(POINTS).tolist()


def test_each_region_holds_its_points():
    assert weights(Ball((0, 0, 0), 0.6)) == [1, 1, 0, 0]
    assert weights(Box((0.4, -1, -1), (2, 1, 1))) == [0, 1, 1, 0]
    assert weights(HalfSpace((0, 1, 0), (0, 5, 0))) == [0, 0, 0, 1]
    assert weights(NearPoints(POINTS[2:], 0.1)) == [0, 0, 1, 1]


def test_regions_combine():
    left, right = Ball((0, 0, 0), 0.6), Box((0.4, -1, -1), (2, 1, 1))
    assert weights(left & right) == [0, 1, 0, 0]
    assert weights(left | right) == [1, 1, 1, 0]
    assert weights(~left) == [0, 0, 1, 1]


def test_falloff_sinks_smoothly_to_zero():
    line = torch.stack([torch.linspace(0, 2, 201), torch.zeros(201), torch.zeros(201)], dim=1).double()
    w = Ball((0, 0, 0), 0.5, falloff=1.0)(line)
    assert (w[:51] == 1).all()
    assert (w[150:] == 0).all()
    assert (w.diff() <= 0).all()
    assert float(w[100]) == pytest.approx(0.5)
    assert float(w.diff().diff().abs().max()) < 1e-3


@pytest.mark.parametrize(
    "make",
    [lambda: Ball((0, 0, 0), 0), lambda: HalfSpace((0, 0, 0), (0, 0, 0)), lambda: NearPoints(POINTS[:0], 1.0)],
)
def test_empty_regions_are_refused(make):
    with pytest.raises(ValueError, match="needs"):
        make()


def test_a_box_inside_out_is_refused():
    with pytest.raises(ValueError, match="lower < upper"):
        Box((1, 0, 0), (0, 1, 1))


def test_rigid_motion_turns_by_even_angles():
    motion = RigidMotion(rotation=(0, 0, math.pi / 2), translation=(0, 0, 1), center=(1, 0, 0))
    half = motion.at(0.5, POINTS[:1])
    root = math.sqrt(0.5)
    torch.testing.assert_close(half, torch.tensor([[1 - root, -root, 0.5]], dtype=torch.float64))
    torch.testing.assert_close(motion.at(1.0, POINTS[:1]), torch.tensor([[1.0, -1, 1]], dtype=torch.float64))


def test_a_rotation_matrix_is_the_same_as_its_vector():
    vector = torch.tensor([0.3, -0.5, 0.2], dtype=torch.float64)
    matrix = torch.matrix_exp(torch.tensor([[0, -0.2, -0.5], [0.2, 0, -0.3], [0.5, 0.3, 0]], dtype=torch.float64))
    torch.testing.assert_close(
        RigidMotion(rotation=matrix).at(0.7, POINTS), RigidMotion(rotation=vector).at(0.7, POINTS)
    )


def test_no_rotation_matrix_is_refused():
    with pytest.raises(ValueError, match="no rotation matrix"):
        RigidMotion(rotation=2 * torch.eye(3)).at(1.0, POINTS)


def test_motion_along_normals():
    normals = torch.nn.functional.normalize(torch.ones_like(POINTS), dim=1)
    handle = Handle(Ball((0, 0, 0), 9), Along(lambda x: x[:, 0]))
    torch.testing.assert_close(handle.position(0.5, POINTS, normals), POINTS + 0.5 * POINTS[:, :1] * normals)


def test_a_displacement_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="all finite"):
        Handle(Ball((0, 0, 0), 1), (float("nan"), 0, 0)).position(1.0, POINTS, POINTS)


def test_weights_outside_zero_and_one_are_refused():
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        Handle(lambda x: x[:, 0] * 3, (1, 0, 0)).weights(POINTS)


def test_plain_numbers_keep_their_digits():
    moved = Handle(Ball((0, 0, 0), 1), (0.1, 0.0, 0.0)).position(1.0, POINTS, POINTS)
    assert float(moved[0, 0]) == 0.1
    assert float(Handle(Ball((0, 0, 0), 1), Along(0.1)).position(1.0, POINTS, torch.ones_like(POINTS))[0, 0]) == 0.1


def test_falloff_stays_between_zero_and_one_in_single_precision():
    points = torch.linspace(0, 1.2, 20_001)[:, None] * torch.tensor([1.0, 0, 0])
    weights = Handle(Ball((0, 0, 0), 0.2, falloff=0.3), Along(0.1)).weights(points)
    assert 0 <= float(weights.min()) <= float(weights.max()) <= 1
