"""A mesh is mended once, however often it is asked for, and two overlapping balls are united before they are fitted."""

import os
from concurrent.futures import Executor, Future

import numpy as np
import pytest
from nasty_solids import figure_of_eight

import meshref
from compare import Case, run_cases
from compare.fitting import mending
from compare.fitting.fit import fit_mesh
from compare.fitting.mending import Mending, mended, read_mended


@pytest.fixture
def counted(monkeypatch):
    """Numbers of faces of the meshes that were really mended, from here on."""
    faces = []
    mend = meshref.mend_mesh

    def count(V, F, **options):
        faces.append(len(F))
        return mend(V, F, **options)

    monkeypatch.setattr(meshref, "mend_mesh", count)
    monkeypatch.setattr(mending, "_REMEMBERED", type(mending._REMEMBERED)())
    return faces


def test_a_file_is_mended_once_for_a_command_and_its_fit(counted, tmp_path):
    V, F = meshref.torus(24, 16, 0.6, 0.25)
    meshref.write_mesh(tmp_path / "a.ply", V, F[:, ::-1])
    V, F, report = read_mended(tmp_path / "a.ply", Mending())
    assert report.turned_faces == len(F)
    again = read_mended(tmp_path / "a.ply", Mending())
    assert again[2].steps == report.steps
    _, fitted = fit_mesh(V, F, steps=2, bodies="refuse")
    assert fitted.mended == ()
    assert counted == [len(F)]


def test_other_processes_take_the_mended_mesh_from_the_run_folder(counted, tmp_path):
    """A process that comes later remembers nothing: its memory is emptied here."""
    path, folder = tmp_path / "a.ply", tmp_path / "run"
    V, F = meshref.torus(24, 16, 0.6, 0.25)
    V[:4] += [5.0, 0.0, 0.0]
    V, F = np.concatenate([meshref.icosphere(1)[0], V + 0.3]), np.concatenate([meshref.icosphere(1)[1], F + 42])
    meshref.write_mesh(path, V, F)
    first = read_mended(path, Mending("keep"), folder=folder)
    assert [file.suffix for file in folder.iterdir()] == [".npz"]
    mending._REMEMBERED.clear()
    again = read_mended(path, Mending("keep"), folder=folder)
    assert len(counted) == 1
    np.testing.assert_array_equal(again[0], first[0])
    np.testing.assert_array_equal(again[1], first[1])
    np.testing.assert_array_equal(again[2].vertex_map, first[2].vertex_map)
    assert repr(again[2]) == repr(first[2])
    assert again[2].united_parts == first[2].united_parts
    mended(again[0], again[1], Mending("keep"))  # as its fit asks for it
    assert len(counted) == 1
    next(folder.iterdir()).write_bytes(b"cut short")
    mending._REMEMBERED.clear()
    read_mended(path, Mending("keep"), folder=folder)
    meshref.write_mesh(path, 2 * V, F)
    twice = read_mended(path, Mending("keep"), folder=folder)
    assert len(counted) == 3
    np.testing.assert_allclose(twice[0], 2 * first[0])


def test_the_meshes_of_cases_are_mended_here_before_they_go_to_other_processes(counted, tmp_path):
    V, F = meshref.torus(24, 16, 0.6, 0.25)
    meshref.write_mesh(tmp_path / "a.ply", V, F)
    (tmp_path / "b.ply").write_text("ply, but broken")
    seeds = [Case(str(tmp_path / name), "smooth", seed=seed) for name in ("a.ply", "b.ply") for seed in (0, 1)]
    kept = []

    class Elsewhere(Executor):
        def submit(self, function, /, *arguments):
            kept.append([file.name for file in (tmp_path / "run" / "subjects").iterdir()])
            never = Future()
            never.set_exception(RuntimeError("not run"))
            return never

    records = run_cases(seeds, Elsewhere(), folder=tmp_path / "run", on_failure="record")
    assert all(record.failed for record in records)
    assert counted == [len(F)]
    assert len(kept) == 4
    assert all(len(names) == 1 and names[0].endswith("-mended.npz") for names in kept)


