"""Files that leave a session are in the user's units, and what is set beside it is the mesh method's own."""

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import implicit
import meshref
from compare.cases.handles import HandleSpec
from compare.editor import Motion, Settings, ball, beyond_stroke, half_space
from compare.editor.drawing import colours, scale_of_colours, shown_range, sight, under_ray
from compare.editor.exports import MESHES, case_of, export_field, export_handles, export_mesh
from compare.editor.mesh_side import METHODS, beside
from compare.errors import InputError

EVERYTHING = ball([0.0, 0.0, 0.0], 2.0, 0.0)


def test_meshes_and_handles_are_in_the_units_of_the_file(in_user_units, tmp_path):
    """A sphere of radius 0.5 at the origin is one of radius 10 at (100, 0, -50) to the user."""
    session = in_user_units()
    for ending in MESHES:
        path = tmp_path / f"out{ending}"
        export_mesh(session, path, resolution=24)
        V = np.asarray(trimesh.load(path, force="mesh").vertices)
        np.testing.assert_allclose(np.linalg.norm(V - [100.0, 0.0, -50.0], axis=1), 10.0, atol=1e-4)
    assert session.measures()["volume"] == pytest.approx(4 / 3 * np.pi * 1000, rel=1e-4)
    session.pick(EVERYTHING)
    session.drag(Motion(translation=(0.1, 0.0, 0.0)))
    export_handles(session, 1, tmp_path / "own.toml")
    assert "vector = [2.0, 0.0, 0.0]" in (tmp_path / "own.toml").read_text()
    export_field(session, tmp_path / "out.safetensors")
    again = implicit.load_field(tmp_path / "out.safetensors")
    assert torch.equal(again.theta, session.field.theta)
    with pytest.raises(InputError, match="ending in"):
        export_mesh(session, tmp_path / "out.step")
    with pytest.raises(InputError, match="in a file"):
        case_of(session, 1)


def test_what_no_case_can_say_is_refused(sphere):
    sphere.pick(half_space([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]))
    sphere.drag(Motion(), "smooth", Settings(points=100, steps=1))
    with pytest.raises(InputError, match="in a file"):
        case_of(sphere, 1)
    with pytest.raises(InputError, match="There is no edit 2"):
        case_of(sphere, 2)


def test_a_motion_as_a_whole_costs_no_energy_on_either_side(sphere):
    """Both caps go the same way, so the mesh methods and the field move the sphere as it is."""
    before = sphere.field
    sphere.pick(EVERYTHING)
    sphere.drag(Motion(translation=(0.05, 0.0, 0.0)))
    ends = [
        Motion(translation=(0.05, 0.0, 0.0)).spec(sphere.pick(half_space(point, normal)))
        for point, normal in (([0.3, 0.0, 0.0], [1.0, 0.0, 0.0]), ([-0.2, 0.0, 0.0], [-1.0, 0.0, 0.0]))
    ]
    for method in METHODS:
        found = beside(before, sphere.evidence().edit, ends, method, rest_stays=False, vertices=400)
        np.testing.assert_allclose(found.moved - found.V, [[0.05, 0.0, 0.0]] * len(found.V), atol=1e-4)
        assert max(found.energies["Killing, membrane"]) < 1e-5
        assert max(found.energies["ARAP"]) < 1e-5
    with pytest.raises(InputError, match="A method is one of"):
        beside(before, sphere.evidence().edit, ends, "springs", rest_stays=False, vertices=400)


def test_what_lies_to_the_left_of_a_stroke_is_beyond_it():
    """Looking along -z with y up, a stroke from left to right has y > 0 to its left."""
    region = beyond_stroke([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0])
    assert np.dot(region["normal"], [0.0, 1.0, 0.0]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="across the view"):
        beyond_stroke([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])


def test_a_ray_meets_the_near_side_of_a_sphere(sphere):
    V, F = sphere.surface.V, sphere.surface.F
    place = under_ray(V, F, np.array([0.1, 0.05, 3.0]), np.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(place, [0.1, 0.05, np.sqrt(0.25 - 0.0125)], atol=0.01)
    assert under_ray(V, F, np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.0, 1.0])) is None
    assert under_ray(V, F, np.array([0.6, 0.0, 3.0]), np.array([0.0, 0.0, -1.0])) is None


