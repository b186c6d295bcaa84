"""Flows whose steps are halved until they do not matter: closed forms, and the estimate of the error."""

import math

import pytest

import implicit
from implicit import shapes

TIME = 0.05
RADIUS = math.sqrt(0.5**2 - 4 * TIME)  # of a sphere of 0.5 that shrinks so long, R^2 = R0^2 - 4 t


@pytest.fixture(scope="module")
def shrunk():
    """A sphere of radius 0.5 that shrinks for the time, in 1, 2, 4 and 8 steps until it is good to 2e-3."""
    return implicit.converged_smooth(shapes.sphere(0.5), time=TIME, steps=2, tolerance=2e-3, points=60)


def test_the_estimate_is_above_the_error_of_the_shrinking_sphere_and_near_it(shrunk):
    """The steps of a sphere are of the second order: what the last halving changed is about three times the error."""
    error = float(shrunk.edit.tracked.norm(dim=1).mean()) - RADIUS
    assert 0 < error < shrunk.time_error_rms < 4 * error
    area = 4 * math.pi * RADIUS**2
    assert 1 < shrunk.area_error / (shrunk.areas[shrunk.steps] - area) < 4


def test_steps_are_halved_until_the_tolerance_is_met(shrunk):
    assert shrunk.converged
    assert shrunk.steps == 8
    assert list(shrunk.areas) == [1, 2, 4, 8]
    diagonal = 2 * 0.5 * 3**0.5
    assert shrunk.time_error_rms <= 2e-3 * diagonal < abs(shrunk.areas[2] - shrunk.areas[4])


def test_it_is_not_converged_where_the_steps_that_are_allowed_do_not_do():
    found = implicit.converged_smooth(shapes.sphere(0.5), time=TIME, steps=2, most_steps=2, points=60)
    assert not found.converged
    assert found.steps == 2
    assert "not converged" in repr(found)


def test_one_step_alone_says_nothing_of_its_error():
    found = implicit.converged_smooth(shapes.sphere(0.5), time=0.002, steps=1, most_steps=1, points=60)
    assert found.steps == 1
    assert found.time_error_rms == math.inf
    assert not found.converged


def test_bad_options_are_refused_before_any_work():
    with pytest.raises(ValueError, match="time"):
        implicit.converged_smooth(shapes.sphere(), time=-1.0)
    with pytest.raises(TypeError, match="speed"):
        implicit.converged_smooth(shapes.sphere(), time=1e-3, speed=3)
