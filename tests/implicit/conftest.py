"""Fields whose surface is known, or at least simple, for the tests of every module."""

import pytest
import torch
from torch import Tensor, nn

from implicit import Field, Siren
from implicit.shapes import bundled


class Wobbly(nn.Module):
    """A sphere of radius 0.5 with a small sine network on top: every parameter moves the surface."""

    def __init__(self, network: nn.Module, amount: float = 0.1) -> None:
        super().__init__()
        self.network = network
        self.amount = amount

    def forward(self, points: Tensor) -> Tensor:
        return points.norm(dim=1) - 0.5 + self.amount * self.network(points).reshape(-1)


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
