"""Mean-curvature flow: the shrinking sphere, the volume, and how it ends."""

import sys

import numpy as np
import pytest

from meshref import (
    FlowStatus,
    MeshError,
    box,
    centroid,
    converged_curvature_flow,
    cylinder,
    explicit_step_limit,
    icosphere,
    mean_curvature_flow,
    sphericity,
    torus,
    volume,
)

flow_module = sys.modules["meshref.flow"]


def shrunk_radius_squared(V, F, method, steps, time=0.1):
    result = mean_curvature_flow(V, F, steps=steps, step_size=time / steps, method=method)
    assert result.status is FlowStatus.FINISHED
    return np.mean(np.sum((result.V - result.V.mean(axis=0)) ** 2, axis=1))


def test_explicit_spheres_shrink_as_the_square_root_of_time():
    """R^2 = 1 - 4 t."""
    V, F = icosphere(2)
    assert shrunk_radius_squared(V, F, "explicit", 400) == pytest.approx(0.6, rel=1e-3)


@pytest.mark.parametrize("method", ["semi-implicit", "conformalised"])
def test_implicit_spheres_do_so_with_order_one_in_the_step(method):
    """Compared with a reference of tiny steps, so that the error of the mesh does not mask that of time."""
    V, F = icosphere(2)
    radius = [shrunk_radius_squared(V, F, method, steps) for steps in (10, 20, 40, 80, 160)]
    assert radius[-1] == pytest.approx(0.6, rel=3e-3)
    change = np.abs(np.diff(radius))
    np.testing.assert_allclose(change[:-1] / change[1:], 2, rtol=0.1)


@pytest.mark.parametrize("preserve", ["newton", "rescale"])
@pytest.mark.parametrize(
    ("method", "step_size"), [("explicit", 1e-4), ("semi-implicit", 1e-2), ("conformalised", 1e-2)]
)
def test_the_volume_stays_and_the_shape_gets_rounder(method, step_size, preserve):
    V, F = box((-0.5, -0.5, -1), (0.5, 0.5, 1), subdivisions=3)
    result = mean_curvature_flow(V, F, steps=20, step_size=step_size, method=method, preserve_volume=preserve)
    assert result.status is FlowStatus.FINISHED
    drift = [row.volume / result.history[0].volume - 1 for row in result.history]
    assert np.abs(drift).max() < 1e-12
    assert abs(volume(result.V, F) / volume(V, F) - 1) < 1e-12
    roundness = [row.sphericity for row in result.history]
    assert min(np.diff(roundness)) > 0
    assert roundness[-1] == pytest.approx(sphericity(result.V, F), rel=1e-12)


@pytest.mark.parametrize("preserve", [None, "newton", "rescale"])
def test_the_flow_moves_with_the_mesh(preserve):
    """Rescaling is about the centroid, not about the origin."""
    V, F = box((0, 0, 0), (1, 1, 2), subdivisions=2)
    shift = np.array([40.0, -70.0, 90.0])
    options = {"steps": 10, "step_size": 1e-2, "preserve_volume": preserve}
    here, there = mean_curvature_flow(V, F, **options), mean_curvature_flow(V + shift, F, **options)
    np.testing.assert_allclose(there.V - shift, here.V, atol=1e-11)
    np.testing.assert_allclose(centroid(here.V, F), centroid(V, F), atol=1e-3)


