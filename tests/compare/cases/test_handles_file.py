"""Handles in the user's coordinates say there what the converted ones say in the field's."""

import re

import numpy as np
import pytest
import torch

import implicit
import meshref
from compare import Case, HandleSpec, InputError, Subject
from compare.cases.handles import REGIONS
from compare.cases.handles_file import read_handles
from compare.cases.placing import placed
from compare.runs.records import read

UNITS = implicit.Units(40.0, (100.0, 50.0, -20.0))
OF_USER = UNITS.to_user(2 * torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 1)
NORMALS = torch.nn.functional.normalize(OF_USER - 90, dim=1)

BALL = {"kind": "ball", "center": [110.0, 40.0, 0.0], "radius": 20.0, "falloff": 15.0}
BOX = {"kind": "box", "lower": [70.0, 30.0, -50.0], "upper": [110.0, 60.0, 0.0], "falloff": 9.0}
HALF = {"kind": "halfspace", "point": [100.0, 55.0, -20.0], "normal": [1.0, 2.0, 0.0], "falloff": 12.0}
POINTS = {"kind": "points", "centers": [[110.0, 40.0, 0.0], [80.0, 60.0, -40.0]], "radius": 15.0, "falloff": 9.0}
PULL = {"kind": "vector", "vector": [0.0, 3.0, 5.0]}
TURN = {"kind": "rigid", "rotation": [0.0, 0.3, 0.1], "translation": [1.0, 2.0, 3.0], "center": [100.0, 50.0, 0.0]}
TURN_ABOUT_ORIGIN = {"kind": "rigid", "rotation": [0.0, 0.3, 0.1]}
FILE = """
[[handles]]
region = { kind = "ball", center = [120.0, 50.0, -20.0], radius = 12.0, falloff = 8.0 }
motion = { kind = "vector", vector = [2.0, 0.0, 0.0] }
"""


@pytest.mark.parametrize("region", [BALL, BOX, HALF, POINTS], ids=lambda region: region["kind"])
@pytest.mark.parametrize("motion", [PULL, {"kind": "along", "distance": 4.0}, TURN, TURN_ABOUT_ORIGIN])
def test_a_converted_handle_takes_the_same_points_to_the_same_places(region, motion):
    mine = HandleSpec(region, motion)
    user, field = mine.build(), mine.in_field(UNITS.scale, UNITS.offset).build()
    points = UNITS.to_field(OF_USER)
    torch.testing.assert_close(field.weights(points), user.weights(OF_USER))
    assert 0 < int((user.weights(OF_USER) > 0).sum()) < len(OF_USER)
    moved = UNITS.to_user(field.position(1.0, points, NORMALS))
    torch.testing.assert_close(moved, user.position(1.0, OF_USER, NORMALS))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no handles"),
        ("handles = 3", "holds no handles"),
        ("a =", "is no TOML"),
        ("coordinate = 'user'", "There is no key coordinate in"),
        ("coordinates = 'mm'" + FILE, 'coordinates in .* must be "user" or "field"'),
        (FILE + "name = 'top'", "Handle 1 in .* must have a region and a motion"),
        (FILE.replace("ball", "cube"), "Handle 1 in .* makes no sense: The kind of a region"),
    ],
)
def test_a_file_that_holds_something_else_is_refused(tmp_path, text, message):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_handles(tmp_path / "mine.toml")


