"""Curves of cost over error: where they cross, and what is said of it."""

import numpy as np
import pytest

from compare.studies.crossing import compared, frontier, in_short, sentence


def power_law(factor, order, errors):
    """Return (cost, error) with cost = factor * error^-order."""
    return [(factor * error**-order, error) for error in errors]


def test_two_power_laws_cross_where_algebra_says():
    """1 / e and 100 / e^(1/2) are equal at e = 1e-4, where both cost 1e4."""
    errors = np.geomspace(1e-1, 1e-6, 6)
    found = compared(power_law(100, 0.5, errors), power_law(1, 1, errors))
    ((error, cost),) = found.crossings
    assert error == pytest.approx(1e-4, rel=1e-6)
    assert cost == pytest.approx(1e4, rel=1e-6)
    assert found.ratios == pytest.approx((10**-1.5, 10.0))  # the second is cheaper at 1e-1, the first at 1e-6
    assert "cross at an error of 1.0e-04" in sentence(("the field", "the mesh"), "s", found)
    assert "above it the mesh is quicker (at 1.0e-01 by 32), below it the field (at 1.0e-06 by 10)" in sentence(
        ("the field", "the mesh"), "s", found
    )
    assert in_short(("field", "mesh"), "s", found) == "field quicker below 1.0e-04 (1e+04 s)"


def test_exchanging_the_curves_exchanges_the_names():
    errors = np.geomspace(1e-1, 1e-6, 6)
    curves = power_law(100, 0.5, errors), power_law(1, 1, errors)
    assert sentence(("a", "b"), "numbers", compared(*curves)) == sentence(
        ("b", "a"), "numbers", compared(*reversed(curves))
    )


def test_a_point_that_another_beats_in_both_is_left_out():
    assert frontier([(3, 1e-2), (1, 1e-1), (2, 1e-1), (4, 1e-3)]) == [(1, 1e-1), (3, 1e-2), (4, 1e-3)]


def test_errors_that_one_side_alone_reaches_are_named():
    found = compared([(1, 1e-3), (10, 1e-8)], [(0.1, 1e-1), (1, 1e-2)])
    said = sentence(("the field", "the mesh"), "s", found)
    assert "the field alone comes below 1.0e-02, to 1.0e-08" in said
    assert said.startswith("The curves cross") or "quicker" in said


def test_one_curve_without_points_is_refused():
    with pytest.raises(ValueError, match="each curve needs a point"):
        compared([], [(1, 1)])
