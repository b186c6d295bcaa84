"""Rigid edits by a warp of space: what moves rigidly keeps its surface, and the network within stays as it was."""

import math

import pytest
import torch

from implicit import (
    Area,
    Field,
    HalfSpace,
    Handle,
    RigidMotion,
    Siren,
    Volume,
    decoder_field,
    extract_mesh,
    integrate,
    load_field,
    mesh_topology,
    project_to_surface,
    rigid_edit,
    save_field,
)
from implicit.edits import finite_rigid
from implicit.evolve.edit import EditStatus
from implicit.models.warp import Warp
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.step.surface_area import SurfaceArea
from tests.implicit.conftest import ANGLE, BEND, FOOT, TIP


@pytest.fixture(scope="module", autouse=True)
def small():
    """A mesh and samples that suit a rod."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("implicit.edits.rigid.VERTICES", 700)
        patch.setattr(finite_rigid, "SAMPLES", 3000)
        yield


@pytest.fixture(scope="module")
def bent(rod):
    V, F = extract_mesh(rod, 34)
    track = project_to_surface(rod.to(torch.float64), torch.from_numpy(V))
    edit = rigid_edit(rod, [FOOT, Handle(TIP, BEND)], method="warp", points=300, resolution=24, track=track)
    return edit, track, F


def turned(points):
    """The tip's motion, of points (N, 3), in closed form."""
    c, s = math.cos(ANGLE), math.sin(ANGLE)
    rotation = torch.tensor([[c, s, 0], [-s, c, 0], [0, 0, 1]], dtype=points.dtype)
    centre = torch.tensor([0, 0.4, 0], dtype=points.dtype)
    return (points - centre) @ rotation.T + centre + torch.tensor(BEND.translation, dtype=points.dtype)


def test_maps_that_are_all_one_rigid_motion_move_the_field_by_it():
    network = Siren(3, 8, 2, generator=torch.Generator().manual_seed(3)).double()
    warp = Warp(network, 5, width=0.2).double()
    points = 0.5 * torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    rotation = torch.linalg.matrix_exp(torch.tensor([[0, 0.3, 0], [-0.3, 0, 0.5], [0, -0.5, 0]], dtype=torch.float64))
    with torch.no_grad():
        warp.centres.copy_(points[:5])
        warp.maps[:, :3] = rotation
        warp.maps[:, 3] = points[:5] @ rotation + torch.tensor([0.1, 0.0, -0.1])
        warp.bounds.mul_(10)
        torch.testing.assert_close(warp(points), network(points @ rotation + torch.tensor([0.1, 0.0, -0.1])))


def test_the_tip_keeps_its_surface_and_the_network_its_weights(bent, rod):
    edit, track, _ = bent
    assert edit.status is EditStatus.DONE
    assert edit.history[0]["method"] == "finite rotations, warp"
    tip = track[:, 1] > 0.5  # clear of the border of the handle
    assert float((edit.tracked[tip] - turned(track[tip])).norm(dim=1).max()) < 2e-3
    within = edit.field.module.base.state_dict()
    for name, tensor in rod.module.state_dict().items():
        torch.testing.assert_close(within[name], tensor)
    V, F = extract_mesh(edit.field, 64)
    assert (mesh_topology(V, F).components, mesh_topology(V, F).euler) == (1, 2)


def test_it_costs_hardly_more_than_the_points(bent):
    edit, track, F = bent
    energy = SpokesAndRims(track.numpy(), F)
    assert energy.energy(edit.tracked.numpy()) < 1.15 * edit.history[0]["energy"]
    assert edit.history[0]["strain_left"] < 0.1 * edit.history[0]["energy"]


def test_a_field_in_warped_space_is_kept_in_a_file(bent, tmp_path):
    edit, track, _ = bent
    save_field(edit.field, tmp_path / "bent.safetensors")
    again = load_field(tmp_path / "bent.safetensors")
    points = track.to(edit.field.dtype) + 0.1
    assert torch.equal(again.value(points), edit.field.value(points))
    assert len(again.theta) == len(edit.field.theta)


def test_a_drag_back_from_rest_takes_the_place_of_the_warp(bent, rod):
    edit, _, _ = bent
    straight = rigid_edit(edit.field, [FOOT, _undone()], rest=edit, points=300, resolution=24)
    assert straight.history[0]["method"] == "finite rotations, warp"
    assert type(straight.field.module.base) is Siren
    V, _ = extract_mesh(rod, 24)
    gap = straight.field.value(torch.from_numpy(V).to(rod.theta))
    assert float(gap.abs().max()) < 2e-3
    with pytest.raises(ValueError, match='method must be "auto" or "warp"'):
        rigid_edit(edit.field, [FOOT, Handle(TIP, BEND)], rest=edit, method="finite", points=300)


def _undone():
    """The tip where it was taken, and the motion that takes it back."""
    place = tuple(turned(torch.tensor([[0.0, 0.4, 0.0]]))[0].tolist())
    back = RigidMotion(rotation=(0, 0, ANGLE), center=place, translation=tuple(-x for x in BEND.translation))
    return Handle(HalfSpace(place, (math.sin(ANGLE), math.cos(ANGLE), 0)), back)


@pytest.mark.nightly
def test_volume_and_area_are_held_by_the_points_and_then_by_the_field(rod):
    handles, held = [FOOT, Handle(TIP, BEND)], [Volume(), Area()]
    edit = rigid_edit(rod, handles, method="warp", constraints=held, points=300, resolution=24)
    assert edit.status is EditStatus.DONE
    rest, moved = edit.deformation.rest.energy.vertices, edit.deformation.positions
    faces = edit.deformation.rest.energy.faces
    for measure in (EnclosedVolume(faces, len(rest)), SurfaceArea(faces, len(rest))):
        assert measure.value(moved) == pytest.approx(measure.value(rest), rel=1e-12)
    for functional in held:
        before, after = (integrate(field.to(torch.float64), functional, 96).value for field in (rod, edit.field))
        assert after == pytest.approx(before, rel=1e-5)


def test_a_decoder_with_its_code_is_refused_before_any_work(monkeypatch):
    monkeypatch.setattr(finite_rigid, "_points", lambda *_: pytest.fail("The points were sought."))
    code = torch.tensor([0.5])
    ball = decoder_field(lambda points, r: points.norm(dim=1) - r, code)
    handles = [
        Handle(HalfSpace((0, -0.3, 0), (0, -1, 0)), (0.0, 0.0, 0.0)),
        Handle(HalfSpace((0, 0.3, 0), (0, 1, 0)), (0.1, 0.0, 0.0)),
    ]
    with pytest.raises(ValueError, match="needs a field of a module"):
        rigid_edit(ball, handles, method="warp", points=100, resolution=24)
    assert isinstance(ball, Field)
