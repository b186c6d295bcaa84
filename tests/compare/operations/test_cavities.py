"""What no handle is on goes with the body it belongs to, and handles stay within the bounds."""

import numpy as np
import pytest
import torch

import meshref
from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.cases.handles import HandleSpec
from compare.cases.room import MARGIN
from compare.cases.subject import Subject
from compare.operations.cavities import carried, followed
from compare.operations.operation import Outcome, Target
from compare.operations.rigid import arap, killing
from compare.runs.subject import common_mesh
from implicit import shapes

BOUNDS = np.array([[-1.0] * 3, [1.0] * 3])


def turned(V, angle=0.5):
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return (V - [0.1, 0.2, 0]) @ R.T + [0.3, 0.1, -0.2]


def test_a_rigid_motion_takes_the_rest_along_exactly(rng):
    V = rng.uniform(-1, 1, (400, 3))
    edited = rng.random(400) < 0.7
    found = followed(V, edited, (turned(V) - V)[edited])
    np.testing.assert_allclose(V + found, turned(V), atol=1e-12)


def test_a_smooth_motion_is_followed_to_the_distance_of_the_rest(rng):
    """Of the motion d = 0.1 sin(x), a vertex e away from the edited surface misses by about e^2 at most."""
    V, _ = meshref.icosphere(4)
    both = np.concatenate([V, 0.95 * V])
    edited = np.arange(len(both)) < len(V)
    wanted = 0.1 * np.sin(both[:, [1, 2, 0]])
    found = followed(both, edited, wanted[edited])
    assert np.abs(found - wanted).max() < 0.01
    np.testing.assert_array_equal(found[edited], wanted[edited])


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def hollow():
    """A hollow ball whose two ends are handles: one held, one turned and moved."""
    V, F = meshref.icosphere(3, 0.7)
    both, faces = np.concatenate([V, 0.6 * V]), np.concatenate([F, F[:, ::-1] + len(V)])
    field = shapes.sphere(0.7)
    subject = Subject(field, both, faces, np.concatenate([V, -V]) / 0.7)
    held, moved = both[:, 2] < -0.5, both[:, 2] > 0.5
    return subject, held, moved


CASE = Case(
    "spot",
    "rigid",
    (HandleSpec({"kind": "ball", "center": [0, 0, 0], "radius": 1}, {"kind": "vector", "vector": [0, 0, 0]}),),
)


@pytest.mark.parametrize("editor", [killing, arap])
def test_the_cavity_of_a_body_that_is_moved_rigidly_moves_with_it(hollow, editor):
    subject, held, moved = hollow
    at = held | moved
    shift = np.array([0.1, -0.05, 0.2])
    target = Target(at.astype(int), at, np.where(at[:, None], shift, 0.0))
    outcome = carried(editor, CASE, subject, target, None)
    np.testing.assert_allclose(outcome.displacement, np.broadcast_to(shift, subject.V.shape), atol=1e-5)
    assert any("on which no handle is follows" in note for note in outcome.notes)


def test_a_hollow_ball_is_bent_with_its_cavity_inside(hollow):
    subject, held, moved = hollow
    target = Target(held + 2 * moved, held | moved, np.where(moved[:, None], [0.2, 0, 0.05], 0.0))
    outcome = carried(killing, CASE, subject, target, None)
    V = subject.V + outcome.displacement
    assert outcome.complete
    _, _, report = meshref.mend_mesh(V, subject.F)
    assert (report.bodies, report.cavities, report.united_parts, report.self_intersections) == (1, 1, 0, 0)


def test_a_mesh_whose_parts_are_all_held_is_left_to_the_editor(hollow):
    subject, _, _ = hollow
    seen = []

    def editor(case, whole, target, progress):
        seen.append(whole)
        return Outcome(np.zeros_like(whole.V), "none", "Done.", True, 0.0)

    at = np.arange(len(subject.V)) % 7 == 0
    carried(editor, CASE, subject, Target(at.astype(int), at, np.zeros_like(subject.V)), None)
    assert seen[0] is subject


@pytest.mark.parametrize("size", [(0.8, 0.8, 0.8), (0.8, 0.8, 0.3), (0.2, 0.8, 0.4)])
def test_default_handles_stay_within_the_bounds(size):
    """A cube as wide as it is long leaves no room for the usual pull; a slender box does, and keeps it."""
    V, F = meshref.box(-np.array(size), size, subdivisions=3)
    N = meshref.vertex_normals(V, F)
    free = default_cases("spot", V, N)
    bound = default_cases("spot", V, N, bounds=BOUNDS)
    largest = 1 - 2 * MARGIN
    for case in bound:
        for handle in case.handles:
            moved = handle.build().weights(torch.from_numpy(V)).numpy() > 0
            motion = handle.motion
            ends = V + np.asarray(motion["vector"]) if motion["kind"] == "vector" else V + motion["distance"] * N
            assert np.abs(ends[moved]).max() <= largest + 1e-6
    pull = [np.linalg.norm(cases[2].handles[1].motion["vector"]) for cases in (free, bound)]
    assert pull[1] == pytest.approx(min(pull[0], largest - min(size)), abs=1e-6)
    assert free[:1] == bound[:1]


@pytest.mark.parametrize(("radius", "kept"), [(0.3, True), (0.04, False)])
def test_a_cavity_belongs_to_the_common_mesh_and_a_spurious_void_does_not(radius, kept):
    field = shapes.smooth_difference(shapes.sphere(0.7), shapes.sphere(radius), blend=0.005)
    V, F, remarks = common_mesh(field, 600, 64)
    whole = 4 / 3 * np.pi * (0.7**3 - (radius**3 if kept else 0))
    assert meshref.component_count(V, F) == 1 + kept
    assert meshref.volume(V, F) == pytest.approx(whole, rel=0.02)
    said = [] if kept else ["The surface of the field has a void of"]
    assert [remark[: len(words)] for remark, words in zip(remarks, said, strict=True)] == said
