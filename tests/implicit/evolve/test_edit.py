"""How an edit ended, and how far it is from its target."""

import itertools
from dataclasses import replace

import pytest
import torch

from implicit import Edit, EditStatus, sample_surface, shapes
from implicit.evolve.edit import edit_status, reached_target, with_evidence
from implicit.surface.soundness import field_soundness

FAILURES = [
    EditStatus.NOT_FINITE,
    EditStatus.SURFACE_LOST,
    EditStatus.CONSTRAINT_NOT_HELD,
    EditStatus.UNSTABLE,
]


@pytest.mark.parametrize(
    ("ended", "facts", "status"),
    [
        (EditStatus.DONE, {}, EditStatus.DONE),
        (EditStatus.REACHED, {}, EditStatus.REACHED),
        (EditStatus.DONE, {"reached": False}, EditStatus.NOT_REACHED),
        (EditStatus.REACHED, {"reached": False}, EditStatus.NOT_REACHED),
        (EditStatus.DONE, {"more_pieces": True}, EditStatus.STRAY_PIECES),
        (EditStatus.REACHED, {"more_pieces": True}, EditStatus.REACHED),
        (EditStatus.DONE, {"other_type": True}, EditStatus.TOPOLOGY_CHANGED),
        (EditStatus.DONE, {"other_type": True, "more_pieces": True}, EditStatus.STRAY_PIECES),
        (EditStatus.NOT_REACHED, {"other_type": True}, EditStatus.NOT_REACHED),
        (EditStatus.DONE, {"reached": False, "more_pieces": True}, EditStatus.NOT_REACHED),
        (EditStatus.NOT_REACHED, {"more_pieces": True}, EditStatus.NOT_REACHED),
    ],
)
def test_the_facts_decide_the_status(ended, facts, status):
    assert edit_status(ended, **facts) is status


@pytest.mark.parametrize("failure", FAILURES)
def test_a_step_that_was_not_taken_stays_the_reason(failure):
    for reached, more in itertools.product((True, False), repeat=2):
        assert edit_status(failure, reached=reached, more_pieces=more) is failure


@pytest.mark.parametrize("ended", list(EditStatus))
def test_a_field_that_cannot_be_meshed_has_stray_pieces_however_it_ended(ended):
    assert edit_status(ended, meshed=False) is EditStatus.STRAY_PIECES


@pytest.mark.parametrize("ended", list(EditStatus))
def test_facts_may_be_told_one_after_the_other(ended):
    """First whether the target was reached, then what the pieces are: as if all were known at once."""
    for reached, meshed, more in itertools.product((True, False), repeat=3):
        later = edit_status(edit_status(ended, reached=reached), meshed=meshed, more_pieces=more)
        assert later is edit_status(ended, reached=reached, meshed=meshed, more_pieces=more)


def test_a_hole_that_closed_is_the_status_of_an_edit():
    """Nothing that was asked is missed, but where there was a torus is a ball now."""
    torus, closed = shapes.torus(R=0.4, r=0.2), shapes.sphere(0.5)
    edit = replace(grown(0.0, 0.0), field=closed)
    judged = with_evidence(edit, torus, field_soundness(torus), 48)
    assert judged.status is EditStatus.TOPOLOGY_CHANGED
    assert "from 0 to 2" in judged.notes[0]
    assert with_evidence(edit, closed, field_soundness(closed), 48).status is EditStatus.DONE


def grown(asked, achieved):
    """A ball of radius 0.5 told to grow by one number that has grown by another."""
    start = sample_surface(shapes.sphere(0.5), 60, resolution=16)
    return Edit(
        field=shapes.sphere(0.5 + achieved),
        points=start.points,
        normals=start.normals,
        weights=start.weights,
        displacement=achieved * start.normals,
        wanted=asked * start.normals,
        tracked=None,
        trail=(),
        history=[],
        status=EditStatus.DONE,
        seconds=0.0,
    )


@pytest.mark.parametrize(("asked", "achieved"), [(0.1, 0.1), (0.1, 0.05), (0.05, 0.06), (-0.1, -0.08)])
def test_the_error_field_of_a_ball_is_its_missing_radius(asked, achieved):
    error = grown(asked, achieved).error_field()
    torch.testing.assert_close(error, torch.full_like(error, (achieved - asked) / abs(asked)), atol=1e-9, rtol=0)


@pytest.mark.parametrize(("achieved", "reached"), [(0.1, True), (0.091, True), (0.089, False), (0.111, False)])
def test_a_target_is_reached_within_a_tenth(achieved, reached):
    assert reached_target(grown(0.1, achieved)) is reached
