"""From a mesh to a field: units, mending, the report, and real shapes."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

import implicit
import meshref
from compare.fitting import bundle
from compare.fitting.fit import FitReport, fit_mesh

MESHES = Path(__file__).parents[4] / "shared" / "data" / "meshes"
needs_meshes = pytest.mark.skipif(not MESHES.is_dir(), reason="the meshes of ../shared/data are not here")

V, F = meshref.torus(96, 48, 0.6, 0.25)
QUICK = {"steps": 300}


@pytest.fixture(scope="module")
def fitted():
    return fit_mesh(V, F, **QUICK)


def test_a_torus_is_fitted_well_and_the_report_says_so(fitted):
    field, report = fitted
    assert isinstance(report, FitReport)
    assert report.good
    assert report.verdict.startswith("Good")
    assert report.mean_distance < 0.001
    assert report.mean_distance <= report.max_distance < 0.01
    assert report.mean_value <= report.max_value < 0.01
    assert abs(report.volume_error) < 0.005
    assert abs(report.area_error) < 0.005
    assert report.normal_error < 4  # the mesh is faceted: its normals turn by up to 4 degrees between faces
    assert report.gradient_low < 1 < report.gradient_high
    assert report.gradient_mean == pytest.approx(1, abs=0.02)
    assert (report.genus, report.genus_mesh, report.components, report.components_mesh) == (1, 1, 1, 1)
    assert report.parameters == field.theta.numel() == 2273
    assert report.steps == 300
    assert 0 < report.seconds_training < report.seconds
    assert report.mended == ()


def test_the_report_agrees_with_a_measurement_from_outside(fitted):
    field, report = fitted
    V2, F2 = implicit.extract_mesh(field, 96)
    V2 = field.units.to_user(torch.from_numpy(V2)).numpy()
    assert meshref.chamfer(V2, F2, V, F, seed=3) == pytest.approx(report.mean_distance_user, rel=0.1)
    assert report.mean_distance_user == pytest.approx(report.mean_distance * report.diagonal)
    assert report.diagonal == pytest.approx(np.linalg.norm(np.ptp(V, axis=0)))
    assert meshref.volume(V2, F2) / meshref.volume(V, F) - 1 == pytest.approx(report.volume_error, abs=2e-3)


def test_the_report_is_plain_data(fitted):
    _, report = fitted
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert data["mean_distance"] == report.mean_distance
    assert data["offset"] == list(report.offset)


@pytest.mark.usefixtures("light")
def test_units_lead_back_to_where_the_mesh_was(fitted):
    """Scaled, and moved by ten sizes: the field is nearly the same, its units are not."""
    moved = 40 * V + np.array([500.0, -200.0, 30.0])
    field, report = fit_mesh(moved, F, **QUICK)
    assert report.scale == pytest.approx(40 * fitted[1].scale)
    assert report.good
    on_mesh = torch.from_numpy(meshref.sample_mesh(moved, F, 2000).points)
    values = field.value(field.units.to_field(on_mesh).to(field.dtype))
    assert float(values.abs().mean()) * report.scale < 0.001 * report.diagonal
    box = field.units.to_user(torch.tensor([[-0.8, -0.8, 0.0], [0.8, 0.8, 0.0]], dtype=torch.float64)).numpy()
    np.testing.assert_allclose(box[:, :2], [moved.min(axis=0)[:2], moved.max(axis=0)[:2]])


@pytest.fixture
def light(monkeypatch):
    """A fifth of the samples, and a report at fewer cells: a fit of a simple shape is as good."""
    monkeypatch.setattr("compare.fitting.fit.ON_SURFACE", 12_000)
    monkeypatch.setattr("compare.fitting.fit.ABOUT_SURFACE", ((10_000, 0.005), (10_000, 0.02), (10_000, 0.06)))
    monkeypatch.setattr("compare.fitting.fit.IN_CUBE", 8_000)
    monkeypatch.setattr("compare.fitting.fit.RESOLUTION", 64)
    monkeypatch.setattr("compare.fitting.fit.QUADRATURE", 64)
    monkeypatch.setattr("compare.fitting.bundle.RESOLUTION", 64)


@pytest.fixture
def coarse(monkeypatch, light):
    """Few samples and a report that takes no time, for tests that look at the weights."""
    monkeypatch.setattr("compare.fitting.fit.ON_SURFACE", 3_000)
    monkeypatch.setattr("compare.fitting.fit.ABOUT_SURFACE", ((2_000, 0.005), (2_000, 0.02), (2_000, 0.06)))
    monkeypatch.setattr("compare.fitting.fit.IN_CUBE", 2_000)
    monkeypatch.setattr("compare.fitting.fit.RESOLUTION", 24)
    monkeypatch.setattr("compare.fitting.fit.QUADRATURE", 24)


@pytest.mark.usefixtures("coarse")
def test_the_same_seed_gives_the_same_weights():
    first, again, other = (fit_mesh(V, F, steps=5, seed=seed)[0].theta for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.usefixtures("coarse")
def test_what_was_mended_is_named():
    inward = F[:, ::-1]
    doubled = np.concatenate([V, V[:10], [[9.0, 9.0, 9.0]]])
    _, report = fit_mesh(doubled, inward, steps=20)
    said = " ".join(report.mended)
    assert "unreferenced" in said
    assert "turned" in said


def test_a_mesh_that_cannot_be_mended_is_refused_with_the_reason():
    with pytest.raises(meshref.MeshError, match="hole"):
        fit_mesh(V, F[: len(F) // 2], hole_limit=0.01)
    with pytest.raises(meshref.MeshError, match="finite"):
        fit_mesh(np.where(V > 0.8, np.nan, V), F)


@pytest.mark.usefixtures("coarse")
def test_a_poor_fit_says_so_in_words():
    _, report = fit_mesh(V, F, steps=2)
    assert not report.good
    assert report.verdict.startswith("Below the stated quality: ")
    json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.usefixtures("coarse")
def test_a_fit_cut_short_by_time_says_so(monkeypatch):
    monkeypatch.setattr("implicit.fitting.fit.perf_counter", itertools.count().__next__)  # a second a look
    _, report = fit_mesh(V, F, steps=100_000, seconds=20.0)
    assert not report.good
    assert "time was over" in report.verdict
    assert report.steps < 100_000


@pytest.mark.usefixtures("light")
def test_several_bodies_are_kept_or_refused_as_asked():
    A, f = meshref.icosphere(3, 0.4, (-0.6, 0, 0))
    B, _ = meshref.icosphere(3, 0.3, (0.6, 0, 0))
    both, faces = np.concatenate([A, B]), np.concatenate([f, f + len(A)])
    _, report = fit_mesh(both, faces, steps=200)
    assert (report.components, report.components_mesh) == (2, 2)
    _, report = fit_mesh(both, faces, steps=100, bodies="largest")
    assert report.components_mesh == 1
    with pytest.raises(meshref.MeshError, match="bodies"):
        fit_mesh(both, faces, bodies="refuse")


@pytest.mark.usefixtures("coarse")
def test_an_interrupted_fit_resumes_to_the_same_weights(tmp_path):
    class StopError(Exception):
        pass

    def stop(step, steps, loss):
        if step == 15:
            raise StopError

    whole, _ = fit_mesh(V, F, steps=20)
    path = tmp_path / "torus.safetensors"
    with pytest.raises(StopError):
        fit_mesh(V, F, steps=20, checkpoint=path, progress=stop)
    resumed, _ = fit_mesh(V, F, steps=20, checkpoint=path)
    assert torch.equal(resumed.theta, whole.theta)


@pytest.mark.nightly
@needs_meshes
@pytest.mark.parametrize(
    ("name", "genus"),
    [
        ("rocker-arm.obj", 1),
        *(pytest.param(name, 0, marks=pytest.mark.nightly) for name in ("bunny.off", "bar.off", "spot.obj")),
    ],
)
def test_real_shapes_fit_below_the_stated_error_in_few_steps(name, genus):
    """A quarter of the default steps already leaves a mean distance under a quarter of what is asked."""
    _, report = fit_mesh(*meshref.read_mesh(MESHES / name), steps=1000)
    assert report.good, report.verdict
    assert report.mean_distance < 0.001
    assert report.genus == report.genus_mesh == genus
    assert math.isfinite(report.max_distance_user)


def test_bundling_says_which_mesh_is_missing(tmp_path, capsys):
    assert bundle.main(["spot", "--meshes", str(tmp_path), "--to", str(tmp_path)]) == 1
    assert "spot.obj" in capsys.readouterr().err
    assert bundle.main(["teapot", "--to", str(tmp_path)]) == 1
    assert "teapot" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("light")
def test_bundling_writes_a_field_and_its_report(tmp_path):
    assert bundle.main(["cactus", "--to", str(tmp_path), "--steps", "100"]) == 0
    field = implicit.load_field(tmp_path / "cactus.safetensors")
    report = json.loads((tmp_path / "cactus.json").read_text())
    assert field.theta.numel() == report["parameters"] == 2273
    assert (tmp_path / "cactus.safetensors").stat().st_size < 100_000


@pytest.mark.usefixtures("light")
def test_a_fit_below_the_quality_is_made_wider_within_its_budget():
    """A network of 4 sines a layer bends no torus; the report names every network, and the best is returned."""
    field, report = fit_mesh(V, F, width=4, steps=120, quality=0.003, budget=60.0)
    assert report.good
    assert len(report.attempts) >= 2
    assert report.attempts[0].startswith("3 layers, 61 parameters, 120 steps: Below")
    assert "Good" in report.attempts[-1]
    assert report.parameters == field.theta.numel() > 61
    json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.usefixtures("coarse")
def test_a_budget_that_is_over_ends_the_attempts_and_the_best_is_kept():
    _, report = fit_mesh(V, F, width=4, steps=5, quality=1e-9, budget=0.01)
    assert not report.good
    assert len(report.attempts) == 1
    _, alone = fit_mesh(V, F, width=4, steps=5)
    assert alone.attempts == ()


def test_a_budget_is_refused_where_the_network_is_fixed_or_it_is_no_time(tmp_path):
    for wrong in (0, -1.0, math.inf, math.nan, "a minute"):
        with pytest.raises(ValueError, match="budget must be a positive number"):
            fit_mesh(V, F, budget=wrong)
        with pytest.raises(ValueError, match="quality must be a positive number"):
            fit_mesh(V, F, quality=wrong)
    with pytest.raises(ValueError, match="budget widens the network, but checkpoint fixes it"):
        fit_mesh(V, F, budget=10.0, checkpoint=tmp_path / "state.safetensors")
