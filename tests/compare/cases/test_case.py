"""Cases are plain data: they come back from JSON, and their key stands for their content."""

import dataclasses
import shutil

import numpy as np
import pytest
import torch

import meshref
from compare import Case, HandleSpec, default_cases

BALL = {"kind": "ball", "center": [0.0, 0.0, 1.0], "radius": 0.3}
UP = {"kind": "vector", "vector": [0.0, 0.0, 0.1]}


def ellipsoid():
    """An ellipsoid with half axes 0.3, 0.8, 0.5: its surface and normals."""
    V, F = meshref.icosphere(4)
    V = V * [0.3, 0.8, 0.5]
    return V, meshref.vertex_normals(V, F)


def test_a_case_comes_back_from_json():
    case = Case("spot", "rigid", (HandleSpec(BALL, UP),), {"implicit": {"steps": 3}}, vertices=900, seed=7)
    assert Case.from_json(case.to_json()) == case
    assert Case.from_json(case.to_json()).key == case.key


@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"vertices": 901}, {"shape": "cactus"}, {"parameters": {"mesh": {"form": "membrane"}}}]
)
def test_the_key_changes_with_every_part(change):
    case = Case("spot", "rigid", (HandleSpec(BALL, UP),), vertices=900)
    assert dataclasses.replace(case, **change).key != case.key


def test_the_key_of_a_file_is_that_of_its_content(tmp_path):
    """The same file elsewhere is the same case; another content in the same place is not."""
    first, second = tmp_path / "a.off", tmp_path / "b.off"
    meshref.write_mesh(first, *meshref.icosphere(1))
    shutil.copy(first, second)
    key = Case(str(first), "smooth").key
    assert Case(str(second), "smooth").key == key
    meshref.write_mesh(first, *meshref.icosphere(1, radius=2.0))
    assert Case(str(first), "smooth").key != key


def test_operations_on_one_shape_share_their_subject():
    V, N = ellipsoid()
    cases = default_cases("spot", V, N)
    assert len({case.subject_key for case in cases}) == 1
    assert len({case.key for case in cases}) == 3


def test_default_handles_hold_one_end_and_pull_the_other_sideways():
    """On the ellipsoid y is longest and x thinnest: ends of 12 % of 1.6, moved along x by 15 % of 1.6."""
    V, N = ellipsoid()
    (case,) = default_cases("spot", V, N, operations=("rigid",))
    held, moved = (spec.build() for spec in case.handles)
    points = torch.from_numpy(V)
    np.testing.assert_array_equal(held.weights(points).numpy() > 0.5, V[:, 1] <= -0.8 + 0.12 * 1.6)
    np.testing.assert_array_equal(moved.weights(points).numpy() > 0.5, V[:, 1] >= 0.8 - 0.12 * 1.6)
    assert case.handles[0].holds
    assert not case.handles[1].holds
    np.testing.assert_allclose(case.handles[1].motion["vector"], [0.24, 0, 0])


def test_the_default_bump_sits_on_the_middle_of_the_thin_side():
    V, N = ellipsoid()
    (case,) = default_cases("spot", V, N, operations=("geometric",))
    np.testing.assert_allclose(case.handles[0].region["center"], [0.3, 0, 0], atol=0.05)


def test_the_default_bump_sits_on_a_face_of_a_tetrahedron_and_on_no_corner():
    """No face looks along an axis but the three that look back: of what looks forward most, a corner is first."""
    V, F = np.array([[0, 0, 0], [1.5, 0, 0], [0, 1.45, 0], [0, 0, 1.6]]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    sample = meshref.sample_mesh(V, np.array(F), 1500)
    (case,) = default_cases("spot", sample.points, sample.normals, operations=("geometric",))
    center = np.array(case.handles[0].region["center"])
    assert np.linalg.norm(V - center, axis=1).min() > 0.4
    plate = sample.points * [1, 1, 1e-3]  # whose back looks the other way, and is no corner
    (case,) = default_cases("spot", plate, np.sign(plate[:, 2:] - 5e-4) * [0, 0, 1.0], operations=("geometric",))
    assert case.handles[0].region["center"][2] > 5e-4


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Case("spot", "bend"), "operation must be one of geometric, smooth, rigid, but is 'bend'"),
        (lambda: Case("spot", "rigid"), "needs handles"),
        (lambda: Case("spot", "smooth", (HandleSpec(BALL, UP),)), "takes no handles"),
        (lambda: Case("spot", "smooth", vertices=3), "vertices must be a whole number, at least 100"),
        (lambda: HandleSpec({"kind": "cone"}, UP), "kind of a region must be one of ball, box, halfspace"),
        (lambda: HandleSpec({**BALL, "size": 1}, UP), "must have center, radius, falloff, but has .*size"),
        (
            lambda: HandleSpec(BALL, {"kind": "vector", "vector": [0, float("nan"), 0]}),
            "vector of a motion must be three finite numbers",
        ),
    ],
)
def test_what_makes_no_case_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
