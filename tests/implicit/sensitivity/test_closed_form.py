"""The closed form of networks of every structure against torch.func."""

import sys
from pathlib import Path

import pytest
import torch
from torch import nn
from torch.func import grad, vmap

from implicit import Field, Siren, decoder_field
from implicit.models import Mlp
from implicit.sensitivity.boundary_sensitivity import (
    parameter_gradient,
    parameter_gradient_and_slope,
    value_and_gradients,
)
from implicit.sensitivity.closed_form import factors, gradient, gradient_and_slope, gram, has_closed_form
from implicit.sensitivity.moved_as_a_whole import moved_as_a_whole
from implicit.sensitivity.row_factors import GRAM_ROWS

sys.path.insert(0, str(Path(__file__).parents[1]))
from foreign import ARCHITECTURES, GENERAL, ImplicitGeometricRegularisation, chain, make

pytestmark = pytest.mark.filterwarnings("ignore:.*weight_norm.*:FutureWarning")

READ = [name for name in ARCHITECTURES if name not in GENERAL]


def own():
    generator = torch.Generator().manual_seed(0)
    yield Field(Siren(width=7, depth=3, generator=generator).double(), level=0.1, inside="positive")
    yield Field(Siren(2, width=5, depth=1, generator=generator).double(), bounds=((-1, -1), (1, 1)))
    yield Field(Mlp(width=6, depth=2, sharpness=5.0, generator=generator).double())
    yield Field(Mlp(width=6, depth=4, activation="relu", generator=generator).double())


OWN = ["own-siren", "own-siren-2d", "own-softplus", "own-relu"]


def field_of(name):
    return list(own())[OWN.index(name)] if name in OWN else Field(make(name), level=0.1, inside="positive")


def points_of(field, n=9):
    generator = torch.Generator().manual_seed(1)
    return 1.6 * torch.rand(n, field.dimension, generator=generator, dtype=torch.float64) - 0.8


def rows_by_torch(field, points):
    def value(theta, point):
        return field.function(theta, point[None])[0]

    return vmap(grad(value), in_dims=(None, 0))(field.theta, points)


def slopes_by_torch(field, points):
    """(N, D, P), by reverse passes one after the other, which every operator has."""
    theta = field.theta.clone().requires_grad_()
    result = []
    for point in points:
        x = point[None].clone().requires_grad_()
        (slope,) = torch.autograd.grad(field.function(theta, x).sum(), x, create_graph=True)
        lines = [
            torch.autograd.grad(s, theta, retain_graph=True, allow_unused=True)[0] if s.requires_grad else None
            for s in slope[0]
        ]
        result.append(torch.stack([torch.zeros_like(theta) if line is None else line for line in lines]))
    return torch.stack(result).detach()


def close(found, expected):
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9 * float(expected.abs().max()))


@pytest.mark.parametrize("name", [*OWN, *READ])
def test_closed_form_is_what_automatic_differentiation_gives(name):
    field = field_of(name)
    points = points_of(field)
    assert has_closed_form(field, in_space=True)
    expected = torch.cat([rows_by_torch(field, points)[:, None], slopes_by_torch(field, points)], dim=1)
    close(gradient(field, points), expected[:, 0])
    close(gradient_and_slope(field, points), expected)


