"""Large rigid motions of fields beside converged ARAP on the mesh: as near, as low in energy, and in one piece."""

import importlib
from pathlib import Path

import pytest

import implicit
from implicit.evolve.edit import EditStatus

pytestmark = pytest.mark.nightly


@pytest.fixture
def scenes(monkeypatch):
    """The scenes of the benchmark, a package beside the sources."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return importlib.import_module("benchmarks.large_rigid")


@pytest.mark.parametrize("method", ["auto", "warp"])
@pytest.mark.parametrize(("make", "distance"), [("pull", 0.01), ("bend", 0.015)])
def test_an_edit_ends_where_arap_does(scenes, make, distance, method):
    scene = getattr(scenes, make)(scenes.Meshes(None, 32))
    edit, _ = scene.edit(method=method)
    arap = scene.arap()
    row = scene.row(edit, arap.V, arap.energy)
    assert edit.status is EditStatus.DONE
    assert row["H"] <= distance
    assert row["E"] <= 1.05
    assert (row["pieces"], row["Euler"]) == (1, 2)


def test_a_bar_twisted_by_135_degrees_ends_where_its_filled_mesh_does(scenes):
    scene = scenes.twist(scenes.Meshes(None, 64))
    edit, _ = scene.edit(constraints=[implicit.Volume()])
    row = scene.row(edit, *scene.with_volume())
    assert edit.status is EditStatus.DONE
    assert (row["pieces"], row["Euler"]) == (1, 2)
    assert row["H"] <= 0.03
    assert row["E"] <= 1.3
    assert row["handles"] <= 2e-3


def test_a_bar_ten_times_as_long_as_wide_turns_once_in_one_call(scenes):
    scene = scenes.whole_turn(scenes.Meshes(None, 64))
    edit, _ = scene.edit(constraints=[implicit.Volume()])
    row = scene.row(edit, *scene.with_volume())
    assert edit.status is EditStatus.DONE
    assert any("inside filled" in note for note in edit.notes)
    energies = [row["energy"] for row in edit.history if "energy" in row]
    assert energies[-1] > 0.1  # where the points unwind it falls to nothing
    assert (row["pieces"], row["Euler"]) == (1, 2)
    assert row["H"] <= 0.03
    assert row["handles"] <= 2e-3
