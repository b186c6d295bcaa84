"""Rigid edits: exact on rigid motions, as asked at the handles, and refused where a motion is left open."""

import pytest
import torch

from implicit import (
    Ball,
    Field,
    HalfSpace,
    Handle,
    RigidMotion,
    Siren,
    Volume,
    rigid_edit,
    sample_surface,
    surface_quadrature,
)
from implicit.edits import rigid
from implicit.edits.rigid_placement import Placement
from implicit.evolve.edit import EditStatus
from implicit.models import Mlp
from implicit.step import parameter_basis
from implicit.step.tangential_basis import CosineFeatures

HEAD = HalfSpace((0, 0.5, 0), (0, 1, 0))
FEET = HalfSpace((0, -0.6, 0), (0, -1, 0))


@pytest.fixture(scope="module")
def features(spot):
    return CosineFeatures(spot, waves=100)


@pytest.mark.parametrize(
    ("motion", "steps"),
    [
        pytest.param(RigidMotion(translation=(0.03, 0.02, 0.0)), 1, marks=pytest.mark.nightly),
        (RigidMotion(rotation=(0, 0.5, 0.1)), 2),
    ],
    ids=["translation", "rotation"],
)
def test_a_common_motion_of_all_handles_moves_everything_alike(spot, features, motion, steps):
    """Exactly: to 1e-6 of the size, however large the motion."""
    track = sample_surface(spot, 60, seed=4).points
    handles = [Handle(HEAD, motion), Handle(FEET, motion)]
    edit = rigid_edit(spot, handles, points=600, tangential=features, steps=steps, track=track)
    torch.testing.assert_close(edit.tracked, motion.at(1.0, track), rtol=0, atol=2e-6)
    torch.testing.assert_close(edit.points + edit.displacement, motion.at(1.0, edit.points), rtol=0, atol=2e-6)


def test_the_error_of_an_edit_in_single_precision_can_be_asked_for(spot):
    """The edit works in double precision; its field is back in the caller's, and so the error is of that precision."""
    shift = RigidMotion(translation=(0.03, 0.02, 0.0))
    single = spot.to(torch.float32)
    edit = rigid_edit(single, [Handle(HEAD, shift), Handle(FEET, shift)], points=300, steps=1)
    error = edit.error_field()
    assert bool(torch.isfinite(error).any())
    assert float(error.nan_to_num().abs().max()) < 1e-3


def test_other_networks_are_moved_step_by_step(wobbly):
    """Where the first layer does not see the points alone, a common translation is met by the least squares."""
    way = (0.03, 0.0, 0.0)
    regions = [HalfSpace((0, 0, side), (0, 0, side)) for side in (-0.3, 0.3)]
    edit = rigid_edit(
        wobbly, [Handle(r, way) for r in regions], points=300, tangential=CosineFeatures(wobbly, waves=40)
    )
    torch.testing.assert_close(
        edit.displacement, torch.tensor(way, dtype=torch.float64).expand(300, 3), rtol=0, atol=2e-3
    )


def test_the_way_is_taken_in_even_steps_where_the_whole_cannot_be_moved_first(wobbly):
    """A common turn about an axis in three steps: each moves the farthest point by a third of the angle."""
    turn = RigidMotion(rotation=(0, 0.3, 0))
    handles = [Handle(HalfSpace((0, 0, side), (0, 0, side)), turn) for side in (-0.3, 0.3)]
    edit = rigid_edit(wobbly, handles, steps=3, points=300, tangential=CosineFeatures(wobbly, waves=40))
    assert [row["largest_motion"] for row in edit.history] == pytest.approx([0.05] * 3, rel=0.2)


def test_handles_go_where_they_are_told_and_the_anchor_stays(spot, features):
    handles = [Handle(FEET, (0.0, 0, 0)), Handle(HEAD, (0.1, 0.0, 0.0))]
    edit = rigid_edit(spot, handles, points=600, tangential=features, steps=2)
    error = edit.error_field()
    held = torch.isfinite(error)
    assert edit.status is EditStatus.DONE
    assert 0 < int(held.sum()) < len(error)
    assert float(error[held].square().mean().sqrt()) < 0.02
    assert float((edit.displacement - edit.wanted)[held].norm(dim=1).max()) < 0.02


@pytest.mark.nightly
def test_combinations_of_sensitivities_do_nearly_what_all_parameters_do(spot, features, monkeypatch):
    """As a wider network's step is sought; of the 2273 parameters here, 975 combinations."""
    handles = [Handle(HEAD, (0.01, 0.0, 0.0)), Handle(FEET, (0.0, 0.0, 0.0))]
    sample = sample_surface(spot, 800, "farthest")
    of_all = rigid_edit(spot, handles, points=sample, tangential=features)
    monkeypatch.setattr(rigid, "ALL_PARAMETERS", 1000)
    monkeypatch.setattr(rigid, "COMBINATIONS", 975)
    combined = rigid_edit(spot, handles, points=sample, tangential=features)
    apart = (combined.displacement - of_all.displacement).norm(dim=1).max()
    assert 0 < float(apart) < 0.02 * 0.01
    assert combined.history[0]["objective"] == pytest.approx(of_all.history[0]["objective"], rel=0.02)