def test_a_file_that_has_changed_and_other_choices_are_mended_anew(counted, tmp_path):
    V, F = meshref.icosphere(1)
    meshref.write_mesh(tmp_path / "a.ply", V, F)
    read_mended(tmp_path / "a.ply", Mending())
    read_mended(tmp_path / "a.ply", Mending("keep"))
    meshref.write_mesh(tmp_path / "a.ply", 2 * V, F)
    os.utime(tmp_path / "a.ply", ns=(1, 1))
    twice, _, _ = read_mended(tmp_path / "a.ply", Mending())
    assert np.abs(twice).max() == 2 * np.abs(V).max()
    assert len(counted) == 3


def test_what_is_remembered_is_bounded_and_cannot_be_written_to(counted):
    V, F = meshref.icosphere(1)
    for k in range(1, 9):
        kept, faces, _ = mended(k * V, F, Mending())
    assert len(mending._REMEMBERED) <= mending.REMEMBERED
    for array in (kept, faces):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    V[0] = 0  # the user's own is another


def test_two_balls_that_overlap_are_united_before_they_are_fitted(monkeypatch):
    """The walls of each inside the other would be trained as a surface of the field."""
    from compare.fitting import fit

    monkeypatch.setattr(fit, "ON_SURFACE", 6000)
    monkeypatch.setattr(fit, "ABOUT_SURFACE", ((5000, 0.005), (5000, 0.02), (5000, 0.06)))
    monkeypatch.setattr(fit, "IN_CUBE", 8000)
    monkeypatch.setattr(fit, "RESOLUTION", 48)
    monkeypatch.setattr(fit, "QUADRATURE", 48)
    V, F = meshref.icosphere(3)
    both = np.concatenate([V, V + np.array([0.9, 0.1, 0.05])]), np.concatenate([F, F + len(V)])
    _, report = fit_mesh(*both, steps=300)
    assert any(step.startswith("united 2 parts that overlap") for step in report.mended)
    assert (report.components, report.components_mesh, report.genus) == (1, 1, 0)
    # Two unit balls at a distance d: 8 pi / 3 less the lens, pi (4 + d) (2 - d)^2 / 12.
    d = np.linalg.norm([0.9, 0.1, 0.05])
    wanted = 8 * np.pi / 3 - np.pi * (4 + d) * (2 - d) ** 2 / 12
    meshed = meshref.volume(*meshref.mend_mesh(*both)[:2])
    assert meshed == pytest.approx(wanted, rel=0.01)
    assert abs(report.volume_error) < 0.02


@pytest.mark.nightly
def test_a_tube_through_itself_is_fitted_without_walls_inside(monkeypatch):
    """Two strands cross; with the walls of each inside the other as f = 0, the field would have pieces there."""
    from compare.fitting import fit

    V, F = figure_of_eight()
    given = []

    def keep(points, distances, normals, **_):
        given.extend((points.numpy(), distances.numpy()))
        raise InterruptedError

    monkeypatch.setattr(fit, "fit_field", keep)
    with pytest.raises(InterruptedError):
        fit_mesh(V, F, steps=1)
    points, distances = given
    scale = 0.8 / np.abs(V).max()
    # Near the middle the strands are straight, along (1, 1) and (1, -1): so deep a point lies in them at least.
    near = (
        points[np.linalg.norm(points, axis=1) < 0.15 * scale],
        distances[np.linalg.norm(points, axis=1) < 0.15 * scale],
    )
    across = near[0][:, :2] @ (np.array([[1, 1], [1, -1]]) / 2**0.5)
    depth = 0.12 * scale - np.hypot(across, near[0][:, 2:]).min(axis=1)
    assert (-near[1] > depth - 0.01 * scale).all()
    drawn = fit.ON_SURFACE + sum(number for number, _ in fit.ABOUT_SURFACE) + fit.IN_CUBE
    assert 0.9 * drawn < len(points) < drawn
