"""Single basis functions against the whole basis and against shapes known in closed form."""

import pytest
import torch

from implicit import basis, basis_function, one_weight_per_layer, sample_surface, shapes
from implicit.shapes import bundled


def test_the_radius_of_a_sphere_moves_every_point_by_one():
    field = shapes.sphere(radius=0.5)
    points = sample_surface(field, 50).points
    torch.testing.assert_close(basis_function(field, "radius")(points), torch.ones_like(points[:, 0]))


def test_a_coordinate_of_the_centre_moves_points_by_their_normal():
    field = shapes.sphere(radius=0.5)
    sample = sample_surface(field, 50)
    torch.testing.assert_close(basis_function(field, "center[1]")(sample.points), sample.normals[:, 1])


def test_a_named_weight_is_the_column_of_the_basis_and_keeps_its_name(spot):
    points = sample_surface(spot, 20).points
    whole = basis(spot, points)
    for index in (0, 95, 500, len(spot.theta) - 1):
        function = basis_function(spot, index)
        torch.testing.assert_close(function(points), whole[:, index])
        assert basis_function(spot, function.name).index == index


def test_one_weight_per_layer_goes_from_the_first_layer_to_the_last():
    field = bundled("spot")
    chosen = one_weight_per_layer(field)
    weights = [block.where for block in field.layout if len(block.shape) == 2]
    assert len(chosen) == len(weights) == 4
    assert all(w.start <= c.index < w.stop for c, w in zip(chosen, weights, strict=True))


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        (-1, "at least 0"),
        ("centre", "There is no parameter"),
        ("center[7]", "must fit the shape \\(3,\\)"),
        ("center", "pl"),
    ],
)
def test_an_unknown_parameter_is_refused(parameter, message):
    with pytest.raises(ValueError, match=message):
        basis_function(shapes.sphere(), parameter)
