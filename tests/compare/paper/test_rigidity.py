"""One small rigid step beside the mesh's, and the scenes it is asked of."""

from dataclasses import replace

import numpy as np
import pytest

import meshref
from compare import Case, prepare_subject
from compare.cases.case import HandleSpec
from compare.paper.rigidity import mesh_of, mesh_seconds, pulled_case, rigidity
from compare.paper.scenes import pulled_less, rigid_scene
from compare.runs.operations import target_motion
from compare.runs.subject import Subject
from implicit import Units, shapes


@pytest.fixture(scope="module")
def cactus() -> Subject:
    return prepare_subject(Case("cactus", "smooth", vertices=1200, resolution=48))


@pytest.mark.nightly
def test_a_small_step_is_as_rigid_as_the_mesh_with_the_same_handle_error(cactus):
    found = rigidity("cactus", cactus, points=600)
    assert found.mesh_handle_error == pytest.approx(found.handle_error, rel=0.02)
    assert found.tangential < 1.02
    assert found.spokes_and_rims > 1  # of which the mesh's is the least there is, up to the form of the springs
    assert found.handle_error < 0.05


@pytest.mark.nightly
def test_a_smaller_part_of_a_pull_has_the_same_ratio(cactus):
    """Both editors are linear there: energies are quadratic in the part."""
    whole, half = (rigidity("cactus", cactus, points=300, part=part).tangential for part in (2e-3, 1e-3))
    assert half == pytest.approx(whole, rel=0.01)


def test_a_mesh_that_is_split_lies_on_the_surface():
    field = shapes.sphere(radius=0.7)
    V, F = mesh_of(field, 12_000)
    assert len(V) == pytest.approx(12_000, rel=0.2)
    assert np.abs(np.linalg.norm(V, axis=1) - 0.7).max() < 1e-6
    assert meshref.component_count(V, F) == 1


def test_the_mesh_is_timed_on_as_many_vertices_as_asked_for(cactus):
    timing = mesh_seconds(pulled_case("cactus", cactus), cactus, 800)
    assert timing.vertices == pytest.approx(800, rel=0.2)
    assert timing.seconds > 0


def test_the_cactus_has_its_foot_held_and_one_arm_moved_across(cactus):
    case = rigid_scene("cactus", cactus)
    target = target_motion(case, cactus)
    foot, arm = (cactus.V[target.handle == k] for k in (1, 2))
    assert (foot[:, 1] < -0.6).all()
    assert (arm[:, 0] > 0.3).all()
    size = np.ptp(cactus.V[:, 1])
    np.testing.assert_allclose(target.displacement[target.handle == 2], [[0, 0, 0.15 * size]] * len(arm), atol=1e-12)


def test_the_bunny_has_the_handles_of_the_published_notebook():
    """In the units of its file, whatever the field's are: on a mesh known in closed form, vertex by vertex."""
    V, F = meshref.icosphere(4, radius=0.08, center=(-0.02, 0.1, 0.0))
    field = shapes.sphere()
    field.units = Units(0.1, (-0.02, 0.1, 0.0))
    subject = Subject(field, (V - np.array(field.units.offset)) / 0.1, F, np.zeros_like(V))
    target = target_motion(rigid_scene("anywhere/bunny.off", subject), subject)
    ear = np.linalg.norm(V - [-0.02, 0.17, -0.015], axis=1) < 0.03
    base = V[:, 1] < V[:, 1].min() + 0.002
    assert ear.sum() > 10
    assert base.sum() > 1
    np.testing.assert_array_equal(target.handle == 2, ear)
    np.testing.assert_array_equal(target.handle == 1, base)
    np.testing.assert_allclose(target.displacement[ear] * 0.1, [[0.01, 0.0, 0.01]] * ear.sum())
    assert not target.displacement[base].any()


def test_only_vectors_can_be_shortened(cactus):
    (_, pull) = (scene := rigid_scene("spot", cactus)).handles
    shorter = pulled_less(scene, 0.1).handles[1].motion["vector"]
    np.testing.assert_allclose(shorter, 0.1 * np.array(pull.motion["vector"]))
    turned = HandleSpec(pull.region, {"kind": "rigid", "rotation": [0.0, 0.0, 1.0]})
    with pytest.raises(ValueError, match="handle 2 moves by 'rigid'"):
        pulled_less(replace(scene, handles=(scene.handles[0], turned)), 0.1)