def test_the_line_of_sight_goes_through_the_place_on_the_screen():
    """A camera turned half round about x looks along -z, y up; in a right angle of view the top is 45 degrees up."""
    turned = np.array([0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(sight(turned, np.pi / 2, 2.0, (0.5, 0.5)), [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(
        sight(turned, np.pi / 2, 2.0, (0.5, 0.0)), np.array([0.0, 1.0, -1.0]) / 2**0.5, atol=1e-12
    )
    np.testing.assert_allclose(
        sight(turned, np.pi / 2, 2.0, (1.0, 0.5)), np.array([2.0, 0.0, -1.0]) / 5**0.5, atol=1e-12
    )


def test_colours_run_from_blue_over_white_to_red_and_their_scale_says_so():
    painted = colours(np.array([-2.0, -1.0, 0.0, 1.0, np.nan]), 1.0)
    assert painted[0].tolist() == painted[1].tolist() == [33, 102, 172]
    assert painted[2].tolist() == [247, 247, 247]
    assert painted[3].tolist() == [178, 24, 43]
    assert painted[4].tolist() == [150, 150, 150]
    assert shown_range(np.array([0.0, 0.0137, np.nan])) == pytest.approx(0.02)
    assert shown_range(np.array([np.nan])) > 0
    assert "-20 %" in scale_of_colours("<missed>", 0.2)
    assert "&lt;missed&gt;" in scale_of_colours("<missed>", 0.2)


def test_energies_are_those_of_the_mesh_itself(sphere):
    """What the panel says of the mesh is what meshref says of it."""
    before = sphere.field
    sphere.pick(half_space([0.3, 0.0, 0.0], [1.0, 0.0, 0.0]))
    sphere.pick(half_space([-0.3, 0.0, 0.0], [-1.0, 0.0, 0.0]), "held")
    motion = Motion(translation=(0.1, 0.0, 0.0))
    sphere.drag(motion)
    handles = sphere.entries[0].handles
    found = beside(before, sphere.evidence().edit, handles, "ARAP", rest_stays=False, vertices=400)
    assert found.energies["ARAP"][0] == pytest.approx(meshref.arap_energy(found.V, found.F, found.moved))
    assert found.energies["ARAP"][0] > 1e-4
    held = found.V[:, 0] < -0.3
    np.testing.assert_allclose(found.moved[held], found.V[held], atol=1e-9)


def test_scaling_and_brushes_are_the_same_in_the_users_coordinates():
    """Both are given in 20 x + (100, 0, -50) and built for x; there they must do what they say in the former."""
    scale, offset, center = 20.0, np.array([100.0, 0.0, -50.0]), np.array([110.0, 0.0, -50.0])
    spec = HandleSpec(
        {"kind": "points", "centers": [center.tolist(), [90.0, 0.0, -50.0]], "radius": 5.0},
        {
            "kind": "similar",
            "factor": 2.0,
            "center": center.tolist(),
            "rotation": [0, 0, 0.5],
            "translation": [1, 0, 0],
        },
    )
    places = center + np.random.default_rng(0).normal(size=(50, 3)) * 8
    wanted = 2 * (places - center) @ Rotation.from_rotvec([0, 0, 0.5]).as_matrix().T + center + [1, 0, 0]
    handle = spec.in_field(scale, offset.tolist()).build()
    points = torch.from_numpy((places - offset) / scale)
    moved = handle.position(1.0, points, points).numpy() * scale + offset
    np.testing.assert_allclose(moved, wanted, atol=1e-9)
    near = np.minimum(np.linalg.norm(places - center, axis=1), np.linalg.norm(places - [90, 0, -50], axis=1)) <= 5
    assert (handle.weights(points).numpy() > 0).tolist() == near.tolist()
    assert 0 < near.sum() < 50
    with pytest.raises(ValueError, match="centers of a region must be points"):
        HandleSpec({"kind": "points", "centers": [[1, 2]], "radius": 1.0}, {"kind": "along", "distance": 1.0})
    with pytest.raises(ValueError, match="factor of a motion must be positive"):
        HandleSpec(spec.region, {"kind": "similar", "factor": 0.0, "center": [0, 0, 0]})
