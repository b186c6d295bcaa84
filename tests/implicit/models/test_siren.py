"""The networks: their size, formula, start and description."""

from __future__ import annotations

import math

import pytest
import torch

from implicit import Field, load_field, save_field
from implicit.models import Mlp, Siren, build


def points(n=500, dimension=3, seed=0):
    return torch.rand(n, dimension, generator=torch.Generator().manual_seed(seed)) * 2 - 1


def test_the_default_is_the_network_of_the_paper():
    assert sum(p.numel() for p in Siren().parameters()) == 2273


def test_values_follow_the_formula():
    net = Siren(width=5, depth=2, first_frequency=7.0, frequency=3.0)
    (w0, b0), (w1, b1), (w2, b2) = ((layer.weight, layer.bias) for layer in net.layers)
    x = points()
    h = torch.sin(3.0 * (torch.sin(7.0 * (x @ w0.T + b0)) @ w1.T + b1))
    torch.testing.assert_close(net(x), (h @ w2.T + b2)[:, 0])


@pytest.mark.parametrize("width", [32, 128, 512])
@pytest.mark.parametrize("frequency", [3.0, 6.0, 30.0])
def test_arguments_of_later_sines_start_near_unit_variance(width, frequency):
    """What the start is made for (Sitzmann et al. 2020, theorem 1.8); the biases add some variance of their own."""
    net = Siren(width=width, frequency=frequency, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        h = torch.sin(net.first_frequency * net.layers[0](points(4000)))
        argument = frequency * torch.nn.functional.linear(h, net.layers[1].weight)
    assert 0.7 < float(argument.std(dim=0).mean()) < 1.3


@pytest.mark.parametrize("kind", [Siren, Mlp])
def test_the_same_generator_gives_the_same_weights_and_the_global_one_stays(kind):
    before = torch.get_rng_state()
    a, b, c = (kind(generator=torch.Generator().manual_seed(seed)) for seed in (3, 3, 4))
    assert all(torch.equal(p, q) for p, q in zip(a.parameters(), b.parameters()))
    assert not torch.equal(a.layers[0].weight, c.layers[0].weight)
    kind()
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize(
    "net",
    [
        Siren(width=8, depth=2, first_frequency=9.0, frequency=4.0),
        Siren(dimension=2, width=4, depth=1),
        Mlp(width=16, depth=2, activation="relu"),
        Mlp(dimension=2, width=16, depth=2, sharpness=20.0),
    ],
    ids=["siren", "siren-2d", "relu", "softplus-2d"],
)
def test_a_description_makes_the_network_again(net, tmp_path):
    assert build(net.describe()).describe() == net.describe()
    dimension = net.layers[0].in_features
    field = Field(net, bounds=((-1.0,) * dimension, (1.0,) * dimension))
    save_field(field, tmp_path / "net.safetensors")
    x = points(dimension=dimension)
    assert torch.equal(load_field(tmp_path / "net.safetensors").value(x), field.value(x))


@pytest.mark.parametrize("activation", ["relu", "softplus"])
def test_a_perceptron_starts_near_the_distance_to_a_sphere(activation):
    """f is close to |x| - 1/2 for wide layers (Atzmon and Lipman 2020, theorem 1)."""
    net = Mlp(width=512, depth=8, activation=activation)
    x = points(4000)
    with torch.no_grad():
        error = net(x) - (x.norm(dim=1) - 0.5)
    assert float(error.abs().mean()) < 0.15
    assert math.isfinite(float(error.abs().max()))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Siren(dimension=4), "dimension must be at least 2, at most 3"),
        (lambda: Siren(width=0), "width must be at least 1"),
        (lambda: Mlp(depth=0), "depth must be at least 1"),
        (lambda: Mlp(activation="tanh"), 'activation "softplus" or "relu"'),
        (lambda: Mlp(sharpness=0.0), "positive sharpness"),
    ],
)
def test_impossible_networks_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
