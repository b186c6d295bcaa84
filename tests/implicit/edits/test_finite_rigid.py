"""Rigid edits of any size: a rod bent by 45 degrees, its volume held, its points, field and energy in agreement."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from implicit import (
    Handle,
    RigidMotion,
    Volume,
    extract_mesh,
    integrate,
    mesh_topology,
    project_to_surface,
    rigid_edit,
    sample_surface,
)
from implicit.edits import finite_rigid, towards_points
from implicit.edits.finite_rigid import turning
from implicit.edits.targets import AveragedTargets
from implicit.edits.towards_points import TowardsPoints, nearer
from implicit.evolve.edit import EditStatus, reached_target
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.step.tangential_basis import CosineFeatures
from tests.implicit.conftest import BEND, FOOT, RADIUS, TIP


@pytest.fixture(scope="module", autouse=True)
def small():
    """A mesh and a training that suit a rod and a small network."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finite_rigid, "VERTICES", 700)
        patch.setattr("implicit.edits.rigid.VERTICES", 700)
        patch.setattr(finite_rigid, "SAMPLES", 3000)
        patch.setattr(finite_rigid, "BATCH", 512)
        patch.setattr(finite_rigid, "NEAR", 2e-3)
        patch.setattr("implicit.fitting.follow.RATES", (1e-2, 1e-2))
        patch.setattr(finite_rigid, "LAST_STEPS", 2)
        yield


@pytest.fixture(scope="module")
def bent(rod):
    told = []
    V, _ = extract_mesh(rod, 20)
    track = project_to_surface(rod.to(torch.float64), torch.from_numpy(V))
    edit = rigid_edit(
        rod,
        [FOOT, Handle(TIP, BEND)],
        constraints=[Volume()],
        points=300,
        resolution=24,
        track=track,
        progress=lambda *news: told.append(news),
    )
    return edit, track, told


def test_the_handles_reach_their_goals(bent):
    edit, _, _ = bent
    assert edit.status is EditStatus.DONE
    moved = torch.isfinite(edit.wanted).all(dim=1)
    apart = (edit.displacement - edit.wanted)[moved].norm(dim=1)
    assert float(apart.square().mean().sqrt()) < 0.006
    assert float(edit.wanted[moved].norm(dim=1).max()) > 0.3


def test_the_volume_is_held_as_by_other_edits(bent, rod):
    edit, _, _ = bent
    before, after = (integrate(field.to(torch.float64), Volume(), 96).value for field in (rod, edit.field))
    assert after == pytest.approx(before, rel=1e-6)
    assert edit.history[-1]["constraint_gap"] < 1e-7


def test_points_and_surface_agree_and_the_surface_is_in_one_piece(bent):
    edit, _, _ = bent
    V, F = extract_mesh(edit.field, 64)
    assert mesh_topology(V, F).components == 1
    assert mesh_topology(V, F).euler == 2
    tracked = edit.tracked.to(edit.field.theta)
    assert float((edit.field.value(tracked) / edit.field.gradient(tracked).norm(dim=1)).abs().max()) < 1e-5


def test_the_middle_bends_into_the_arc(bent):
    """The points of the axis's sides keep their distance from the arc: the rod does not thin out."""
    edit, track, _ = bent
    middle = track[:, 1].abs() < 0.2
    centre = torch.tensor([RADIUS, -0.4, 0.0], dtype=torch.float64)
    x = edit.tracked[middle].double() - centre
    ring = torch.stack([x[:, :2].norm(dim=1) - RADIUS, x[:, 2]], dim=1).norm(dim=1)
    assert float((ring - 0.2).abs().mean()) < 0.03


def test_it_says_which_way_was_taken_and_why(bent):
    edit, _, _ = bent
    assert "Finite rotations were taken" in edit.notes[0]
    assert edit.history[0]["method"] == "finite rotations"
    assert edit.history[0]["largest_move"] <= 1e-5
    assert edit.history[0]["miss_rms"] < 0.01


