"""The flows against closed forms, on shapes of few parameters."""

import math

import pytest
import torch

from implicit import Bending, Holding, MeanCurvature, Offset, Until, Volume, shapes, smooth, surface_quadrature
from implicit.edits.flows import curvature_slope

COARSE = {"points": 80, "directions": None, "resolution": 16}


def test_the_curvature_of_a_torus_has_its_closed_form_slope():
    """kappa = 1/r + cos(v) / rho with rho = R + r cos(v): its slope along the tube is -sin(v) R / (r rho^2)."""
    field = shapes.torus(0.6, 0.2)
    points = surface_quadrature(field, 24, exact_points=True).points
    ring = points[:, :2].norm(dim=1)
    cos, sin = (ring - 0.6) / 0.2, points[:, 2] / 0.2
    total, slope = curvature_slope(field, points)
    torch.testing.assert_close(total, 25 + (cos / ring) ** 2, rtol=1e-9, atol=1e-9)
    radial = torch.cat([points[:, :2] / ring[:, None], torch.zeros_like(points[:, :1])], dim=1)
    along = -sin[:, None] * radial + cos[:, None] * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close((slope * along).sum(dim=1), -sin * 0.6 / (0.2 * ring**2), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("ratio", "steps", "step_size"), [pytest.param(1.2, 15, 2e-4, marks=pytest.mark.nightly), (2.2, 8, 4e-4)]
)
def test_bending_takes_a_torus_to_cliffords(ratio, steps, step_size):
    """int kappa^2 / 4 of a torus is pi^2 c^2 / sqrt(c^2 - 1), c = R / r: least at c = sqrt(2), where it is 2 pi^2."""
    field = shapes.torus(0.5, 0.5 / ratio)
    held = {"constraints": (Volume(),), "holding": Holding(resolution=24, fine_resolution=32)}
    edit = smooth(field, steps=steps, step_size=step_size, flow=Bending(), **held, **COARSE)
    R, r = edit.field.theta.tolist()
    before, after = abs(ratio - math.sqrt(2)), abs(R / r - math.sqrt(2))
    assert after < 0.3 * before


def test_a_ball_is_at_rest_under_bending():
    """Willmore's energy does not depend on scale, so a sphere neither shrinks nor grows."""
    field = shapes.sphere(radius=0.4)
    edit = smooth(field, steps=3, step_size=1e-4, flow=Bending(), **COARSE)
    assert float(edit.field.theta[0]) == pytest.approx(0.4, abs=1e-6)


def test_offsetting_a_torus_obeys_steiners_formula():
    """V(t) = V + A t + (int kappa) t^2 / 2 + 2 pi chi t^3 / 3, and the parallel torus is a torus with r + t."""
    field = shapes.torus(0.5, 0.2)
    options = {**COARSE, "resolution": 24}
    edit = smooth(field, steps=3, step_size=0.03, flow=Offset(), until=Until(time=0.06), **options)
    R, r = edit.field.theta.tolist()
    assert len(edit.history) == 2
    assert (R, r) == (pytest.approx(0.5, abs=1e-5), pytest.approx(0.26, abs=1e-5))
    bend = 4 * math.pi**2 * 0.5  # int kappa of a torus is 4 pi^2 R
    steiner = 2 * math.pi**2 * 0.5 * 0.2**2 + 4 * math.pi**2 * 0.5 * 0.2 * 0.06 + bend * 0.06**2 / 2
    assert edit.history[-1]["volume"] == pytest.approx(steiner, rel=1e-3)


def test_flow_to_constant_mean_curvature_keeps_the_volume_by_itself():
    """Huisken's flow: an ellipsoid rounds at d volume / dt = -int (kappa - mean kappa) = 0, with nothing held."""
    field = shapes.ellipsoid((0.5, 0.42, 0.46))
    options = {"steps": 10, "step_size": 4e-3, **COARSE}
    edit = smooth(field, flow=MeanCurvature(level="mean"), **options)
    radii = edit.field.theta[:3]
    assert float(radii.max() / radii.min()) < 0.5 * (0.5 / 0.42 - 1) + 1
    assert float(radii.prod()) == pytest.approx(0.5 * 0.42 * 0.46, rel=0.02)
    shrunk = smooth(field, **options).field.theta[:3]
    assert float(shrunk.prod()) < 0.7 * 0.5 * 0.42 * 0.46
