"""Curves in the plane: D = 2 works wherever the paper's formula does."""

import math

import pytest
import torch
from torch import nn

from implicit import (
    Along,
    Area,
    Ball,
    Field,
    Handle,
    Siren,
    Volume,
    extract_mesh,
    geometric_edit,
    sample_surface,
    smooth,
    surface_quadrature,
)

SQUARE = ((-1.0, -1.0), (1.0, 1.0))


class Loop(nn.Module):
    """A circle of radius 0.5 with a sine network on top."""

    def __init__(self):
        super().__init__()
        self.network = Siren(2, width=16, depth=2, generator=torch.Generator().manual_seed(2)).double()

    def forward(self, points):
        return points.norm(dim=1) - 0.5 + 0.15 * self.network(points)


@pytest.fixture
def rope():
    return Field(Loop(), bounds=SQUARE)


def test_length_is_that_of_a_fine_polygon(rope):
    V, E = extract_mesh(rope, 1000)
    polygon = ((V[E[:, 1]] - V[E[:, 0]]) ** 2).sum(axis=1) ** 0.5
    assert Area().value(rope, surface_quadrature(rope, 64)) == pytest.approx(polygon.sum(), rel=1e-5)


def test_a_rope_keeps_its_length_while_it_is_pulled(rope):
    """The paper's rope: a part of the curve moves, the whole keeps its length."""
    before = Area().value(rope, surface_quadrature(rope, 128))
    pull = Handle(Ball((0.5, 0.0), 0.05, falloff=0.3), Along(0.1))
    edit = geometric_edit(rope, pull, rest="free", points=400, steps=8, constraints=(Area(),), resolution=128)
    free = geometric_edit(rope, pull, rest="free", points=400, steps=8)
    after, unheld = (Area().value(e.field, surface_quadrature(e.field, 256)) for e in (edit, free))
    assert after == pytest.approx(before, rel=1e-6)
    assert abs(unheld / before - 1) > 1e-3
    error = edit.error_field()
    assert float(error[torch.isfinite(error)].square().mean().sqrt()) < 0.05


def test_a_curve_keeps_its_area_while_it_is_smoothed_towards_a_circle(rope):
    sample = surface_quadrature(rope, 128)
    area, length = Volume().value(rope, sample), Area().value(rope, sample)
    edit = smooth(rope, steps=10, step_size=2e-3, points=400, constraints=(Volume(),), resolution=128)
    after = surface_quadrature(edit.field, 256)
    assert Volume().value(edit.field, after) == pytest.approx(area, rel=1e-6)
    # 4 pi area / length^2 is 1 for a circle alone.
    roundness = [4 * math.pi * area / x**2 for x in (length, Area().value(edit.field, after))]
    assert roundness[0] < roundness[1] <= 1 + 1e-6


def test_a_bump_on_a_curve(rope):
    bump = Handle(Ball((0.0, 0.5), 0.1, falloff=0.3), Along(0.05))
    edit = geometric_edit(rope, bump, points=400, steps=8)
    assert float(edit.error_field().square().mean().sqrt()) < 0.02


def test_samples_are_even_along_the_curve(rope):
    sample = sample_surface(rope, 500)
    length = Area().value(rope, surface_quadrature(rope, 128))
    assert float(sample.weights.sum()) == pytest.approx(length, rel=2e-3)
