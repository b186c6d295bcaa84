"""Training of modules that someone brings, and of fields from where they are."""

import pytest
import torch
from torch import nn

from implicit import Field, Siren, decoder_field, fit_field, shapes
from implicit.fitting.fit import FitStatus
from tests.implicit.fitting.test_fit import StopError, mean_distance, samples

TORUS = shapes.torus()
SPHERE = shapes.sphere(0.5)


def encoded():
    torch.manual_seed(0)

    class Encoded(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = nn.Sequential(nn.Linear(15, 32), nn.Softplus(100), nn.Linear(32, 32), nn.ELU(), nn.Linear(32, 1))

        def forward(self, x):
            return self.net(torch.cat([x] + [wave(2**k * x) for k in range(2) for wave in (torch.sin, torch.cos)], 1))

    return Encoded()


class Ball(nn.Module):
    """|x - center| - radius: what fits a sphere is known."""

    def __init__(self):
        super().__init__()
        self.center, self.radius = nn.Parameter(torch.zeros(3)), nn.Parameter(torch.tensor(0.3))

    def forward(self, x):
        return (x - self.center).norm(dim=1) - self.radius


def state_of(module):
    return {name: tensor.clone() for name, tensor in module.state_dict().items()}


def test_a_module_of_ones_own_is_fitted_and_left_alone_until_it_is_written_back():
    module = encoded()
    before = state_of(module)
    field, training = fit_field(*samples(TORUS), module=module, steps=300)
    assert mean_distance(field, TORUS) < 5e-3
    assert training.status is FitStatus.DONE
    assert training.history[-1].loss < training.history[0].loss / 10
    assert all(torch.equal(before[name], tensor) for name, tensor in module.state_dict().items())
    assert all(parameter.grad is None for parameter in module.parameters())
    field.write_back()
    x = torch.rand(9, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(module(x)[:, 0], field.value(x))


def test_a_ball_finds_its_center_and_radius_in_the_users_own_coordinates():
    """All its parameters go by Adam, and its bounds are far from [-1, 1]."""
    points, distances, normals = samples(SPHERE, 4000)
    middle = torch.tensor([3.0, -2.0, 1.0], dtype=torch.float64)
    module = Ball().double()
    with torch.no_grad():
        module.center.copy_(middle + 0.3)
        module.radius.fill_(1.0)
    bounds = ((middle - 4).tolist(), (middle + 4).tolist())
    field, _ = fit_field(
        4 * points + middle, 4 * distances, normals, module=module, bounds=bounds, steps=400, learning_rate=2e-2
    )
    assert field.dtype == torch.float64
    torch.testing.assert_close(field.theta[:3], middle, rtol=0, atol=1e-3)
    torch.testing.assert_close(field.theta[3], torch.tensor(2.0, dtype=torch.float64), rtol=0, atol=1e-3)


def test_only_parameters_that_require_gradients_are_trained():
    module = Ball()
    module.center.requires_grad_(False)
    field, _ = fit_field(*samples(SPHERE, 2000), module=module, steps=200, learning_rate=2e-2)
    assert [block.name for block in field.layout] == ["radius"]
    assert float(field.theta) == pytest.approx(0.5, abs=1e-3)


def test_a_fit_goes_on_from_a_field():
    first, short = fit_field(*samples(TORUS), width=16, steps=100)
    again, longer = fit_field(*samples(TORUS), start=first, steps=100, learning_rate=2e-3)
    assert longer.value_error < short.value_error
    assert longer.history[0].loss < short.history[0].loss / 3
    assert again.layout == first.layout


def test_a_code_is_fitted_where_the_start_has_one():
    def decoder(points, code):
        return points.norm(dim=1) - code[0].exp()

    start = decoder_field(decoder, torch.zeros(1))
    field, _ = fit_field(*samples(SPHERE, 2000), start=start, steps=300, learning_rate=5e-2)
    assert field.takes_code
    assert float(field.theta.exp()) == pytest.approx(0.5, abs=1e-3)


def test_a_start_with_a_level_and_a_side_is_fitted_as_it_counts_them():
    class Occupancy(Ball):
        def forward(self, x):
            return torch.sigmoid(-4 * super().forward(x))

    start = Field(Occupancy(), level=0.5, inside="positive")
    field, _ = fit_field(*samples(SPHERE, 2000), start=start, steps=200, learning_rate=2e-2)
    assert float(field.theta[3]) == pytest.approx(0.5, abs=0.02)


def test_linear_layers_of_another_module_move_as_those_of_our_own():
    """The rotated method runs on them: the same network by another class takes the same course."""

    class Plain(nn.Module):
        def __init__(self, siren):
            super().__init__()
            self.first, self.middle, self.last = siren.layers
            self.frequencies = siren.first_frequency, siren.frequency

        def forward(self, x):
            h = torch.sin(self.frequencies[0] * self.first(x))
            return self.last(torch.sin(self.frequencies[1] * self.middle(h)))

    data, options = samples(TORUS, 2000), {"steps": 30, "learning_rate": 1e-2, "dtype": torch.float64}

    def start():
        return Siren(3, 8, 2, generator=torch.Generator().manual_seed(0))

    ours, _ = fit_field(*data, module=start(), **options)
    theirs, _ = fit_field(*data, module=Plain(start()), **options)
    adam, _ = fit_field(*data, module=Plain(start()), **options, method="adam")
    torch.testing.assert_close(ours.theta, theirs.theta)
    assert not torch.allclose(ours.theta, adam.theta, rtol=1e-2)


@pytest.mark.parametrize("method", ["soap", "adam"])
def test_an_interrupted_fit_of_a_module_goes_on_and_ends_with_the_same_bits(method, tmp_path):
    data, options = samples(TORUS, 2000), {"steps": 40, "batch": 256, "method": method}
    whole, _ = fit_field(*data, module=encoded(), **options)

    def interrupt(step, steps, loss):
        if step == 21:
            raise StopError

    path = tmp_path / "training.safetensors"
    with pytest.raises(StopError):
        fit_field(*data, module=encoded(), **options, checkpoint=path, progress=interrupt)
    resumed, _ = fit_field(*data, module=encoded(), **options, checkpoint=path)
    assert torch.equal(whole.theta, resumed.theta)
    other = encoded()
    nn.init.zeros_(other.net[0].bias)
    with pytest.raises(ValueError, match="belongs to another fit"):
        fit_field(*data, module=other, **options, checkpoint=path)


class Detached(Ball):
    def forward(self, x):
        return super().forward(x.detach())


class OnlyOnce(Ball):
    """Differentiable once: the gradient in the points has no derivative."""

    def forward(self, x):
        return _Once.apply(x - self.center) - self.radius


class _Once(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.norm(dim=1)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad):
        (x,) = ctx.saved_tensors
        return grad[:, None] * x / x.norm(dim=1, keepdim=True)


class Idle(nn.Module):
    def __init__(self):
        super().__init__()
        self.spare = nn.Parameter(torch.ones(2))

    def forward(self, x):
        return x.norm(dim=1) - 0.5


def frozen():
    return Ball().requires_grad_(False)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"module": lambda: nn.Linear(2, 1)}, TypeError, r"must map points \(N, 3\)"),
        ({"module": lambda: nn.Linear(3, 4)}, TypeError, "output=0 or output=1"),
        ({"module": lambda: "my_nets.py:make"}, TypeError, "module must be a torch module to train"),
        ({"module": frozen}, ValueError, "module has nothing to train: all parameters of the Ball are frozen"),
        ({"module": Detached}, TypeError, "Remove detach"),
        ({"module": OnlyOnce}, ValueError, "differentiable twice"),
        ({"module": Idle}, TypeError, "depend on none of them"),
        ({"module": Ball, "start": lambda: SPHERE}, ValueError, "module or start, but not both"),
        ({"module": Ball, "width": lambda: 64}, ValueError, "width must be left out where module brings the network"),
        (
            {"start": lambda: SPHERE, "activation": lambda: "relu"},
            ValueError,
            "activation must be left out where",
        ),
        ({"start": Ball}, TypeError, "start must be a Field"),
        ({"start": lambda: shapes.circle(0.5)}, ValueError, "start must have 3 coordinates like the points, but has 2"),
        (
            {"start": lambda: SPHERE, "bounds": lambda: ((-1,) * 3, (1,) * 3)},
            ValueError,
            "bounds are those of the start",
        ),
    ],
)
def test_what_cannot_be_trained_is_refused_before_work(options, error, message):
    steps = []
    given = {name: make() for name, make in options.items()}
    with pytest.raises(error, match=message):
        fit_field(*samples(SPHERE, 500), **given, steps=2, progress=lambda *row: steps.append(row))
    assert not steps
