"""Regions and their combinations."""

import pytest
import torch

from implicit import Along, Ball, Box, HalfSpace, Handle, NearPoints, PickedVertices

POINTS = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [0, 2.0, 0]], dtype=torch.float64)


def weights(region):
    return region(POINTS).tolist()


def test_each_region_holds_its_points():
    assert weights(Ball((0, 0, 0), 0.6)) == [1, 1, 0, 0]
    assert weights(Box((0.4, -1, -1), (2, 1, 1))) == [0, 1, 1, 0]
    assert weights(HalfSpace((0, 1, 0), (0, 5, 0))) == [0, 0, 0, 1]
    assert weights(NearPoints(POINTS[2:], 0.1)) == [0, 0, 1, 1]


def test_regions_combine():
    left, right = Ball((0, 0, 0), 0.6), Box((0.4, -1, -1), (2, 1, 1))
    assert weights(left & right) == [0, 1, 0, 0]
    assert weights(left | right) == [1, 1, 1, 0]
    assert weights(~left) == [0, 0, 1, 1]


def test_falloff_sinks_smoothly_to_zero():
    line = torch.stack([torch.linspace(0, 2, 201), torch.zeros(201), torch.zeros(201)], dim=1).double()
    w = Ball((0, 0, 0), 0.5, falloff=1.0)(line)
    assert (w[:51] == 1).all()
    assert (w[150:] == 0).all()
    assert (w.diff() <= 0).all()
    assert float(w[100]) == pytest.approx(0.5)
    assert float(w.diff().diff().abs().max()) < 1e-3


@pytest.mark.parametrize(
    "make",
    [lambda: Ball((0, 0, 0), 0), lambda: HalfSpace((0, 0, 0), (0, 0, 0)), lambda: NearPoints(POINTS[:0], 1.0)],
)
def test_empty_regions_are_refused(make):
    with pytest.raises(ValueError, match="needs"):
        make()


def test_a_box_inside_out_is_refused():
    with pytest.raises(ValueError, match="lower < upper"):
        Box((1, 0, 0), (0, 1, 1))


def test_falloff_stays_between_zero_and_one_in_single_precision():
    points = torch.linspace(0, 1.2, 20_001)[:, None] * torch.tensor([1.0, 0, 0])
    weights = Handle(Ball((0, 0, 0), 0.2, falloff=0.3), Along(0.1)).weights(points)
    assert 0 <= float(weights.min()) <= float(weights.max()) <= 1


@pytest.mark.parametrize(
    ("region", "words"),
    [
        (Ball((0.5, 0, 0), 0.25), "Ball(center=(0.5, 0, 0), radius=0.25)"),
        (Ball(torch.tensor([0.1, 0, 0]), 1, falloff=0.5), "Ball(center=(0.1, 0, 0), radius=1, falloff=0.5)"),
        (Box((0, 0), (1, 2)), "Box(lower=(0, 0), upper=(1, 2))"),
        (HalfSpace((0, 0, 0), (0, 0, 1)), "HalfSpace(point=(0, 0, 0), normal=(0, 0, 1))"),
        (NearPoints(torch.zeros(500, 3), 0.1), "NearPoints(centers=<500 x 3 numbers>, radius=0.1)"),
        (NearPoints([[0, 0, 1]], 0.1), "NearPoints(centers=((0, 0, 1),), radius=0.1)"),
        (~Ball((0, 0), 1) & Box((0, 0), (1, 1)), "(~Ball(center=(0, 0), radius=1) & Box(lower=(0, 0), upper=(1, 1)))"),
        (Ball((0, 0), 1) | weights, "(Ball(center=(0, 0), radius=1) | weights)"),
    ],
)
def test_a_region_is_printed_in_one_line(region, words):
    assert repr(region) == words


def test_picked_vertices_hold_what_is_nearest_to_them():
    line = torch.tensor([[0.2, 0, 0], [0.3, 0, 0], [0.8, 5, 0], [0.7, 0, 0]], dtype=torch.float64)
    for picked in ([1, 2], torch.tensor([2, 1]), [False, True, True, False]):
        assert PickedVertices(POINTS, picked)(line).tolist() == [0, 1, 0, 1]
    assert weights(PickedVertices(POINTS, [0, 3])) == [1, 0, 0, 1]


@pytest.mark.parametrize("picked", [[4], [-1], [0.5], [True, False], "all", [[0]]])
def test_vertices_that_are_not_there_are_refused(picked):
    with pytest.raises(ValueError, match="picked of PickedVertices must be numbers of vertices from 0 to 3"):
        PickedVertices(POINTS, picked)


def test_no_picked_vertices_are_refused():
    with pytest.raises(ValueError, match="at least one picked vertex"):
        PickedVertices(POINTS, torch.zeros(0, dtype=torch.long))
    with pytest.raises(ValueError, match="dimensions of the points, 2"):
        PickedVertices(POINTS, [0])(POINTS[:, :2])