def test_the_command_places_handles_in_the_coordinates_of_the_users_file(command, tmp_path):
    """A ball of radius 20 about (100, 50, -20) in a field that is 40 x + that is pulled at its end along x."""
    field = implicit.Field(implicit.shapes.sphere(0.5).module, bounds=((-1,) * 3, (1,) * 3), units=UNITS)
    implicit.save_field(field, tmp_path / "ball.safetensors")
    (tmp_path / "mine.toml").write_text(FILE)
    words = ("run", "ball.safetensors", "--quick", "--quiet", "-o", "out", "--operations", "geometric")
    ended = command(*words, "--handles", "mine.toml", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    (record,) = read(tmp_path / "out")
    assert (record.case.coordinates, record.case.handles) == ("user", read_handles(tmp_path / "mine.toml").handles)
    assert record.sides["mesh"].displacement_max == pytest.approx(2.0)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Moves what lies within 12 of (120, 50, \u221220)" in page
    assert (tmp_path / "out" / "table.csv").is_file()


def test_the_command_refuses_handles_that_no_edit_takes_or_that_are_not_there(command, tmp_path):
    (tmp_path / "mine.toml").write_text(FILE)
    ended = command("run", "spot", "--operations", "smooth", "--handles", "mine.toml", "-o", "out", cwd=tmp_path)
    assert (ended.returncode, "smooth takes none" in ended.stderr) == (2, True)
    ended = command("run", "spot", "--handles", "gone.toml", "-o", "out", cwd=tmp_path)
    assert (ended.returncode, "gone.toml cannot be read" in ended.stderr) == (2, True)
    assert not (tmp_path / "out").exists()


def test_a_starting_file_and_the_ranges_are_in_the_coordinates_of_the_shapes_file(command, tmp_path):
    """A ball of radius 20 about (100, 50, -20), given as a mesh."""
    V, F = meshref.icosphere(3)
    meshref.write_mesh(tmp_path / "ball.ply", 20 * V + [100, 50, -20], F)
    ended = command("handles", "ball.ply", "-o", "mine.toml", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    ranges = [[float(x) for x in re.findall(r"-?[0-9.]+", line)] for line in ended.stdout.splitlines()[:3]]
    np.testing.assert_allclose([row[:2] for row in ranges], [[80, 120], [30, 70], [-40, 0]], atol=0.5)
    found = read_handles(tmp_path / "mine.toml")
    assert found.coordinates == "user"
    points = torch.from_numpy(20 * V + [100, 50, -20])
    for handle in found.handles:
        assert 0 < int((handle.build().weights(points) > 0).sum()) < len(points) / 3
    ended = command("handles", "ball.ply", "-o", "mine.toml", cwd=tmp_path)
    assert (ended.returncode, "a new file" in ended.stderr) == (2, True)


@pytest.fixture(scope="module")
def ball():
    """A ball of radius 20 about (100, 50, -20) as a subject."""
    field = implicit.Field(implicit.shapes.sphere(0.5).module, bounds=((-1,) * 3, (1,) * 3), units=UNITS)
    V, F = meshref.icosphere(3)
    return Subject(field.to(torch.float64), 0.5 * V, F, V)


def test_a_nearest_point_is_placed_on_the_surface_whichever_coordinates_it_is_given_in(ball):
    """From the middle, the sphere's nearest place to a point lies on the way to it."""
    away = np.array([0.33, 0.0, 0.44])  # a length of 0.55
    for coordinates, point in (("user", UNITS.to_user(torch.tensor(away)).numpy()), ("field", away)):
        region = {"kind": "nearest", "point": point.tolist(), "radius": 4.0}
        case = Case(
            "ball", "geometric", (HandleSpec(region, {"kind": "along", "distance": 2.0}),), coordinates=coordinates
        )
        (handle,) = placed(case, ball).handles
        np.testing.assert_allclose(handle.region["center"], away / 1.1, atol=0.003)
        assert np.linalg.norm(handle.region["center"]) == pytest.approx(0.5, abs=1e-6)
        assert handle.region["radius"] == (0.1 if coordinates == "user" else 4.0)
        assert placed(case, ball).coordinates == "field"


def test_vertices_are_those_of_the_shapes_own_file(ball, tmp_path):
    V, F = meshref.icosphere(1)
    meshref.write_mesh(tmp_path / "ball.ply", UNITS.to_user(torch.from_numpy(0.5 * V)).numpy(), F)
    region = {"kind": "vertices", "vertices": [0, 7], "radius": 6.0}
    pull = {"kind": "vector", "vector": [4.0, 0.0, 0.0]}
    case = Case(str(tmp_path / "ball.ply"), "geometric", (HandleSpec(region, pull),), coordinates="user")
    (handle,) = placed(case, ball).handles
    np.testing.assert_allclose(handle.region["centers"], 0.5 * V[[0, 7]], atol=1e-12)
    assert [handle.region["radius"], *handle.motion["vector"]] == pytest.approx([0.15, 0.1, 0.0, 0.0])
    weights = handle.build().weights(torch.from_numpy(0.5 * V)).numpy()
    assert set(np.flatnonzero(weights)) >= {0, 7}
    for shape, number, message in (("spot", 0, "is no mesh file"), (case.shape, 42, "vertex 42 of .* which has 42")):
        wrong = HandleSpec({**region, "vertices": [number]}, pull)
        with pytest.raises(InputError, match=message):
            placed(Case(shape, "geometric", (wrong,), coordinates="user"), ball)


def test_a_case_in_the_users_coordinates_has_a_key_of_its_own_and_comes_back(ball):
    handle = HandleSpec({"kind": "nearest", "point": [0.0, 0.0, 1.0], "radius": 0.1}, PULL)
    field, user = (Case("spot", "geometric", (handle,), coordinates=name) for name in ("field", "user"))
    assert field.key != user.key
    assert Case.from_json(user.to_json()) == user
    assert "coordinates" not in field.to_dict()
    with pytest.raises(ValueError, match='coordinates must be "field" or "user", but are \'mm\''):
        Case("spot", "geometric", (handle,), coordinates="mm")
    with pytest.raises(ValueError, match="placed on a shape first"):
        handle.build()


@pytest.mark.parametrize(
    ("region", "message"),
    [
        ({"kind": "points", "centers": [], "radius": 1.0}, "centers of a region must be points of three"),
        ({"kind": "vertices", "vertices": [-1], "radius": 1.0}, "vertices of a region must be whole numbers"),
        ({"kind": "vertices", "vertices": [0.5], "radius": 1.0}, "vertices of a region must be whole numbers"),
        ({"kind": "nearest", "point": [0.0, 0.0], "radius": 1.0}, "point of a region must be three finite numbers"),
        ({"kind": "nearest", "point": [0.0, 0.0, 0.0]}, "must have point, radius, falloff"),
    ],
)
def test_regions_that_make_no_sense_are_refused(region, message):
    assert region["kind"] in REGIONS
    with pytest.raises(ValueError, match=message):
        HandleSpec(region, PULL)