def test_too_few_points_to_see_the_strain_are_told_of(spot):
    """5 entries a point, against 2273 parameters and 312 coefficients: 517 points are as many equations."""
    features = CosineFeatures(spot, waves=100)
    handles = [Handle(HEAD, (0.01, 0.0, 0.0)), Handle(FEET, (0.0, 0.0, 0.0))]
    (note,) = rigid_edit(spot, handles, points=516, tangential=features).notes
    assert "2580 equations for 2585 unknowns" in note
    assert "Take 517 points or more" in note
    assert rigid_edit(spot, handles, points=517, tangential=features).notes == ()


def test_a_step_through_the_factors_of_rows_is_that_through_their_matrix(wobbly, monkeypatch):
    handles = [
        Handle(HalfSpace((0, 0, 0.3), (0, 0, 1)), (0.02, 0, 0)),
        Handle(HalfSpace((0, 0, -0.3), (0, 0, -1)), (0.0, 0, 0)),
    ]
    options = {"points": 100, "tangential": CosineFeatures(wobbly, waves=10), "constraints": [Volume()]}
    monkeypatch.setattr(rigid, "ALL_PARAMETERS", 0)
    monkeypatch.setattr(rigid, "COMBINATIONS", 40)
    edits = []
    for many in (0, 10**9):
        monkeypatch.setattr(parameter_basis, "MANY_PARAMETERS", many)
        edits.append(rigid_edit(wobbly, handles, resolution=16, **options))
    torch.testing.assert_close(edits[0].points, edits[1].points)
    apart = (edits[0].displacement - edits[1].displacement).norm(dim=1).max()
    assert 0 < float(apart) < 1e-4 * 0.02


def test_a_network_too_large_for_its_combinations_is_refused_before_any_work(monkeypatch):
    monkeypatch.setattr(rigid, "spans_by_factors", lambda field, count: False)
    field = Field(Mlp(width=512, depth=2))
    with pytest.raises(ValueError, match=r"265,217 parameters and no closed form .* takes up to 200,000"):
        rigid_edit(field, [Handle(HEAD, (0.01, 0.0, 0.0))])


def test_volume_can_be_kept(wobbly):
    handles = [
        Handle(HalfSpace((0, 0, -0.3), (0, 0, -1)), (0.0, 0, 0)),
        Handle(HalfSpace((0, 0, 0.3), (0, 0, 1)), (0, 0, 0.05)),
    ]
    before = Volume().value(wobbly, surface_quadrature(wobbly, 24))
    edit = rigid_edit(
        wobbly, handles, points=300, tangential=CosineFeatures(wobbly, waves=40), constraints=(Volume(),), resolution=24
    )
    assert edit.history[-1]["volume"] == pytest.approx(before, rel=1e-7)


@pytest.mark.parametrize(
    ("handles", "message"),
    [
        ([], "handles is empty"),
        ([Handle(Ball((9, 9, 9), 0.1), (0, 0, 0))], "No point of the surface lies in the region"),
    ],
)
def test_bad_handles_are_refused(wobbly, handles, message):
    with pytest.raises(ValueError, match=message):
        rigid_edit(wobbly, handles, points=200)


def test_handles_on_one_line_are_refused(wobbly):
    """Two points: the rotation about the line through them stays open."""
    sample = sample_surface(wobbly, 300)
    two = sample.points[:2]

    def region(points):
        return (torch.cdist(points, two).amin(dim=1) < 1e-9).to(points)

    with pytest.raises(ValueError, match="not on one line"):
        rigid_edit(wobbly, [Handle(region, (0.1, 0, 0))], points=sample)


def some_points(count=20):
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_a_placed_network_has_the_values_of_where_its_points_came_from():
    """f'(R x + t) = f(x)."""
    x = some_points()
    rotation = torch.linalg.matrix_exp(torch.tensor([[0.0, -0.3, 0.2], [0.3, 0.0, -0.5], [-0.2, 0.5, 0.0]]).double())
    placement = Placement(rotation, torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64))
    field = Field(Siren(width=8).double())
    torch.testing.assert_close(placement.field(field).value(placement.at(x)), field.value(x))
    torch.testing.assert_close(placement.undone(placement.at(x)), x)


def test_a_placement_of_mirrored_points_is_no_reflection():
    x = some_points()
    placement = Placement.fitting(x, x * torch.tensor([-1.0, 1.0, 1.0]), torch.ones(len(x), dtype=torch.float64))
    torch.testing.assert_close(torch.linalg.det(placement.rotation), torch.tensor(1.0, dtype=torch.float64))
