"""Views come back from their files, stay small, and share a colour range about zero."""

import numpy as np
import pytest

import meshref
from compare.reports.views import View, azimuth_of, colour_limit, read_view, simplified


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
