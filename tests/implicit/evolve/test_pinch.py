"""A neck pinches off, and the flow goes on with two bodies."""

import pytest
import torch

from implicit import Holding, Volume, explicit_step_limit, fit_field, integrate, sample_surface, shapes, smooth
from implicit.evolve.edit import EditStatus


@pytest.fixture(scope="module")
def dumbbell():
    """A network fitted to two balls on a bar."""
    balls = [shapes.sphere(0.28, (x, 0.0, 0.0)) for x in (-0.5, 0.5)]
    body = shapes.smooth_union(*balls, shapes.capsule((-0.5, 0, 0), (0.5, 0, 0), 0.06), blend=0.06)
    generator = torch.Generator().manual_seed(0)
    on = sample_surface(body, 3000, "uniform").points
    near = on + 0.03 * torch.randn(on.shape, generator=generator, dtype=torch.float64)
    far = 2.2 * torch.rand(3000, 3, generator=generator, dtype=torch.float64) - 1.1
    points = torch.cat([on, near, far])
    return fit_field(points, body.value(points), body.normal(points), steps=300)[0]


def test_a_dumbbell_falls_into_two_balls_with_its_volume(dumbbell):
    volume = integrate(dumbbell, Volume(), 48).value
    edit = smooth(
        dumbbell,
        steps=10,
        step_size=5e-4,
        constraints=(Volume(),),
        holding=Holding(resolution=20, fine_resolution=48),
        points=200,
        directions=100,
        resolution=24,
    )
    assert edit.status is EditStatus.DONE
    last = edit.history[-1]
    assert (last["components"], last["euler"]) == (2, 4)
    assert any("Pieces 1 to 2" in row.get("event", "") for row in edit.history)
    assert integrate(edit.field, Volume(), 48).value == pytest.approx(volume, rel=1e-6)
    assert torch.isfinite(edit.displacement).all()


def test_the_implicit_step_is_stable_at_twenty_times_the_explicit_limit(dumbbell):
    """The area falls in each step; explicitly at four times the limit it does not."""
    limit = explicit_step_limit(dumbbell)
    options = {"steps": 3, "points": 200, "resolution": 24}
    areas = [row["area"] for row in smooth(dumbbell, step_size=20 * limit, **options).history]
    assert areas[0] > areas[1] > areas[2]
