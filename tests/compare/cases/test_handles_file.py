"""Handles in the user's coordinates say there what the converted ones say in the field's."""

import re

import numpy as np
import pytest
import torch

import implicit
import meshref
from compare import HandleSpec, InputError
from compare.cases.handles_file import read_handles
from compare.runs.records import read

UNITS = implicit.Units(40.0, (100.0, 50.0, -20.0))
OF_USER = UNITS.to_user(2 * torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 1)
NORMALS = torch.nn.functional.normalize(OF_USER - 90, dim=1)

BALL = {"kind": "ball", "center": [110.0, 40.0, 0.0], "radius": 20.0, "falloff": 15.0}
BOX = {"kind": "box", "lower": [70.0, 30.0, -50.0], "upper": [110.0, 60.0, 0.0], "falloff": 9.0}
HALF = {"kind": "halfspace", "point": [100.0, 55.0, -20.0], "normal": [1.0, 2.0, 0.0], "falloff": 12.0}
PULL = {"kind": "vector", "vector": [0.0, 3.0, 5.0]}
TURN = {"kind": "rigid", "rotation": [0.0, 0.3, 0.1], "translation": [1.0, 2.0, 3.0], "center": [100.0, 50.0, 0.0]}
TURN_ABOUT_ORIGIN = {"kind": "rigid", "rotation": [0.0, 0.3, 0.1]}
FILE = """
[[handles]]
region = { kind = "ball", center = [120.0, 50.0, -20.0], radius = 12.0, falloff = 8.0 }
motion = { kind = "vector", vector = [2.0, 0.0, 0.0] }
"""


@pytest.mark.parametrize("region", [BALL, BOX, HALF], ids=lambda region: region["kind"])
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
    (handle,) = record.case.handles
    np.testing.assert_allclose(handle.region["center"], [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose([handle.region["radius"], handle.region["falloff"]], [0.3, 0.2])
    np.testing.assert_allclose(handle.motion["vector"], [0.05, 0, 0])


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
