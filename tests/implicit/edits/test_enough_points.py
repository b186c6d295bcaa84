"""Edits of grids: as many points as hold the surface between them, and the truth on those that carried nothing."""

from __future__ import annotations

import pytest
import torch

from implicit import (
    Along,
    Ball,
    EditStatus,
    Field,
    HalfSpace,
    Handle,
    Siren,
    Verdict,
    expressibility,
    geometric_edit,
    sample_surface,
    shapes,
)
from implicit.edits.enough_points import carriers
from implicit.edits.targets import SummedTargets
from implicit.models import DenseGrid

BUMP = Handle(Ball((0, 0, 0.5), 0.1, falloff=0.4), Along(0.02))
FEW = 60


@pytest.fixture(scope="module")
def ball() -> Field:
    return Field(DenseGrid(resolution=16).double())


def error_elsewhere(edit, field) -> float:
    sample = sample_surface(field, 800, seed=5, resolution=24)
    return float((sample.weights @ edit.error_field(sample).square() / sample.weights.sum()).sqrt())


def test_more_points_are_drawn_where_the_supports_are_small_and_the_edit_holds_between_them(ball):
    edit = geometric_edit(ball, BUMP, points=FEW, steps=2, resolution=16)
    assert edit.status is EditStatus.DONE
    assert len(edit.points) > FEW
    assert f"{FEW} points are too few" in edit.notes[0]
    assert f"{len(edit.points):,} were drawn" in edit.notes[0]
    assert error_elsewhere(edit, ball) < 0.02


def test_a_sample_of_ones_own_is_kept_and_what_it_misses_is_said(ball):
    sample = sample_surface(ball, FEW, seed=0)
    edit = geometric_edit(ball, BUMP, points=sample, steps=2, resolution=16)
    assert len(edit.points) == FEW
    assert "would do" in edit.notes[0]
    elsewhere = error_elsewhere(edit, ball)
    assert float(edit.error_field().square().mean().sqrt()) < 0.2 * elsewhere
    missed = any("carried no target" in note for note in edit.notes)
    assert (edit.status is EditStatus.NOT_REACHED) == missed
    assert missed


def test_the_prediction_agrees_with_the_edit(ball):
    found = expressibility(ball, BUMP, points=FEW, steps=2)
    assert found.verdict is Verdict.YES
    assert "nan" not in found.sentence() + repr(found)


def test_an_iterative_prediction_leaves_out_what_it_does_not_know(ball, monkeypatch):
    monkeypatch.setattr("implicit.step.sparse_equations.DIRECT_LIMIT", 0)
    found = expressibility(ball, BUMP, points=400, steps=2)
    assert found.verdict is Verdict.YES
    assert "nan" not in found.sentence() + repr(found)
    assert "directions" not in found.sentence()


def test_fields_whose_parameters_act_everywhere_get_what_was_asked_for():
    class Ball3(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.network = Siren(width=48).double()

        def forward(self, x):
            return x.norm(dim=1) - 0.5 + 0.05 * self.network(x)

    found = carriers(Field(Ball3()), FEW, lambda points, normals: SummedTargets([BUMP], points, normals))
    assert len(found.sample) == FEW
    assert found.others is not None
    assert found.notes == ()


def test_many_points_of_a_network_need_no_others():
    handles = [Handle(HalfSpace((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), Along(0.05))]
    found = carriers(shapes.sphere(0.5), 2000, lambda points, normals: SummedTargets(handles, points, normals))
    assert found.others is None


def test_what_few_points_of_a_network_leave_between_them_is_no_success():
    bump = Handle(Ball((0.25, 0.0, -0.2), 0.1, falloff=0.16), Along(0.05))
    edit = geometric_edit(shapes.bundled("spot"), bump, steps=2, points=100, resolution=24)
    assert edit.error_field().nan_to_num().square().mean().sqrt() < 0.05  # at its own points
    assert edit.status is EditStatus.NOT_REACHED
    assert any("carried no target" in note for note in edit.notes)
