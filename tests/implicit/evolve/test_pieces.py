"""Two balls of one radius that touch as it grows: what a step makes of their pieces."""

import pytest
import torch
from torch import nn

from implicit import Field, Holding
from implicit.evolve.constraints import ConstraintSet
from implicit.evolve.pieces import pieces, topology_row, undivided_part
from implicit.step.deformation import DeformationSpace
from implicit.surface.topology import Topology

HALF = 0.3  # of the distance of the centres: with a larger radius the balls are one piece
ONE, TWO = Topology(1, 2, (1.0,)), Topology(2, 4, (0.5, 0.5))


class TwoBalls(nn.Module):
    def __init__(self, radius, shift=0.0):
        super().__init__()
        self.radius = nn.Parameter(torch.tensor(radius, dtype=torch.float64))
        self.shift = shift

    def forward(self, points):
        x = (points[:, 0] - self.shift).abs() - HALF
        return torch.sqrt(x**2 + points[:, 1] ** 2 + points[:, 2] ** 2) - self.radius


def two_balls(radius, shift=0.0):
    return Field(TwoBalls(radius, shift))


def nothing_held(field):
    return ConstraintSet.of(field, (), Holding(resolution=24))


@pytest.mark.parametrize(
    ("radius", "change", "part"),
    [(0.4, -0.05, 1.0), (0.4, -0.15, 0.5), (0.35, -0.15, 0.25), (0.31, -0.08, 1.0)],
    ids=["none-divides", "the-whole-divides", "half-divides", "every-part-divides"],
)
def test_the_largest_part_of_a_step_is_taken_that_divides_nothing(radius, change, part):
    """From radius r by dr: one piece as long as r + part dr > HALF; where no part is, the whole is taken."""
    field = two_balls(radius)
    x = torch.tensor([change], dtype=torch.float64)
    found = undivided_part(field, x, DeformationSpace(field), nothing_held(field), ONE)
    assert found.part == part
    after = radius + part * change
    assert found.topology.components == (1 if after > HALF else 2)
    lengths = (found.measured.sample.points[:, 0].abs() - HALF).square() + found.measured.sample.points[
        :, 1:
    ].square().sum(1)
    assert float(lengths.sqrt().mean()) == pytest.approx(after, rel=1e-3)  # measured where the part ends


def test_pieces_that_a_coarse_mesh_joins_are_told_apart_by_a_finer_one():
    field = two_balls(0.29, shift=0.04)  # a gap of 0.02 between lattice planes that are 0.083 apart
    measured = nothing_held(field).measure(field)
    assert pieces(measured, field, 24).components == 1
    assert pieces(measured, field, 24, before=TWO).components == 2


def test_a_record_tells_of_a_change_of_the_pieces():
    assert topology_row(ONE, ONE) == {"components": 1, "euler": 2}
    assert topology_row(ONE, TWO) == {
        "components": 2,
        "euler": 4,
        "event": "Pieces 1 to 2, Euler number 2 to 4.",
    }
    assert topology_row(None, None) == {}
