"""Triangulations of the inside of curves: their areas, holes and pieces, and their sides on the curve."""

import math

import numpy as np
import pytest
import torch

from implicit import Field, shapes
from implicit.field.field import SurfaceError
from implicit.surface.planar_domain import planar_domain


def area_of(domain):
    a, b, c = (domain.vertices[domain.triangles[:, k]] for k in range(3))
    return float(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2)


def euler_of(domain):
    ends = np.sort(
        np.concatenate([domain.triangles[:, [0, 1]], domain.triangles[:, [1, 2]], domain.triangles[:, [2, 0]]])
    )
    return len(domain.vertices) - len(np.unique(ends, axis=0)) + len(domain.triangles)


def ring(half=1.0):
    class Ring(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.radius = torch.nn.Parameter(torch.tensor(0.5, dtype=torch.float64))

        def forward(self, points):
            return (points.norm(dim=1) - self.radius).abs() - 0.15

    return Field(Ring(), bounds=((-half, -half), (half, half)))


CASES = {
    "disk": (shapes.circle(radius=0.5), math.pi * 0.25, 1),
    "ring": (ring(), math.pi * (0.65**2 - 0.35**2), 0),
    "two": (
        shapes.smooth_union(
            shapes.circle(radius=0.3, center=(-0.4, 0.0)), shapes.circle(radius=0.2, center=(0.5, 0.0)), blend=1e-3
        ),
        math.pi * (0.09 + 0.04),
        2,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_area_pieces_and_holes_are_those_of_the_shape(name):
    field, area, euler = CASES[name]
    domain = planar_domain(field, 900)
    assert area_of(domain) == pytest.approx(area, rel=5e-3)  # chords of some 0.03 cut off this
    assert euler_of(domain) == euler
    assert 500 < len(domain.vertices) < 1800
    on_curve = torch.from_numpy(domain.vertices[: len(domain.sides)])
    assert float(field.value(on_curve).abs().max()) < 1e-6
    # The inside is on the left of each side: there the field is negative.
    start, end = (domain.vertices[domain.sides[:, k]] for k in range(2))
    left = np.stack([start[:, 1] - end[:, 1], end[:, 0] - start[:, 0]], axis=1)
    assert float(field.value(torch.from_numpy((start + end) / 2 + 0.3 * left)).max()) < 0


def test_the_area_converges_with_the_square_of_the_sides():
    gaps = [math.pi / 4 - area_of(planar_domain(shapes.circle(radius=0.5), n)) for n in (200, 800)]
    assert 3.0 < gaps[0] / gaps[1] < 5.0


def test_a_curve_that_leaves_the_bounds_is_refused():
    with pytest.raises(SurfaceError):
        planar_domain(ring(half=0.6), 200)
