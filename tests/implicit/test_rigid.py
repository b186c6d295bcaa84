"""Rigid edits: exact on rigid motions, as asked at the handles, and refused where a motion is left open."""

import pytest
import torch

from implicit import Ball, Handle, HalfSpace, RigidMotion, Volume, rigid_edit, sample_surface, shapes
from implicit.tangential import CosineFeatures

TOP = HalfSpace((0, 0, 0.3), (0, 0, 1))
BOTTOM = HalfSpace((0, 0, -0.3), (0, 0, -1))


def features(field):
    return CosineFeatures(field, waves=60)


def test_equal_translations_of_all_handles_move_everything_alike(wobbly):
    way = (0.05, 0.0, 0.0)
    track = sample_surface(wobbly, 60, seed=4).points
    edit = rigid_edit(
        wobbly, [Handle(TOP, way), Handle(BOTTOM, way)], points=500, tangential=features(wobbly), track=track, steps=2
    )
    moved = edit.tracked - track
    torch.testing.assert_close(moved, torch.tensor(way, dtype=torch.float64).expand(60, 3), rtol=0, atol=2e-3)


def test_a_common_rotation_turns_everything_alike(wobbly):
    motion = RigidMotion(rotation=(0, 0, 0.4))
    track = sample_surface(wobbly, 60, seed=4).points
    edit = rigid_edit(
        wobbly,
        [Handle(TOP, motion), Handle(BOTTOM, motion)],
        points=500,
        tangential=features(wobbly),
        steps=4,
        track=track,
    )
    torch.testing.assert_close(edit.tracked, motion.at(1.0, track), rtol=0, atol=6e-3)


def test_handles_go_where_they_are_told(wobbly):
    edit = rigid_edit(
        wobbly,
        [Handle(BOTTOM, (0.0, 0, 0)), Handle(TOP, (0.1, 0.0, 0.0))],
        points=500,
        tangential=features(wobbly),
        steps=2,
    )
    error = edit.error_field()
    held = torch.isfinite(error)
    assert 0 < int(held.sum()) < len(error)
    assert float(error[held].square().mean().sqrt()) < 0.03


def test_volume_can_be_kept(wobbly):
    edit = rigid_edit(
        wobbly,
        [Handle(BOTTOM, (0.0, 0, 0)), Handle(TOP, (0.0, 0.0, 0.1))],
        points=400,
        tangential=features(wobbly),
        constraints=(Volume(),),
    )
    first, last = edit.history[0], edit.history[-1]
    assert last["volume"] == pytest.approx(first["volume"], rel=1e-6)


@pytest.mark.parametrize(
    ("handles", "message"),
    [
        ([], "do not fix a rigid motion"),
        ([Handle(Ball((9, 9, 9), 0.1), (0, 0, 0))], "No point of the surface lies in the region"),
    ],
)
def test_bad_handles_are_refused(wobbly, handles, message):
    with pytest.raises(ValueError, match=message):
        rigid_edit(wobbly, handles, points=200)


def test_handles_on_one_line_are_refused(wobbly):
    """Points of one thin stripe: a rotation about it stays open."""
    sample = sample_surface(wobbly, 300)
    on_axis = sample.points[:, 0].abs() < 1e9
    assert bool(on_axis.all())
    two = sample.points[:2]

    def region(points):
        return (torch.cdist(points, two).amin(dim=1) < 1e-9).to(points)

    with pytest.raises(ValueError, match="not on one line"):
        rigid_edit(wobbly, [Handle(region, (0.1, 0, 0))], points=sample)


def test_a_curve_is_refused():
    with pytest.raises(ValueError, match="3 dimensions"):
        rigid_edit(shapes.circle(0.5), [])
