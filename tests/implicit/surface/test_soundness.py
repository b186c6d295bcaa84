"""Slopes and pieces of shapes for which both are known."""

import math

import pytest

from implicit import shapes
from implicit.surface.soundness import changes, confirmed, field_soundness


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_the_slope_of_a_scaled_distance_is_its_scale(scale):
    found = field_soundness(shapes.sphere(radius=0.5, scale=scale))
    for slope in (found.slope_low, found.slope_median, found.slope_high):
        assert slope == pytest.approx(scale, rel=1e-9)
    assert (found.pieces, found.topology.euler) == (1, 2)


def test_a_piece_more_is_told_with_its_area_and_one_less_as_merged():
    one = field_soundness(shapes.sphere(radius=0.3, center=(-0.4, 0, 0)))
    balls = [shapes.sphere(radius=0.3, center=(-0.4, 0, 0)), shapes.sphere(radius=0.1, center=(0.6, 0, 0))]
    two = field_soundness(shapes.smooth_union(*balls, blend=0.01))
    (note,) = changes(one, two)
    assert "2 pieces, where it had 1" in note
    assert "0.12" in note  # 4 pi 0.1^2 = 0.126, less what the flat triangles of a coarse ball miss
    assert "merged" in changes(two, one)[0]


def test_a_hole_that_closes_is_told_by_the_euler_number():
    torus, ball = field_soundness(shapes.torus()), field_soundness(shapes.sphere(radius=0.5))
    assert "from 0 to 2" in changes(torus, ball)[0]


def test_areas_are_those_of_the_shapes():
    """Without Newton's method for most vertices: 4 pi r^2 of a large and a small ball, the small one placed whole."""
    balls = [shapes.sphere(radius=0.4, center=(-0.4, 0, 0)), shapes.sphere(radius=0.04, center=(0.6, 0, 0))]
    large, small = field_soundness(shapes.smooth_union(*balls, blend=0.001)).topology.areas
    assert large == pytest.approx(4 * math.pi * 0.4**2, rel=1e-3)
    assert small == pytest.approx(4 * math.pi * 0.04**2, rel=0.1)


def test_a_flattened_field_is_told():
    steep, flat = (field_soundness(shapes.sphere(radius=0.5, scale=scale)) for scale in (1.0, 0.3))
    assert "flat near the surface" in changes(steep, flat)[0]
    assert changes(steep, steep) == ()


def test_a_curve_has_pieces_too():
    found = field_soundness(shapes.circle(radius=0.5))
    assert found.pieces == 1
    assert found.slope_median == pytest.approx(1.0, rel=1e-9)


def test_pieces_closer_than_a_cell_of_the_resolution_are_told_apart():
    """A gap of 0.03 between balls, where a cell of 48 a side is 0.042 wide: marching cubes bridges it there."""
    balls = [shapes.sphere(radius=0.3, center=(sign * 0.315, 0, 0)) for sign in (-1, 1)]
    field = shapes.smooth_union(*balls, blend=1e-4)
    assert (field_soundness(field, 48).pieces, field_soundness(field, 48).topology.euler) == (2, 4)


def test_what_differs_on_coarse_cells_alone_is_no_change():
    """The same, seen on 12 x FINER cells as one piece: against that, the confirmed answer is two of both."""
    balls = [shapes.sphere(radius=0.3, center=(sign * 0.315, 0, 0)) for sign in (-1, 1)]
    field = shapes.smooth_union(*balls, blend=1e-4)
    coarse, fine = field_soundness(field, 8), field_soundness(field, 24)
    assert (coarse.pieces, fine.pieces) == (1, 2)
    before, after = confirmed(coarse, fine, (field, field), 24)
    assert before.pieces == after.pieces == 2