def test_each_stage_of_the_way_has_a_row_and_a_frame(rod):
    V, F = extract_mesh(rod, 20)
    track = project_to_surface(rod.to(torch.float64), torch.from_numpy(V))
    handles = [FOOT, Handle(TIP, BEND)]
    edit = rigid_edit(rod, handles, method="warp", steps=3, points=300, resolution=24, track=track)
    assert [row["step"] for row in edit.history] == [1, 2, 3]
    assert len(edit.trail) == 3
    tip = track[:, 1] > 0.55  # where the handle holds all vertices about: they go along the motion's own path
    for part, (frame, _) in enumerate(edit.frames(track, F)[1:], 1):
        wanted = BEND.at(part / 3, track[tip]).numpy()
        np.testing.assert_allclose(frame[tip.numpy()], wanted, atol=1e-6 if part < 3 else 2e-3)
    energies = [row["energy"] for row in edit.history]
    assert energies == sorted(energies)
    assert sum(row["seconds"] for row in edit.history) <= edit.seconds


def test_progress_is_told_in_hundredths(bent):
    _, _, told = bent
    steps = [step for step, _, _ in told]
    assert steps == sorted(set(steps))
    assert {row["phase"] for _, _, row in told} == {"points", "field"}
    assert steps[-1] <= 100


def test_a_small_motion_is_taken_in_linear_steps(rod):
    edit = rigid_edit(rod, [FOOT, Handle(TIP, (0.01, 0.0, 0.0))], points=150, resolution=24)
    assert "Linear steps were taken" in edit.notes[0]
    assert edit.history[0]["method"] != "finite rotations"


def test_options_of_the_linear_steps_alone_are_refused_or_decide(rod):
    handles = [FOOT, Handle(TIP, BEND)]
    with pytest.raises(ValueError, match='bending, damping must be left out with method="finite"'):
        rigid_edit(rod, handles, method="finite", bending=1.0, damping=1e-3, points=100)
    with pytest.raises(ValueError, match="method must be"):
        rigid_edit(rod, handles, method="newton", points=100)


def test_a_goal_beyond_the_bounds_is_refused_before_the_field_is_touched(rod):
    edit = rigid_edit(rod, [FOOT, Handle(TIP, (0.0, 0.7, 0.0))], points=150, method="finite")
    assert edit.status is EditStatus.SURFACE_LOST
    torch.testing.assert_close(edit.field.theta, rod.theta, rtol=0, atol=0)
    assert any("leave the bounds" in note for note in edit.notes)


def test_a_field_that_cannot_follow_says_so(rod, monkeypatch):
    monkeypatch.setattr(finite_rigid, "ROUNDS", (2,))
    monkeypatch.setattr(finite_rigid, "LAST_STEPS", 0)
    edit = rigid_edit(rod, [FOOT, Handle(TIP, BEND)], points=150, method="finite", resolution=24)
    assert edit.status in (EditStatus.NOT_REACHED, EditStatus.STRAY_PIECES)
    assert any("could not follow" in note for note in edit.notes)


def test_an_interrupted_edit_leaves_the_field_as_it_was(rod):
    before = rod.theta.clone()

    def stop(step, steps, row):
        if row["phase"] == "field":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rigid_edit(rod, [FOOT, Handle(TIP, BEND)], points=150, method="finite", progress=stop)
    torch.testing.assert_close(rod.theta, before, rtol=0, atol=0)


def test_turning_counts_whole_turns_and_takes_none_for_a_motion_of_all(rod):
    sample = sample_surface(rod.to(torch.float64), 200)

    def angle(*motions):
        handles = [Handle(h, m) for h, m in zip((FOOT.region, TIP), motions, strict=True)]
        return turning(AveragedTargets(handles, sample.points, sample.normals))

    whole = RigidMotion(rotation=(0, 7.0, 0))
    assert angle(whole, whole) == pytest.approx(0, abs=1e-4)
    # A point of the foot does not move, so that the whole turns by about half as much as the tip.
    assert 2 * math.pi * 0.4 < angle((0.0, 0.0, 0.0), RigidMotion(rotation=(0, 2 * math.pi, 0))) < 2 * math.pi


def test_points_that_pass_through_each_other_are_said_before_the_field_is_touched(rod):
    """The tip is pushed into the foot: with the volume held, too, one lies in the other."""
    told = []
    edit = rigid_edit(
        rod,
        [FOOT, Handle(TIP, (0.0, -0.9, 0.0))],
        points=150,
        method="finite",
        resolution=24,
        progress=lambda step, steps, row: told.append(row["phase"]),
    )
    assert edit.status is EditStatus.SELF_CROSSING
    assert any("pass through each other" in note for note in edit.notes)
    assert set(told) == {"points"}
    torch.testing.assert_close(edit.field.theta, rod.theta, rtol=0, atol=0)


