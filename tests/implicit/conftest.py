"""Fields whose surface is known, or at least simple, for the tests of every module."""

import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from implicit import Field, HalfSpace, Handle, RigidMotion, Siren, fit_field
from implicit.shapes import bundled, capsule


class Wobbly(nn.Module):
    """A sphere of radius 0.5 with a small sine network on top: every parameter moves the surface."""

    def __init__(self, network: nn.Module, amount: float = 0.1) -> None:
        super().__init__()
        self.network = network
        self.amount = amount

    def forward(self, points: Tensor) -> Tensor:
        return points.norm(dim=1) - 0.5 + self.amount * self.network(points).reshape(-1)


class Planes(nn.Module):
    """max of n_k . x - h_k, a polytope whose every face has parameters of its own: piecewise linear, as of ReLU."""

    def __init__(self, normals: Tensor, offsets: Tensor) -> None:
        super().__init__()
        self.normals, self.offsets = nn.Parameter(normals), nn.Parameter(offsets)

    def forward(self, points: Tensor) -> Tensor:
        return (points @ self.normals.T - self.offsets).amax(dim=1)


def round_polytope(count: int, dimension: int = 3, radius: float = 0.5) -> Planes:
    """Planes that touch a ball in a spiral of points, or lines that touch a circle."""
    k = torch.arange(count, dtype=torch.float64) + 0.5
    if dimension == 2:
        angle = 2 * math.pi * k / count
        normals = torch.stack([angle.cos(), angle.sin()], dim=1)
    else:
        z, angle = 1 - 2 * k / count, math.pi * (1 + 5**0.5) * k
        ring = (1 - z.square()).sqrt()
        normals = torch.stack([ring * angle.cos(), ring * angle.sin(), z], dim=1)
    return Planes(normals, torch.full((count,), radius, dtype=torch.float64))


class Placed(nn.Module):
    """Another field scaled about the origin and shifted: how any functional changes with both is known."""

    def __init__(self, other: nn.Module, dimension: int = 3) -> None:
        super().__init__()
        self.other = other
        self.scale = nn.Parameter(torch.ones((), dtype=torch.float64))
        self.shift = nn.Parameter(torch.zeros(dimension, dtype=torch.float64))

    def forward(self, points: Tensor) -> Tensor:
        return self.other((points - self.shift) / self.scale).reshape(-1)


def relu_network(distance: Callable[[Tensor], Tensor], steps: int = 300) -> nn.Module:
    """A ReLU network of 2 x 32 trained for seconds to a distance."""
    generator = torch.Generator().manual_seed(0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = nn.Sequential(nn.Linear(3, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, 1)).double()
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = 1e-2 * (1 - step / steps)
        points = 2 * torch.rand(2000, 3, generator=generator, dtype=torch.float64) - 1
        exact = distance(points)
        loss = ((network(points)[:, 0] - exact) / (exact.abs() + 0.1)).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return network


class Occupancy(nn.Module):
    """One minus a sigmoid of another field's distance: 1 deep inside, 0 far outside, 0.5 on the surface."""

    def __init__(self, distance: nn.Module) -> None:
        super().__init__()
        self.distance = distance

    def forward(self, points: Tensor) -> Tensor:
        return torch.sigmoid(-8 * self.distance(points))


def seeded_siren(width: int = 32) -> Siren:
    return Siren(width=width, generator=torch.Generator().manual_seed(0)).double()


def siren_field() -> Field:
    """The paper's network, P = 2273, on a wobbly sphere."""
    return Field(Wobbly(seeded_siren()))


def weight_norm_field() -> Field:
    """Layers under weight norm: parameters that are no weights."""
    generator = torch.Generator().manual_seed(1)
    layers = [nn.Linear(3, 16), nn.Linear(16, 16), nn.Linear(16, 1)]
    for layer in layers:
        for parameter in layer.parameters():
            nn.init.normal_(parameter, std=0.4, generator=generator)
    wrapped = [nn.utils.parametrizations.weight_norm(layer) for layer in layers]
    network = nn.Sequential(wrapped[0], nn.Tanh(), wrapped[1], nn.Tanh(), wrapped[2]).double()
    return Field(Wobbly(network, 0.05))


def occupancy_field() -> Field:
    """Level 0.5, large inside."""
    return Field(Occupancy(Wobbly(seeded_siren())), level=0.5, inside="positive")


@pytest.fixture(params=[siren_field, weight_norm_field, occupancy_field], ids=["siren", "weight-norm", "occupancy"])
def any_field(request: pytest.FixtureRequest) -> Field:
    return request.param()


@pytest.fixture
def wobbly() -> Field:
    """A narrower network, P = 625, for what does not depend on the width."""
    return Field(Wobbly(seeded_siren(16)))


@pytest.fixture(scope="session")
def spot() -> Field:
    """A real shape in the paper's network, in float64."""
    return bundled("spot").to(torch.float64)


@pytest.fixture
def polytope() -> Callable[..., Field]:
    """Field of a polytope about a ball or a circle, of so many faces."""

    def make(count: int, dimension: int = 3) -> Field:
        bounds = ((-1.0,) * dimension, (1.0,) * dimension)
        return Field(round_polytope(count, dimension), bounds=bounds)

    return make


@pytest.fixture
def placed_polytope() -> Field:
    """A polytope whose parameters scale and shift it."""
    return Field(Placed(round_polytope(200)), parameters=["scale", "shift"])


@pytest.fixture(scope="session")
def relu_torus() -> Field:
    """A ReLU network trained to a torus of radii 0.55 and 0.25, all of its parameters free."""

    def distance(points: Tensor) -> Tensor:
        return ((points[:, :2].norm(dim=1) - 0.55).square() + points[:, 2].square()).sqrt() - 0.25

    return Field(relu_network(distance))


# The ends of the rod, and the motion of the upper one by which its axis between them, 0.8 long, becomes an arc of so
# many radians.
FOOT = Handle(HalfSpace((0, -0.4, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
TIP = HalfSpace((0, 0.4, 0), (0, 1, 0))
ANGLE = math.pi / 4
RADIUS = 0.8 / ANGLE
ARRIVED = (RADIUS * (1 - math.cos(ANGLE)), RADIUS * math.sin(ANGLE) - 0.8, 0.0)
BEND = RigidMotion(rotation=(0, 0, -ANGLE), center=(0, 0.4, 0), translation=ARRIVED)


@pytest.fixture(scope="session")
def rod() -> Field:
    """A small network, P = 353, near the distance of a rod along y of radius 0.2 and length 1.3; float32."""
    generator = torch.Generator().manual_seed(0)
    exact = capsule((0, -0.45, 0), (0, 0.45, 0), 0.2, dtype=torch.float32)
    near = torch.rand(6000, 3, generator=generator) * torch.tensor([0.6, 1.4, 0.6]) - torch.tensor([0.3, 0.7, 0.3])
    points = torch.cat([near, 2 * torch.rand(3000, 3, generator=generator) - 1])
    network = Siren(width=16, depth=2, first_frequency=4.0, generator=generator)
    values, normals = exact.value_and_gradient(points)
    options: dict[str, Any] = {"steps": 200, "batch": 512, "band": 0.1, "learning_rate": 1e-2}
    return fit_field(points, values, normals, module=network, **options)[0]
