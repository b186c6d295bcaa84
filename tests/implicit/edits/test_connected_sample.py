"""Linear rigid steps with points that are free along the surface, and when these are taken."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import meshref
from implicit import (
    Field,
    HalfSpace,
    Handle,
    RigidMotion,
    Volume,
    extract_mesh,
    integrate,
    rigid_edit,
    sample_surface,
    shapes,
)
from implicit.edits.connected_sample import FineMesh, connected
from implicit.evolve.edit import EditStatus
from implicit.sensitivity.pointwise_curvature import normal_turning
from implicit.step.tangential_basis import CosineFeatures
from implicit.surface.soundness import field_soundness, soundness_on_mesh
from tests.implicit.conftest import Wobbly, seeded_siren

TOP = HalfSpace((0, 0, 0.3), (0, 0, 1))
WAYS = [
    Handle(TOP, (0.02, 0.0, 0.0)),
    Handle(HalfSpace((0, 0, -0.3), (0, 0, -1)), (0.0, 0.0, 0.0)),
]


@pytest.fixture(scope="module")
def sample():
    field = Field(Wobbly(seeded_siren(16)))
    return field, sample_surface(field, 500, "farthest")


def method_of(edit):
    return edit.history[0]["method"]


def test_the_energy_is_no_more_than_with_waves_along_the_surface(sample):
    """On a mesh that carried neither, at handles as near; 604 functions a coordinate are the other way's default."""
    field, points = sample
    V, F = extract_mesh(field.to(torch.float64), 24)
    track = torch.from_numpy(V)
    energies, missed = [], []
    for tangential in (None, CosineFeatures(field, waves=300)):
        edit = rigid_edit(field, WAYS, method="linear", points=points, track=track, tangential=tangential)
        assert edit.status is EditStatus.DONE
        assert method_of(edit) == ("vertices" if tangential is None else "primal")
        energies.append(meshref.killing_energy(V, F, edit.tracked.double().numpy() - V))
        missed.append(float(edit.error_field().nan_to_num().square().mean().sqrt()))
    assert energies[0] < 1.02 * energies[1]
    assert missed[0] < 1.1 * missed[1]


@pytest.mark.parametrize(("rounding", "method"), [(0.0085, "vertices"), (0.003, "primal")])
def test_edges_that_second_derivatives_half_explain_are_no_hindrance(rounding, method):
    box = shapes.rounded_box((0.6, 0.2, 0.2), rounding)
    points = sample_surface(box, 600, "farthest")
    assert (normal_turning(box, points.points).explained > 0.5) == (method == "vertices")
    assert not normal_turning(box, points.points).is_smooth
    ends = [Handle(HalfSpace((side * 0.5, 0, 0), (side, 0, 0)), (0.01 * side, 0.0, 0.0)) for side in (-1.0, 1.0)]
    edit = rigid_edit(box, ends, method="linear", points=points)
    assert method_of(edit) == method


@pytest.mark.nightly
def test_the_volume_is_held(sample):
    field, points = sample
    edit = rigid_edit(field, WAYS, method="linear", points=points, constraints=[Volume()], resolution=16)
    assert method_of(edit) == "vertices"
    before, after = (integrate(f, Volume(), 32).value for f in (field, edit.field))
    assert after == pytest.approx(before, rel=2e-5)


def test_steps_turn_the_handles_along_their_path(sample):
    field, points = sample
    handles = [Handle(TOP, RigidMotion(rotation=(0.3, 0.0, 0.0))), WAYS[1]]
    edit = rigid_edit(field, handles, method="linear", points=points, steps=3)
    assert [row["method"] for row in edit.history] == ["vertices"] * 3
    error = edit.error_field()
    assert float(error[error.isfinite()].square().mean().sqrt()) < 0.1  # with waves along the surface it is 0.11


@pytest.mark.parametrize("options", [{"bending": 0.0}, {"thickness": 0.5}])
def test_energies_that_a_mesh_of_the_points_does_not_have_are_taken_at_the_points(sample, options):
    field, points = sample
    points = points.to(torch.float64)
    few = replace(points, points=points.points[:120], normals=points.normals[:120], weights=points.weights[:120])
    assert method_of(rigid_edit(field, WAYS, method="linear", points=few, **options)) != "vertices"


def test_points_whose_weights_are_no_areas_are_not_connected(sample):
    field, points = sample
    mesh = FineMesh.of(field, 64)
    assert connected(field, points, mesh) is not None
    assert connected(field, replace(points, weights=2 * points.weights), mesh) is None


def test_spread_points_are_of_equal_area_and_on_the_surface(sample):
    field, _ = sample
    spread, faces = FineMesh.of(field, 64).spread(field.to(torch.float64), 300, seed=3)
    mean = float(spread.weights.mean())
    assert float(field.to(torch.float64).value(spread.points).abs().max()) < 1e-9
    assert 0.4 * mean < float(spread.weights.min()) <= float(spread.weights.max()) < 2 * mean
    assert len(faces) == 2 * 300 - 4


def test_soundness_is_kept_with_a_field_until_its_parameters_change(sample):
    field = sample[0].with_theta(sample[0].theta)
    first = soundness_on_mesh(field, 16)
    assert soundness_on_mesh(field.with_theta(field.theta), 16) is first
    assert soundness_on_mesh(field, 18) is not first
    field.theta[-1] += 0.1  # the surface moves
    moved = field_soundness(field, 16)
    assert moved is not first[0]
    assert moved.topology.areas[0] != pytest.approx(first[0].topology.areas[0], rel=1e-3)
    assert np.isfinite(moved.slope_median)