@pytest.mark.parametrize("name", OWN)
def test_one_pass_gives_value_and_both_gradients(name):
    field = field_of(name)
    points = points_of(field)
    values, gradients, rows = value_and_gradients(field, points)
    expected = field.value_and_gradient(points)
    torch.testing.assert_close(values, expected[0], rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(gradients, expected[1], rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(rows, rows_by_torch(field, points), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("name", [*OWN, *READ])
def test_products_of_factors_are_those_of_the_rows(name):
    field = field_of(name)
    points = points_of(field)
    generator = torch.Generator().manual_seed(2)
    combinations = torch.randn(9, 2, 1 + field.dimension, generator=generator, dtype=torch.float64)
    kept = factors(field, points, combinations)
    rows = torch.cat([rows_by_torch(field, points)[:, None], slopes_by_torch(field, points)], dim=1)
    rows = (combinations @ rows).flatten(0, 1)
    change = torch.randn(len(field.theta), generator=generator, dtype=torch.float64)
    weights = torch.randn(18, generator=generator, dtype=torch.float64)
    close(kept.rows(), rows)
    close(kept.gram().tril(), (rows @ rows.T).tril())
    close(kept.times(change), rows @ change)
    close(kept.transposed_times(weights), weights @ rows)
    both = kept.scaled(weights).plus(kept)
    twice = weights[:, None] * rows + rows
    close(both.gram().tril(), (twice @ twice.T).tril())


@pytest.mark.parametrize("name", [*OWN, "igr", "deepsdf", "tied"])
def test_gram_matrix_is_that_of_the_rows(name):
    field = field_of(name)
    generator = torch.Generator().manual_seed(1)
    n = GRAM_ROWS + 30  # more than one block
    points = torch.randn(n, field.dimension, generator=generator, dtype=torch.float64)
    scale = torch.rand(n, generator=generator, dtype=torch.float64)
    rows = scale[:, None] * rows_by_torch(field, points)
    close(gram(field, points, scale).tril(), (rows @ rows.T).tril())


@pytest.mark.filterwarnings("ignore:The module cannot be vectorised:RuntimeWarning")
@pytest.mark.parametrize("name", GENERAL)
def test_what_is_no_chain_of_layers_is_differentiated_all_the_same(name):
    field = Field(make(name))
    points = points_of(field, 4)
    assert not has_closed_form(field)
    theta = field.theta.clone().requires_grad_()
    expected = torch.stack([torch.autograd.grad(field.function(theta, p[None]).sum(), theta)[0] for p in points])
    close(parameter_gradient(field, points), expected)


@pytest.mark.parametrize("name", ["siren", "igr", "deepsdf", "nerf"])
def test_only_edited_parameters_count(name):
    module = make(name)
    names = [name for name, _ in module.named_parameters()][2:5]
    field = Field(module, parameters=names)
    points = points_of(field)
    assert has_closed_form(field)
    close(gradient(field, points), rows_by_torch(field, points))


def test_a_code_is_edited_alone_or_with_its_decoder():
    class Decoder(nn.Module):
        def __init__(self):
            super().__init__()
            self.network = nn.Sequential(nn.Linear(7, 8), nn.Tanh(), nn.Linear(8, 1))

        def forward(self, points, code):
            return self.network(torch.cat([points, code.expand(len(points), -1)], dim=1))

    torch.manual_seed(0)
    decoder, code = Decoder().double(), torch.randn(4, dtype=torch.float64)
    for field in (decoder_field(decoder, code), decoder_field(decoder, code, weights="*")):
        points = points_of(field)
        assert has_closed_form(field, in_space=True)
        close(gradient(field, points), rows_by_torch(field, points))
        close(gradient_and_slope(field, points)[:, 1:], slopes_by_torch(field, points))


def test_a_function_that_has_changed_is_no_longer_believed():
    state = {"frequency": 3.0}

    def decoder(points, code):
        return torch.sin(state["frequency"] * points) @ code

    field = decoder_field(decoder, torch.randn(3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    points = points_of(field)
    close(parameter_gradient(field, points), torch.sin(3.0 * points))
    state["frequency"] = 5.0
    close(parameter_gradient(field, points), torch.sin(5.0 * points))


def test_numbers_taken_out_of_the_parameters_are_not_taken_for_constants():
    class Stale(nn.Module):
        def __init__(self):
            super().__init__()
            self.network = nn.Sequential(nn.Linear(3, 6), nn.Tanh(), nn.Linear(6, 1))

        def forward(self, points):
            size = float(self.network[0].weight.detach().numpy().max())
            return self.network(points) * size

    class Values(nn.Module):
        def __init__(self):
            super().__init__()
            self.network = nn.Sequential(nn.Linear(3, 6), nn.Tanh(), nn.Linear(6, 1))

        def forward(self, points):
            return self.network(points) * torch.as_tensor(points.detach().numpy()[:, :1].copy())

    torch.manual_seed(0)
    for module in (Stale(), Values()):
        assert not has_closed_form(Field(module.double(), check=False))


def test_parameters_that_are_not_finite_for_a_while_cost_nothing_later():
    field = Field(make("siren"))
    assert has_closed_form(field)
    has_closed_form(field.with_theta(torch.full_like(field.theta, float("nan"))))
    assert has_closed_form(field.with_theta(1.1 * field.theta))


def test_a_module_of_another_dtype_is_read_anew():
    field = Field(make("random-fourier", torch.float32))
    assert has_closed_form(field)
    precise = field.to(torch.float64)
    points = points_of(precise)
    assert has_closed_form(precise)
    close(gradient(precise, points), rows_by_torch(precise, points))


def test_wide_networks_agree_in_single_precision():
    field = Field(ImplicitGeometricRegularisation(64))
    points = points_of(field).float()
    assert has_closed_form(field, in_space=True)
    expected = rows_by_torch(field, points)
    assert float((gradient(field, points) - expected).abs().max()) < 1e-4 * float(expected.abs().max())


def rotation():
    return torch.linalg.matrix_exp(torch.tensor([[0, -0.4, 0.2], [0.4, 0, -0.1], [-0.2, 0.1, 0]]).double())


@pytest.mark.parametrize("name", ["relu", "igr", "deepsdf", "gated", "selected", "convolved", "batched"])
def test_a_network_is_moved_as_a_whole_by_its_entering_layers(name):
    field, turn = Field(make(name)), rotation()
    shift = torch.tensor([0.1, -0.2, 0.05]).double()
    theta = moved_as_a_whole(field, turn, shift)
    points = points_of(field)
    close(field.with_theta(theta).value(points @ turn.T + shift), field.value(points))


@pytest.mark.parametrize("name", ["nerf", "random-fourier", "matrices", "modulated", "hyper", "dense-grid"])
def test_where_the_points_enter_otherwise_nothing_is_moved(name):
    if name == "modulated":
        assert moved_as_a_whole(Field(make(name)), rotation(), torch.zeros(3).double()) is not None
        return
    assert moved_as_a_whole(Field(make(name)), rotation(), torch.zeros(3).double()) is None


def test_layers_that_are_not_edited_do_not_move():
    field = Field(chain(6, 2, nn.Tanh).double(), parameters=["2.*"])
    assert moved_as_a_whole(field, rotation(), torch.zeros(3).double()) is None
    assert parameter_gradient_and_slope(field, points_of(field)).shape == (9, 4, len(field.theta))