def test_the_flow_scales_with_the_mesh():
    V, F = box(subdivisions=2)
    small = mean_curvature_flow(V, F, steps=5, step_size=1e-2)
    large = mean_curvature_flow(10 * V, F, steps=5, step_size=1.0)
    np.testing.assert_allclose(large.V, 10 * small.V, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("method", ["semi-implicit", "conformalised"])
def test_a_sphere_that_vanishes_ends_in_a_status_and_finite_numbers(method):
    V, F = icosphere(2)
    result = mean_curvature_flow(V, F, steps=100, step_size=0.05, method=method)
    assert result.status is FlowStatus.COLLAPSED
    assert result.steps_taken == len(result.history) - 1 < 100
    assert np.isfinite(result.V).all()
    assert volume(result.V, F) > 0


def test_an_explicit_step_beyond_the_limit_is_noticed():
    V, F = torus(30, 15)
    limit = explicit_step_limit(V, F)
    assert mean_curvature_flow(V, F, steps=5, step_size=0.9 * limit, method="explicit").status is FlowStatus.FINISHED
    result = mean_curvature_flow(V, F, steps=500, step_size=3 * limit, method="explicit")
    assert result.status is FlowStatus.UNSTABLE
    assert np.isfinite(result.V).all()


@pytest.mark.parametrize("subdivisions", [0, 2])
def test_the_explicit_limit_is_that_of_the_largest_eigenvalue(subdivisions):
    V, F = icosphere(subdivisions)
    curvature = sys.modules["meshref.curvature"]
    matrix = curvature.laplacian(V, F).toarray() / curvature.voronoi_areas(V, F)[:, None]
    assert explicit_step_limit(V, F) == pytest.approx(2 / np.linalg.eigvals(matrix).real.max(), rel=1e-5)


def test_the_bunny_loses_80_percent(real_mesh):
    """Conformalised, 86 steps of 1e-4 at unit area: the volume of the published smoothing example."""
    V, F = real_mesh("bunny.off")
    V = V / np.sqrt(sys.modules["meshref.measures"].area(V, F))
    result = mean_curvature_flow(V, F, steps=86, step_size=1e-4)
    assert result.status is FlowStatus.FINISHED
    assert result.history[-1].volume / result.history[0].volume - 1 == pytest.approx(-0.808, abs=0.001)


def test_bad_triangles_end_the_unclamped_flow_with_a_status(real_mesh):
    V, F = real_mesh("bunny.off")
    V = V / np.sqrt(sys.modules["meshref.measures"].area(V, F))
    result = mean_curvature_flow(V, F, steps=40, step_size=1e-3, method="semi-implicit", cotangents=None)
    assert result.status is not FlowStatus.FINISHED
    assert np.isfinite(result.V).all()
    assert result.steps_taken < 40


def test_rescaling_a_thin_torus_is_refused_and_a_uniform_speed_is_not():
    """The flow with its volume held by a uniform normal speed never makes the area grow; rescaled, by 12.7 % here."""
    V, F = torus(64, 24, 1.0, 0.1)
    for method in ("semi-implicit", "conformalised"):
        options = {"steps": 4, "step_size": 1e-3, "method": method}
        rescaled = mean_curvature_flow(V, F, preserve_volume="rescale", **options)
        assert rescaled.status is FlowStatus.AREA_GREW
        np.testing.assert_allclose(rescaled.V, V, atol=1e-15)
        held = mean_curvature_flow(V, F, preserve_volume="newton", **options)
        assert held.status is FlowStatus.FINISHED
        assert -0.01 < held.history[-1].area / held.history[0].area - 1 < 0


@pytest.mark.parametrize("preserve", [None, "newton"])
def test_a_semi_implicit_flow_of_slender_triangles_shrinks_and_limited_cotangents_are_refused(preserve):
    """A rod of one triangle from end to end, whose area limited cotangents make grow by 60 to 200 %."""
    V, F = cylinder(96, 1, 0.05, 3.0)
    options = {"steps": 10, "step_size": 1e-4, "method": "semi-implicit", "preserve_volume": preserve}
    result = mean_curvature_flow(V, F, **options)
    assert result.status is FlowStatus.FINISHED
    assert np.diff([row.area for row in result.history]).max() < 0
    limited = mean_curvature_flow(V, F, cotangents=(0, 5), **options)
    assert limited.status is FlowStatus.LIMITED
    np.testing.assert_allclose(limited.V, V, atol=1e-15)


def test_a_free_semi_implicit_step_lowers_the_area_however_long(rng):
    V, F = torus(20, 10)
    V = V + 0.02 * rng.standard_normal(V.shape)
    for step_size in (1e-3, 1e-1, 10.0):
        result = mean_curvature_flow(V, F, steps=1, step_size=step_size, method="semi-implicit")
        if result.status is FlowStatus.FINISHED:
            assert result.history[1].area < result.history[0].area
            assert result.history[1].substeps == 1
        else:
            assert result.status is FlowStatus.COLLAPSED


def test_steps_that_are_too_long_are_taken_in_halves():
    """The uniform motion outward after an overlong step inward overshoots."""
    V, F = torus(24, 12, 1.0, 0.3)
    result = mean_curvature_flow(V, F, steps=3, step_size=0.3, method="semi-implicit", preserve_volume="newton")
    assert result.status is FlowStatus.FINISHED
    assert [row.substeps for row in result.history] == [1, 1, 1, 4]
    assert np.diff([row.area for row in result.history]).max() < 0


def test_a_converged_flow_is_that_of_many_steps_and_its_estimate_is_honest():
    """Beside two flows of more steps, extrapolated here."""
    V, F = box((-0.5, -0.5, -1), (0.5, 0.5, 1), subdivisions=2)
    found = converged_curvature_flow(V, F, time=0.05, steps=4, tolerance=2e-4)
    assert found.converged
    assert len(found.flow.snapshots) == 5
    assert abs(volume(found.flow.V, F) / volume(V, F) - 1) < 1e-12
    options = {"method": "semi-implicit", "preserve_volume": "newton"}
    count = 2 * found.steps
    fine, finer = (mean_curvature_flow(V, F, steps=n, step_size=0.05 / n, **options).V for n in (count, 2 * count))
    error, plain = (
        np.sqrt(np.mean(((X - (2 * finer - fine)) ** 2).sum(axis=1))) for X in (found.flow.V, found.flow.snapshots[-1])
    )
    assert error < plain / 3
    assert error < 2 * found.time_error_rms < 4e-4 * np.linalg.norm(np.ptp(V, axis=0))
    assert found.time_error_rms < found.time_error_max


def test_a_flow_that_has_not_converged_says_so_and_by_how_much():
    V, F = box((-0.5, -0.5, -1), (0.5, 0.5, 1), subdivisions=3)
    found = converged_curvature_flow(V, F, time=0.05, steps=2, most_steps=8, tolerance=1e-9)
    assert not found.converged
    assert found.steps == 8
    np.testing.assert_array_equal(found.flow.V, found.flow.snapshots[-1])
    assert 1e-9 < found.time_error_rms < 0.05
    with pytest.raises(MeshError, match="most_steps must be a whole number, at least 8"):
        converged_curvature_flow(V, F, time=0.05, steps=2, most_steps=7)


def test_snapshots_and_progress():
    V, F = icosphere(1)
    seen = []
    result = mean_curvature_flow(
        V, F, steps=5, step_size=1e-3, snapshot_every=2, progress=lambda done, steps: seen.append((done, steps))
    )
    assert len(result.snapshots) == 3
    np.testing.assert_array_equal(result.snapshots[0], V)
    assert seen == [(k, 5) for k in range(1, 6)]
    assert [row.time for row in result.history] == pytest.approx([0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": -1}, "steps must be a whole number"),
        ({"step_size": 0.0}, "step_size must be a positive time"),
        ({"step_size": np.nan}, "step_size must be a positive time"),
        ({"method": "upside-down"}, "method must be one of 'conformalised'"),
        ({"preserve_volume": "yes"}, "preserve_volume must be one of None"),
        ({"snapshot_every": 0}, "snapshot_every must be a whole number"),
    ],
)
def test_unknown_options_are_refused(options, message):
    with pytest.raises(MeshError, match=message):
        mean_curvature_flow(*icosphere(1), **{"steps": 1, "step_size": 1e-3, **options})


def test_an_open_mesh_is_refused():
    V, F = icosphere(1)
    with pytest.raises(MeshError, match=r"must be closed.*mend_mesh"):
        mean_curvature_flow(V, F[1:], steps=1, step_size=1e-3)
