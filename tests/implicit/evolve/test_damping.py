"""How the damping follows the linearisation error, and that error on a sphere."""

import pytest
import torch

from implicit import shapes
from implicit.evolve.damping import AdaptiveDamping, linearisation_error
from implicit.surface.projection import newton_to_surface


def test_damping_grows_and_falls_by_half_a_decade():
    damping = AdaptiveDamping(floor=1e-13).start(1e-7)
    assert damping.current == 1e-7
    assert damping.increase().increase().current == pytest.approx(1e-6)
    assert damping.accept(0.1, least=0.0).current == pytest.approx(1e-7 / 10**0.5)
    assert damping.accept(0.5, least=0.0).current == 1e-7
    assert damping.current == 1e-7  # a value: nothing has changed it


def test_damping_falls_no_lower_than_the_precision_and_the_operation_allow():
    assert AdaptiveDamping(floor=1e-7).start(1e-9).current == 1e-7
    assert AdaptiveDamping(floor=1e-7).start(1e-7).accept(0.0, least=0.0).current == 1e-7
    assert AdaptiveDamping(floor=1e-13).start(1e-5).accept(0.0, least=1e-5).current == 1e-5


def test_a_later_step_begins_where_the_one_before_has_ended():
    damping = AdaptiveDamping(floor=1e-13).start(1e-7).increase()
    assert damping.start(1e-7) == damping


def test_single_precision_carries_less_damping_than_double():
    assert AdaptiveDamping.of_precision(torch.float32).floor == 1e-7
    assert AdaptiveDamping.of_precision(torch.float64).floor == 1e-13


def test_a_damping_that_was_never_started_is_refused():
    with pytest.raises(ValueError, match=r"no value before start"):
        AdaptiveDamping().increase()


@pytest.mark.parametrize("t", [0.01, 0.1, 0.3])
def test_points_sent_along_a_tangent_miss_a_sphere_by_its_sagitta(t):
    """From p to p + t e, and from there along the radius to the sphere: sqrt(r^2 + t^2) - r."""
    r = 0.5
    points = torch.tensor([[r, 0.0, 0.0], [0.0, r, 0.0]], dtype=torch.float64)
    predicted = torch.tensor([[0.0, t, 0.0], [0.0, 0.0, t]], dtype=torch.float64)
    there, arrived = newton_to_surface(shapes.sphere(r), points + predicted, reach=1.0)
    error = linearisation_error(predicted, there - points, arrived)
    assert error.missed == pytest.approx((r**2 + t**2) ** 0.5 - r, rel=1e-9)
    assert error.size == pytest.approx(t)
    assert error.relative == pytest.approx(error.missed / t)


@pytest.mark.parametrize(("outliers", "missed"), [(2, 0.0), (3, (1 / 98) ** 0.5)])
def test_the_largest_fiftieth_of_the_misses_does_not_count(outliers, missed):
    predicted = torch.ones(100, 1, dtype=torch.float64)
    achieved = predicted.clone()
    achieved[:outliers] += 1.0
    arrived = torch.ones(100, dtype=torch.bool)
    assert linearisation_error(predicted, achieved, arrived).missed == pytest.approx(missed)


def test_where_no_point_arrives_the_error_is_infinite():
    motion = torch.ones(3, 3)
    assert linearisation_error(motion, motion, torch.zeros(3, dtype=torch.bool)).relative == float("inf")
