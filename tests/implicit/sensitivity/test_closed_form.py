"""The closed form for plain networks against torch.func."""

import pytest
import torch
from torch.func import grad, jvp, vmap

from implicit import Field, Siren
from implicit.models import Mlp
from implicit.sensitivity.closed_form import GRAM_ROWS, is_plain, plain_gradient, plain_gradient_and_slope, plain_gram


def networks():
    generator = torch.Generator().manual_seed(0)
    yield Field(Siren(width=7, depth=3, generator=generator).double(), level=0.1, inside="positive")
    yield Field(Siren(2, width=5, depth=1, generator=generator).double(), bounds=((-1, -1), (1, 1)))
    yield Field(Mlp(width=6, depth=2, sharpness=5.0, generator=generator).double())
    yield Field(Mlp(width=6, depth=4, activation="relu", generator=generator).double())


@pytest.mark.parametrize("field", list(networks()), ids=["siren", "siren-2d", "softplus", "relu"])
def test_closed_form_is_what_automatic_differentiation_gives(field):
    points = torch.randn(9, field.dimension, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def value(theta, point):
        return field.function(theta, point[None])[0]

    expected = vmap(grad(value), in_dims=(None, 0))(field.theta, points)
    assert is_plain(field)
    torch.testing.assert_close(plain_gradient(field, points), expected)
    both = plain_gradient_and_slope(field, points)
    torch.testing.assert_close(both[:, 0], expected)
    for axis, direction in enumerate(torch.eye(field.dimension, dtype=torch.float64)):
        along = vmap(lambda x, e=direction: jvp(lambda y: grad(value)(field.theta, y), (x,), (e,))[1])(points)
        torch.testing.assert_close(both[:, 1 + axis], along)


@pytest.mark.parametrize("field", list(networks()), ids=["siren", "siren-2d", "softplus", "relu"])
def test_gram_matrix_is_that_of_the_rows(field):
    generator = torch.Generator().manual_seed(1)
    n = GRAM_ROWS + 30  # more than one block
    points = torch.randn(n, field.dimension, generator=generator, dtype=torch.float64)
    scale = torch.rand(n, generator=generator, dtype=torch.float64)
    rows = scale[:, None] * plain_gradient(field, points)
    torch.testing.assert_close(plain_gram(field, points, scale).tril(), (rows @ rows.T).tril())


def test_it_is_left_alone_where_only_some_parameters_are_edited():
    assert not is_plain(Field(Siren(width=5), parameters=["layers.0.*"]))
    assert not is_plain(Field(torch.nn.Linear(3, 1)))
