"""Handles and their motions."""

import math

import pytest
import torch

from implicit import Along, Ball, HalfSpace, Handle, RigidMotion, Scaling

POINTS = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [0, 2.0, 0]], dtype=torch.float64)
EVERYWHERE = Ball((0, 0, 0), 9)


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


def test_a_point_goes_half_the_way_after_half_of_a_straight_motion():
    vectors = torch.tensor([[1.0, 2, 3], [0, 0, 0], [0, -4, 0], [5, 5, 5]], dtype=torch.float64)
    half = Handle(EVERYWHERE, lambda points: vectors).position(0.5, POINTS, POINTS)
    torch.testing.assert_close(half, POINTS + vectors / 2)
    half = Handle(EVERYWHERE, (1.0, 2, 3)).position(0.5, POINTS, POINTS)
    torch.testing.assert_close(half, POINTS + vectors[0] / 2)


def test_a_turn_of_normals_is_that_of_the_motion_without_its_translation():
    turn = RigidMotion(rotation=(0, 0, math.pi / 2), translation=(3, 3, 3), center=(1, 2, 0))
    normals = torch.eye(3, dtype=torch.float64)
    expected = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(Handle(EVERYWHERE, turn).turned(normals), expected)
    assert Handle(EVERYWHERE, (3, 3, 3)).turned(normals) is normals


def test_a_motion_in_the_plane_turns_by_its_angle():
    points = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    moved = RigidMotion(rotation=math.pi / 3).at(0.5, points)
    torch.testing.assert_close(moved, torch.tensor([[math.sqrt(0.75), 0.5]], dtype=torch.float64))


@pytest.mark.parametrize(
    ("displacement", "message"),
    [
        ((1.0, 0.0), "a vector of 3 numbers or one a point"),
        (lambda points: points[:, :2], "a vector of 3 numbers or one a point"),
        (lambda points: None, "the function gave a NoneType"),
        (lambda points: points * math.nan, "displacement is not finite"),
        (Along(lambda points: points), "one distance, or a function that gives one a point"),
    ],
)
def test_a_motion_that_gives_no_place_for_each_point_is_refused(displacement, message):
    with pytest.raises(ValueError, match=message):
        Handle(EVERYWHERE, displacement).position(1.0, POINTS, POINTS)


def test_a_region_that_gives_no_weight_for_each_point_is_refused():
    with pytest.raises(ValueError, match=r"one weight a point, shape \(4,\), but gave \(4, 3\)"):
        Handle(lambda points: points, (1, 0, 0)).weights(POINTS)


def pull(points):
    return points[:, 0]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (Along(0.05), "Along(distance=0.05)"),
        (Along(pull), "Along(distance=pull)"),
        (RigidMotion(rotation=(0, 0, math.pi / 2)), "RigidMotion(rotation=(0, 0, 1.571))"),
        (RigidMotion(translation=torch.ones(3)), "RigidMotion(translation=(1, 1, 1))"),
        (
            Handle(HalfSpace((0, 0, 0), (0, 0, 1)), (0.1, 0, 0)),
            "Handle(region=HalfSpace(point=(0, 0, 0), normal=(0, 0, 1)), displacement=(0.1, 0, 0))",
        ),
        (Handle(pull, Along(0.05)), "Handle(region=pull, displacement=Along(distance=0.05))"),
    ],
)
def test_a_handle_is_printed_in_one_line(value, words):
    assert repr(value) == words


def test_scaling_leaves_its_centre_and_grows_by_even_factors():
    motion = Scaling(4.0, center=(1, 0, 0))
    expected = torch.tensor([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0], [-1, 4, 0]], dtype=torch.float64)
    torch.testing.assert_close(motion.at(0.5, POINTS), expected)
    torch.testing.assert_close(Scaling((1, 3, 1)).at(1.0, POINTS)[3], torch.tensor([0, 6.0, 0], dtype=torch.float64))


def test_scaling_turns_normals_as_an_ellipsoid_has_them():
    """Those of x^2 + y^2 + z^2 = 1 become those of x^2 + (y / 3)^2 + z^2 = 1, along (x, y / 9, z)."""
    x = torch.nn.functional.normalize(torch.tensor([[1.0, 2, -1], [0, 1, 0], [3, 1, 1]], dtype=torch.float64), dim=1)
    there = x * torch.tensor([1.0, 3, 1])
    steep = torch.nn.functional.normalize(there / torch.tensor([1.0, 9, 1]), dim=1)
    torch.testing.assert_close(Handle(EVERYWHERE, Scaling((1, 3, 1))).turned(x), steep)
    torch.testing.assert_close(Handle(EVERYWHERE, Scaling(0.2, (5, 5, 5))).turned(x), x)


@pytest.mark.parametrize("factor", [0.0, -1.0, (1.0, 0.0, 1.0), [[1.0, 2.0]]])
def test_a_scaling_that_is_none_is_refused(factor):
    with pytest.raises(ValueError, match="factor of a Scaling must be a positive number"):
        Scaling(factor)
