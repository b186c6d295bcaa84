"""A filled surface: points inside it, rigid motions free, stretches at the price that was asked."""

import numpy as np
import pytest
import torch
from torch import nn

import meshref
from implicit import Field
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.filled import Filled, points_inside
from implicit.step.spokes_and_rims import SpokesAndRims

HALF = np.array([0.05, 0.5, 0.05])


class Bar(nn.Module):
    """The distance to a bar ten times as long as wide, below 0 inside."""

    def __init__(self) -> None:
        super().__init__()
        self.sides = nn.Parameter(torch.from_numpy(HALF))

    def forward(self, points):
        return (points.abs() - self.sides).amax(dim=1)


@pytest.fixture(scope="module")
def bar():
    """Return the field and the mesh of its surface."""
    V, F = meshref.box(lower=tuple(-HALF), upper=tuple(HALF), subdivisions=3)
    return Field(Bar()), SpokesAndRims(V, F)


def test_points_stand_inside_away_from_the_surface(bar):
    field, shell = bar
    inside = points_inside(field, WeakSurface(shell.vertices, shell.faces))
    assert len(inside) > 20
    assert (np.abs(inside) < HALF).all()
    apart = np.linalg.norm(inside[:, None] - shell.vertices, axis=2).min(axis=1)
    assert (apart > 0.4 * 2 * (0.42 / len(shell.vertices)) ** 0.5).all()


def test_a_rigid_motion_costs_nothing_and_a_stretch_what_was_asked(bar):
    field, shell = bar
    filled = Filled.of(field, shell, 3.0)
    x, first = filled.vertices, len(shell.vertices)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    assert filled.energy(x @ turn.T + 1.0) < 1e-12
    grown = 1.2 * x
    assert filled.energy(grown) == pytest.approx(4 * shell.energy(grown[:first]), rel=1e-9)


def test_its_gradient_is_that_of_differences(bar):
    field, shell = bar
    filled = Filled.of(field, shell, 1.0)
    generator = np.random.default_rng(1)
    x, way = filled.vertices, generator.normal(size=filled.vertices.shape)
    u, step = x + 0.01 * generator.normal(size=x.shape), 1e-6
    slope = (filled.energy(u + step * way) - filled.energy(u - step * way)) / (2 * step)
    assert np.vdot(filled.gradient(u), way) == pytest.approx(slope, rel=1e-6)
