"""The targets of the figure of geometric edits."""

import pytest
import torch

from compare.paper.geometric import natural
from compare.paper.letters import Letters
from implicit import surface_quadrature
from implicit.shapes import bundled


def test_an_o_covers_its_ring_but_neither_its_middle_nor_what_is_behind():
    letter = Letters("O", (0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), height=0.4, depth=0.1)
    points = torch.tensor([[0.0, 0.0, 0.5], [0.0, 0.18, 0.5], [0.0, 0.18, -0.5], [0.0, 0.3, 0.5]])
    assert letter(points).tolist() == [0.0, 1.0, 0.0, 0.0]


@pytest.mark.parametrize("kind", ["bump", "stretch"])
def test_a_natural_displacement_is_a_tenth_high_on_a_quarter_of_the_surface(kind):
    field = bundled("spot").to(torch.float64)
    handle = natural(field, "spot", kind)
    sample = surface_quadrature(field, 64)
    weights = handle.weights(sample.points)
    share = float(sample.weights[weights > 0].sum() / sample.weights.sum())
    side = float((sample.points.amax(dim=0) - sample.points.amin(dim=0)).max())
    way = (handle.position(1.0, sample.points, sample.normals) - sample.points).norm(dim=1)
    assert share == pytest.approx(0.25, abs=0.005)
    assert float(way.max()) == pytest.approx(0.1 * side, rel=0.01)
