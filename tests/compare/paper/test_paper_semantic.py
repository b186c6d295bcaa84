"""The semantic figures: made quickly, and what they find."""

import pytest

from compare.paper import semantic_basis
from compare.paper.family_edits import longer_wing, uneven_wings
from compare.paper.request import Request
from implicit import families


@pytest.mark.nightly
def test_basis_functions_are_drawn_and_symmetric_on_both_chairs(tmp_path):
    findings = semantic_basis.draw(Request(tmp_path, quick=True))
    assert (tmp_path / "semantic_basis.png").stat().st_size > 10_000
    measures = [finding.ours for finding in findings if finding.what.startswith("basis function")]
    assert len(measures) == 8
    assert min(measures) > 0.99


def test_uneven_wings_ask_both_tips_to_go_the_same_way():
    """The one outward, the other inward, from points on either side."""
    model = families.bundled("dualsdf-airplanes")
    points, ways = uneven_wings(model).points(40)
    assert (ways == ways[0]).all()
    assert ways[0, 0] > 0
    assert {bool(x > 0) for x in points[:, 0]} == {True, False}
    assert bool((longer_wing(model).points(40)[0][:, 0] > 0).all())


def test_free_points_lie_outside_the_regions():
    edit = longer_wing(families.bundled("dualsdf-airplanes"))
    assert float(edit.handles[0].weights(edit.free_points(500)).max()) == 0
