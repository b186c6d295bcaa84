"""Springs as stiff as leave the handles of a mesh where another editor's are."""

import numpy as np
import pytest

from compare.operations.equal_error import at_equal_error


@pytest.mark.parametrize("wanted", [1e-6, 1e-3, 0.2, 0.49])
@pytest.mark.parametrize("spring", [1e2, 1e5])
def test_the_stiffness_is_found_in_closed_form(wanted, spring):
    """Two springs in a row: the end that is pulled by one of stiffness p misses by k / (k + p) of the way."""
    found = at_equal_error(lambda p: spring / (spring + p), lambda error: error, wanted)
    softest, stiffest = spring / (spring + 1.0), spring / (spring + 1e9)
    assert (found is not None) == (stiffest < wanted < softest)
    if found is not None:
        error, stiffness = found
        assert error == pytest.approx(wanted, rel=0.011)
        assert stiffness == pytest.approx(spring * (1 - wanted) / wanted, rel=0.03)


def test_no_spring_leaves_an_error_of_nothing_or_more_than_all():
    for wanted in (0.0, 2.0, np.nan):
        assert at_equal_error(lambda p: 1 / (1 + p), lambda error: error, wanted) is None


def test_the_mesh_misses_its_handles_as_the_field_does_and_has_less_energy_than_with_exact_ones(small_run):
    sides = next(r for r in small_run.records if r.case.operation == "rigid").sides
    missed = sides["implicit"]["handle_error_relative"]
    for exact, beside, energy in (
        ("mesh", "mesh, equal error", "killing_spokes_and_rims"),
        ("mesh, ARAP", "mesh, ARAP, equal error", "arap_energy"),
    ):
        assert sides[beside]["handle_error_relative"] == pytest.approx(missed, rel=0.02)
        assert sides[exact]["handle_error_relative"] < 1e-9
        assert sides[beside][energy] < sides[exact][energy]
        assert sides[beside]["complete"]
        assert sides[beside]["details"]["penalty"] > 0