def test_the_last_steps_only_lower_the_strain_that_is_left(rod):
    """Between the field's surface and that of the same rod a little thicker at one side."""
    precise = rod.to(torch.float64)
    V, F = extract_mesh(precise, 20)
    energy, surface = SpokesAndRims(V, F), WeakSurface.of(torch.from_numpy(V), torch.from_numpy(F))
    goals = torch.from_numpy(V * (1 + 0.02 * np.sin(3 * V[:, 1:2]) ** 2))
    operation = TowardsPoints(goals, torch.from_numpy(surface.masses), energy.laplacian, seed=0)
    before = operation.left(precise).energy()
    field, steps = nearer(operation, precise, 0.1 * before)
    assert steps >= 1
    assert operation.left(field).energy() <= 0.1 * before
    same, none = nearer(operation, precise, 2 * before)
    assert (none, same) == (0, precise)


def test_products_of_equations_give_the_step_of_the_normal_matrix(rod):
    """A^T (A A^T + damping)^-1 b = (A^T A + damping)^-1 A^T b, and both matrices have one trace."""
    precise = rod.to(torch.float64)
    V, F = extract_mesh(rod, 16)
    points = project_to_surface(precise, torch.from_numpy(V))
    goals = points + 0.01 * torch.sin(9 * points[:, 1:2]) * precise.normal(points)
    surface = WeakSurface(points.numpy(), F)
    operation = TowardsPoints(
        goals, torch.from_numpy(surface.masses), SpokesAndRims(surface.vertices, F).laplacian, seed=0
    )
    left = operation.left(precise)
    steps = []
    for most in (10**6, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(towards_points, "MOST", most)
            steps.append(towards_points._system(operation, precise, left, 0).step(left, 1e-4))
    assert float((steps[0] - steps[1]).norm()) < 1e-2 * float(steps[0].norm())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(towards_points, "MOST", 0)
        _, taken = nearer(operation, precise, 0.5 * left.energy())
        patch.setattr(towards_points, "LARGEST", 0)
        patch.setattr(towards_points, "fits", lambda *rows: False)
        same, none = nearer(operation, precise, 0.5 * left.energy())
    assert taken >= 1
    assert (none, same) == (0, precise)


def test_coupled_steps_find_what_points_and_field_find_one_after_the_other(rod):
    """The energy of the same mesh, and places of its points, by both."""
    handles = [FOOT, Handle(TIP, RigidMotion(rotation=(0, 0, -0.35), center=(0, 0.4, 0), translation=(0.14, 0, 0)))]
    V, F = extract_mesh(rod, 20)
    track = project_to_surface(rod.to(torch.float64), torch.from_numpy(V))
    energy = SpokesAndRims(track.numpy(), F)
    waves = CosineFeatures(rod, waves=80, frequency=4.0)
    one, two = (
        rigid_edit(rod, handles, method=method, points=150, resolution=24, track=track, **options)
        for method, options in (("finite", {}), ("coupled", {"tangential": waves}))
    )
    assert two.status is EditStatus.DONE
    assert two.history[0]["method"] == "finite rotations, coupled"
    assert two.history[0]["energy"] == pytest.approx(one.history[0]["energy"], rel=0.15)
    assert energy.energy(two.tracked.numpy()) <= 1.1 * energy.energy(one.tracked.numpy())
    assert float((two.tracked - one.tracked).norm(dim=1).max()) < 0.03
    moved = torch.isfinite(two.wanted).all(dim=1)
    assert float((two.displacement - two.wanted)[moved].norm(dim=1).square().mean().sqrt()) < 0.006


def test_coupled_steps_refuse_a_basis_that_is_none_and_options_of_linear_steps(rod):
    handles = [FOOT, Handle(TIP, BEND)]
    with pytest.raises(TypeError, match="tangential must be None or a model"):
        rigid_edit(rod, handles, method="coupled", tangential=3, points=100)
    with pytest.raises(ValueError, match='damping must be left out with method="coupled"'):
        rigid_edit(rod, handles, method="coupled", damping=1.0, points=100)


def test_a_path_that_leads_back_is_judged_by_its_way(bent):
    """A motion that ends where it began asks for nothing: what is missed counts by how far the path has led."""
    edit, _, _ = bent
    back = replace(edit, wanted=1e-12 * edit.wanted)
    assert reached_target(edit)
    assert not reached_target(back)
    assert reached_target(replace(edit, wanted=edit.wanted + 0.05), way=10.0)
    assert not reached_target(replace(edit, wanted=edit.wanted + 0.05))
