"""Rigid edits in the plane: a bar that is bent as a solid, by finite rotations of its inside."""

import math
from dataclasses import replace

import pytest
import torch

from implicit import (
    Area,
    HalfSpace,
    Handle,
    RigidMotion,
    Volume,
    VolumeIntegral,
    extract_mesh,
    fit_field,
    integrate,
    project_to_surface,
    rigid_edit,
    shapes,
)
from implicit.edits import finite_rigid
from implicit.evolve.edit import EditStatus

LEFT, RIGHT = HalfSpace((-0.5, 0), (-1, 0)), HalfSpace((0.5, 0), (1, 0))
SIXTY = RigidMotion(rotation=math.pi / 3, center=(0.1, 0.0))


@pytest.fixture(scope="module", autouse=True)
def small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("implicit.edits.rigid.VERTICES", 500)
        patch.setattr(finite_rigid, "SAMPLES", 1500)
        patch.setattr(finite_rigid, "BATCH", 256)
        patch.setattr(finite_rigid, "ROUNDS", (150, 150))
        patch.setattr("implicit.fitting.follow.RATES", (1e-2, 1e-2))
        patch.setattr(finite_rigid, "LAST_STEPS", 2)
        yield


@pytest.fixture(scope="module")
def bar():
    """A rounded rectangle of 1.4 by 0.4, as sines."""
    generator = torch.Generator().manual_seed(0)
    points = 2 * torch.rand(6000, 2, generator=generator) - 1
    points[:3000] *= torch.tensor([0.9, 0.35])
    points.requires_grad_()
    corner = points.abs() - torch.tensor([0.6, 0.1])
    distances = corner.clamp(min=0).norm(dim=1) + corner.amax(dim=1).clamp(max=0) - 0.1
    (normals,) = torch.autograd.grad(distances.sum(), points)
    field, _ = fit_field(points.detach(), distances.detach(), normals, width=20, depth=2, steps=300, batch=512)
    return field


@pytest.fixture(scope="module")
def bent(bar):
    track = project_to_surface(bar, torch.from_numpy(extract_mesh(bar, 40)[0]).float())
    edit = rigid_edit(
        bar,
        [Handle(LEFT, (0.0, 0.0)), Handle(RIGHT, SIXTY)],
        constraints=[Volume()],
        points=400,
        resolution=32,
        track=track,
    )
    return track, edit


def test_a_bar_is_bent_by_sixty_degrees_with_its_area_held(bar, bent):
    _, edit = bent
    assert edit.status is EditStatus.DONE
    assert edit.history[0]["method"] == "finite rotations"
    error = edit.error_field()
    assert float(error[error.isfinite()].square().mean().sqrt()) < 0.02
    before, after = (integrate(field, Volume(), 64).value for field in (bar, edit.field))
    assert after == pytest.approx(before, rel=1e-5)
    assert (edit.after.pieces, edit.after.topology.euler) == (edit.before.pieces, edit.before.topology.euler)


def test_what_lies_beyond_the_handles_turns_as_a_whole(bent):
    """Distances within each end are as before, and the far one has turned by 60 degrees."""
    track, edit = bent
    for region, angle in ((LEFT, 0.0), (RIGHT, math.pi / 3)):
        there = region(track) > 0
        turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]).to(track)
        center = torch.tensor([0.1, 0.0]).to(track) if angle else torch.zeros(2).to(track)
        expected = (track[there] - center) @ turn.T + center
        assert float((edit.tracked[there].to(track) - expected).norm(dim=1).max()) < 0.01


def test_tracked_points_lie_on_the_edited_curve(bent):
    _, edit = bent
    values = edit.field.value(edit.tracked.to(edit.field.theta))
    assert float(values.abs().median()) < 1e-4


@pytest.mark.parametrize("held", [Area(), VolumeIntegral(lambda points: points[:, 0] ** 2)], ids=["length", "moment"])
def test_any_functional_is_held(bar, held):
    handles = [Handle(LEFT, (0.0, 0.0)), Handle(RIGHT, RigidMotion(rotation=0.5, center=(0.1, 0.0)))]
    edit = rigid_edit(bar, handles, constraints=[held], points=300, resolution=32)
    assert edit.status is EditStatus.DONE
    before, after = (integrate(field, held, 64).value for field in (bar, edit.field))
    assert after == pytest.approx(before, rel=2e-5)


def test_handles_that_turn_together_turn_the_field(bar):
    """Nothing is strained: the field is the one turned about the origin, in closed form."""
    quarter = RigidMotion(rotation=math.pi / 2, center=(0.0, 0.0))
    edit = rigid_edit(bar, [Handle(LEFT, quarter), Handle(RIGHT, quarter)], points=200, resolution=24)
    assert edit.status is EditStatus.DONE
    V = torch.from_numpy(extract_mesh(bar, 40)[0])
    turned = V @ torch.tensor([[0.0, 1.0], [-1.0, 0.0]]).to(V)  # rows: x -> R x
    assert float(edit.field.value(turned.to(edit.field.theta)).abs().max()) < 5e-3


def back():
    """The far end turned back by 60 degrees, about where it turned."""
    far = HalfSpace((0.35, 0.346), (0.5, 0.866))  # RIGHT, turned about (0.1, 0) by 60 degrees
    undone = RigidMotion(rotation=-math.pi / 3, center=(0.1, 0.0))
    return [Handle(LEFT, (0.0, 0.0)), Handle(far, undone)]


def test_what_is_dragged_back_against_the_shape_at_rest_is_as_it_was(bar, bent):
    """The energy of the whole way is then nothing; against the bent shape it is that of bending it."""
    _, edit = bent
    kept = rigid_edit(edit.field, back(), points=400, resolution=32, rest=edit)
    renewed = rigid_edit(edit.field, back(), method="finite", points=400, resolution=32)
    assert kept.status is EditStatus.DONE
    assert kept.history[0]["energy"] < 1e-6 * edit.history[0]["energy"]
    assert renewed.history[0]["energy"] > 0.1 * edit.history[0]["energy"]
    at_rest = kept.deformation.rest.surface.vertices
    assert float(abs(kept.deformation.positions[: len(at_rest), :2] - at_rest).max()) < 1e-3
    points = torch.from_numpy(extract_mesh(bar, 40)[0]).to(kept.field.theta)
    assert float(kept.field.value(points).abs().max()) < 0.01


def test_another_field_than_that_of_the_edit_is_refused(bar, bent):
    _, edit = bent
    with pytest.raises(ValueError, match="must be that of the edit given as rest"):
        rigid_edit(bar, back(), rest=edit)
    with pytest.raises(TypeError, match="rest must be the Edit"):
        rigid_edit(bar, back(), rest=bar)
    three = replace(edit, field=shapes.sphere(0.5))
    with pytest.raises(ValueError, match="a shape at rest of before"):
        rigid_edit(three.field, [], rest=three, method="linear")


def test_linear_steps_are_refused_in_the_plane(bar):
    handles = [Handle(LEFT, (0.0, 0.0)), Handle(RIGHT, (0.0, 0.1))]
    with pytest.raises(ValueError, match='"auto", "finite" or "warp" for a field in 2 dimensions'):
        rigid_edit(bar, handles, method="linear")
    with pytest.raises(ValueError, match="bending must be left out"):
        rigid_edit(bar, handles, bending=2.0)
