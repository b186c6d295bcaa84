"""Views come back from their files, stay small, and share a colour range about zero."""

import numpy as np
import pytest

import meshref
from compare.reports.azimuth import azimuth_of
from compare.reports.views import (
    Camera,
    View,
    colour_limit,
    colour_range,
    read_view,
    simplified,
    simplified_alike,
    up_of,
)


def test_a_view_comes_back_to_the_last_bit(tmp_path):
    V, F = meshref.icosphere(2)
    values = np.random.default_rng(0).normal(size=len(V))
    meshref.write_mesh(tmp_path / "a.ply", V, F, quality=values)
    view = read_view(tmp_path / "a.ply")
    np.testing.assert_array_equal(view.V, V)
    np.testing.assert_array_equal(view.F, F)
    np.testing.assert_array_equal(view.values, values)


def test_a_simplified_view_has_few_faces_on_the_same_surface_with_the_same_values():
    """The height as the value: it must still be the height."""
    V, F = meshref.icosphere(4)
    few = simplified(View(V, F, V[:, 2]), 600)
    assert len(few.F) <= 600
    assert np.linalg.norm(few.V, axis=1) == pytest.approx(1, abs=0.03)
    np.testing.assert_allclose(few.values, few.V[:, 2], atol=0.1)


def test_a_small_view_is_left_alone():
    V, F = meshref.icosphere(1)
    view = View(V, F, V[:, 0])
    assert simplified(view, len(F)) is view


def test_the_colour_range_ignores_a_single_spike_but_not_the_rest():
    V, F = meshref.icosphere(4)
    values = np.linspace(-2, 2, len(V))
    values[0] = 1000
    assert colour_limit([View(V, F, values)]) == pytest.approx(1.98, abs=0.02)
    assert colour_limit([View(V, F, np.zeros(len(V)))]) == 1


def test_one_looks_at_what_moves(small_run):
    """The default bump sits towards one end of the thinnest axis: the eye is on that side."""
    geometric = [r for r in small_run.records if r.case.operation == "geometric"]
    center = np.array(geometric[0].case.handles[0].region["center"])
    angle = np.radians(azimuth_of(geometric, small_run.folder))
    assert np.array([np.sin(angle), 0, np.cos(angle)]) @ center > 0


def test_the_up_axis_is_that_of_the_format():
    assert [up_of(name) for name in ("a.stl", "A.3MF", "a.obj", "a.glb", "spot")] == ["z", "z", "y", "y", "y"]


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_a_camera_is_a_right_handed_frame_with_its_axis_upwards(up):
    """From the horizon, what is up in the picture is the axis; right x up points at the viewer."""
    right, above, back = Camera(37.0, 0.0, up).axes()
    np.testing.assert_allclose(above, np.eye(3)["xyz".index(up)], atol=1e-15)
    np.testing.assert_allclose(np.cross(right, above), back, atol=1e-15)


def test_moved_copies_of_a_mesh_are_simplified_to_the_same_faces_with_corners_of_their_own():
    V, F = meshref.icosphere(4)
    first, second = simplified_alike([View(V, F, V[:, 0]), View(V + np.array([5.0, 0.0, 0.0]), F, V[:, 1])], 600)
    assert len(first.F) <= 600
    np.testing.assert_array_equal(first.F, second.F)
    np.testing.assert_allclose(second.V - first.V, np.tile([5.0, 0.0, 0.0], (len(first.V), 1)), atol=1e-12)
    np.testing.assert_array_equal(first.values, first.V[:, 0])
    np.testing.assert_allclose(second.values, first.V[:, 1], atol=1e-15)


def test_colours_of_lengths_end_no_lower_than_a_hundredth_of_the_motion_and_of_strains_start_at_zero(small_run):
    V, F = meshref.icosphere(2)
    by_name = {record.case.operation: record for record in small_run.records}
    motion = by_name["geometric"].sides["mesh"]["displacement_max"]
    tiny = colour_range(by_name["geometric"], [View(V, F, 1e-9 * V[:, 0])])
    assert (tiny.low, tiny.limit) == pytest.approx((-0.01 * motion, 0.01 * motion))
    assert tiny.percent == pytest.approx(1)
    wide = colour_range(by_name["geometric"], [View(V, F, np.full(len(V), motion))])
    assert wide.percent == pytest.approx(100)
    strain = colour_range(by_name["rigid"], [View(V, F, np.full(len(V), 0.25))])
    assert (strain.low, strain.limit) == (0, 0.25)
