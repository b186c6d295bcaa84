"""Mean-curvature flow against its exact laws, and what it keeps."""

import math

import pytest
import torch

from implicit import Area, HalfSpace, Holding, Until, Volume, extract_mesh, shapes, smooth, surface_quadrature
from implicit.evolve.edit import EditStatus

BALL = {"points": 40, "directions": None, "resolution": 16}  # all of its points say the same of its radius


@pytest.mark.parametrize(("dimension", "rate"), [(3, 4.0), (2, 2.0)])
def test_a_sphere_shrinks_by_its_law(dimension, rate):
    """R^2 = R0^2 - 4 t in space, - 2 t in the plane; second order in the step, where the curvature is even."""
    field = shapes.sphere(radius=0.5) if dimension == 3 else shapes.circle(0.5)
    time = 0.04
    exact = math.sqrt(0.25 - rate * time)
    errors = []
    for steps in (8, 16):
        edit = smooth(field, steps=steps, step_size=time / steps, method="explicit", damping=0.0, **BALL)
        assert edit.status is EditStatus.DONE
        errors.append(abs(float(edit.field.theta[0]) - exact))
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("dimension", [3, 2])
def test_a_sphere_keeps_its_law_down_to_half_its_radius(dimension):
    """To a thousandth of the radius left, in explicit steps of which each takes 4 % of the way."""
    field = shapes.sphere(radius=0.5) if dimension == 3 else shapes.circle(0.5)
    time, steps = (0.5**2 - 0.25**2) / (2 * (dimension - 1)), 25
    edit = smooth(field, steps=steps, step_size=time / steps, method="explicit", until=Until(time=time), **BALL)
    assert edit.status is EditStatus.DONE
    assert float(edit.field.theta[0]) == pytest.approx(0.25, rel=1e-3)
    assert all(row["components"] == 1 for row in edit.history)


def test_smoothing_in_a_region_leaves_the_rest(wobbly):
    """As far as 625 parameters can tell the sides apart: in the mean square the rest moves a tenth as far at most."""
    edit = smooth(wobbly, steps=1, step_size=1e-3, where=HalfSpace((0.1, 0, 0), (1, 0, 0), falloff=0.2), points=800)
    motion, side = edit.displacement.norm(dim=1), edit.points[:, 0]
    rest, inside = (motion[part].square().mean().sqrt() for part in (side < -0.15, side > 0.1))
    assert float(rest) < 0.1 * float(inside)


@pytest.mark.parametrize(
    ("until", "name"),
    [(Until(time=2e-3), "time"), (Until(area=3.0), "area"), (Until(sphericity=0.99), "sphericity")],
)
def test_a_flow_stops_when_it_has_what_it_was_run_for(until, name):
    """Of an ellipsoid, in its own parameters: each rule stops at the first step that fulfils it."""
    field = shapes.ellipsoid((0.6, 0.5, 0.5))
    edit = smooth(field, steps=40, step_size=1e-3, until=until, points=60, directions=None, resolution=16)
    assert edit.status is EditStatus.REACHED
    assert until.met(edit.history[-1])
    assert not any(until.met(row) for row in edit.history[:-1])
    assert name in edit.history[-1]


def test_volume_is_kept_and_area_falls(wobbly):
    """With the volume held, d area / dt = -int (kappa - mean)^2; implicit steps this long take half or more."""
    sample = surface_quadrature(wobbly, 48)
    volume, area = Volume().value(wobbly, sample), Area().value(wobbly, sample)
    options = {"points": 300, "resolution": 16, "holding": Holding(resolution=16, fine_resolution=40)}
    edit = smooth(wobbly, steps=2, step_size=1e-3, constraints=(Volume(),), **options)
    after = surface_quadrature(edit.field, 48)
    assert edit.status is EditStatus.DONE
    assert Volume().value(edit.field, after) == pytest.approx(volume, rel=1e-5)
    kappa = wobbly.mean_curvature(sample.points)
    rate = sample.integrate(kappa**2) - sample.integrate(kappa) ** 2 / area
    assert 0.5 < (area - Area().value(edit.field, after)) / (2 * 1e-3 * rate) < 1
    assert all(row["constraint_gap"] < 1e-7 for row in edit.history)


def test_area_falls_at_the_rate_of_the_squared_curvature(wobbly):
    """d area / dt = -int kappa^2: the flow is the gradient flow of area."""
    sample = surface_quadrature(wobbly, 48)
    rate = sample.integrate(wobbly.mean_curvature(sample.points) ** 2)
    step = 2e-5
    edit = smooth(wobbly, steps=1, step_size=step, method="explicit", points=2000, damping=1e-9, resolution=24)
    fall = float(sample.weights.sum() - surface_quadrature(edit.field, 48).weights.sum()) / step
    assert fall == pytest.approx(rate, rel=0.05)


def test_the_implicit_step_goes_where_the_explicit_one_does_in_small_steps(wobbly):
    options = {"points": 300, "directions": 100, "resolution": 24}
    fine = smooth(wobbly, steps=10, step_size=2e-4, method="explicit", **options)
    coarse = smooth(wobbly, steps=2, step_size=1e-3, method="implicit", **options)
    areas = [float(surface_quadrature(edit.field, 32).weights.sum()) for edit in (fine, coarse)]
    before = float(surface_quadrature(wobbly, 32).weights.sum())
    assert before - areas[1] == pytest.approx(before - areas[0], rel=0.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "steps must be at least 1"),
        ({"steps": 1, "step_size": -1.0}, "step_size must be a positive"),
        ({"steps": 1, "method": "fast"}, "method must be"),
    ],
)
def test_bad_input_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        smooth(shapes.sphere(radius=0.5), **options)


def test_a_sphere_that_vanishes_ends_with_a_status():
    edit = smooth(shapes.sphere(radius=0.3), steps=200, step_size=2e-3, method="explicit", **BALL)
    # R^2 = 0.09 - 4 t is spent after 11.25 steps of 2e-3; the last ones are cut short by the damping.
    assert edit.status is EditStatus.SURFACE_LOST
    assert 8 <= len(edit.history) <= 16
    assert torch.isfinite(edit.field.theta).all()


@pytest.mark.parametrize(
    "name",
    ["cactus", pytest.param("spot", marks=pytest.mark.nightly), pytest.param("bracket", marks=pytest.mark.nightly)],
)
def test_coarse_settings_hold_the_volume_of_real_shapes(name):
    """A long step, few points, a coarse quadrature: the restoration must still converge."""
    field = shapes.bundled(name).to(torch.float64)
    options = {"points": 600, "resolution": 24, "holding": Holding(resolution=24, fine_resolution=32)}
    edit = smooth(field, steps=2, step_size=1e-3, constraints=(Volume(),), **options)
    assert edit.status is EditStatus.DONE
    assert max(row["constraint_gap"] for row in edit.history) < 1e-8


@pytest.mark.parametrize("precision", [torch.float32, torch.float64])
def test_vertices_of_any_precision_are_carried_along(precision):
    """As they come from extract_mesh, in double precision, on a field in single."""
    field = shapes.sphere(0.5).to(torch.float32)
    V, F = extract_mesh(field, resolution=12)
    track = torch.from_numpy(V).to(precision)
    edit = smooth(field, steps=1, step_size=1e-3, points=40, resolution=16, track=track)
    assert len(edit.frames(track, F)) == 2
    assert edit.tracked.norm(dim=1).mean() < 0.4999
