"""A field follows its surface to where it is to be, whatever its module, with a distance or its own values about it."""

import numpy as np
import pytest
import torch
from torch import nn

from implicit import Field, extract_mesh, follow_surface, shapes
from implicit.surface.projection import newton_to_surface


def bent(points, angle=1.0):
    """Return points where a bend takes them whose axis becomes an arc of this angle, 1.3 long."""
    radius = 1.3 / angle
    turn = points[:, 1] / radius
    out = radius - points[:, 0]
    return np.stack([radius - out * np.cos(turn), out * np.sin(turn), points[:, 2]], axis=1)


@pytest.fixture(scope="module")
def followed(rod):
    V, F = extract_mesh(rod, 24)
    return V, F, *follow_surface(rod, V, F, bent(V), samples=2000, steps=150, batch=512)


def test_the_surface_is_where_the_positions_are(rod, followed):
    V, _, field, following = followed
    goals = torch.from_numpy(bent(V)).float()
    found, arrived = newton_to_surface(field, goals, reach=0.1)
    assert bool(arrived.all())
    apart = (found - goals).norm(dim=1)
    assert float(apart.square().mean().sqrt()) < 0.004
    assert following.miss_rms == pytest.approx(float(apart.square().mean().sqrt()), rel=0.5)
    assert following.lost == 0
    assert following.steps == 150
    assert float(rod.value(goals).abs().max()) > 0.05  # it was elsewhere


def test_a_distance_stays_one(followed):
    V, _, field, following = followed
    assert following.values == "distance"
    points = torch.from_numpy(bent(V)).float()
    normals = field.normal(points)
    for off in (-0.05, 0.05):
        assert float((field.value(points + off * normals) - off).abs().mean()) < 0.01


def test_the_field_given_stays_as_it_is(rod):
    V, F = extract_mesh(rod, 16)
    before = rod.theta.clone()
    follow_surface(rod, V, F, V + 0.05, samples=500, steps=3, batch=64)
    torch.testing.assert_close(rod.theta, before, rtol=0, atol=0)


class Saturated(nn.Module):
    """tanh(8 f): steep on the surface, flat off it."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        return torch.tanh(8 * self.network(points))


def test_what_is_no_distance_takes_its_own_values_along(rod):
    field = Field(Saturated(rod.module))
    V, F = extract_mesh(field, 24)
    found, following = follow_surface(field, V, F, bent(V, 0.6), samples=2000, steps=150, batch=512)
    assert following.values == "carried"
    assert following.miss_rms < 0.006
    points = torch.from_numpy(bent(V, 0.6)).float()
    own, there = torch.from_numpy(V).float(), field.normal(torch.from_numpy(V).float())
    normals = found.normal(points)
    for off in (-0.08, 0.08):
        was, now = field.value(own + off * there), found.value(points + off * normals)
        assert float((now - was).abs().mean()) < 0.08
        assert abs(float(was.mean())) > 0.4


def test_any_module_follows(wobbly):
    """One whose points enter no linear layer first: a sphere plus a network, shifted by a fifth of its radius."""
    field = wobbly.to(torch.float32)
    V, F = extract_mesh(field, 16)
    goals = V + np.array([0.1, 0.0, 0.0])
    _, following = follow_surface(field, V, F, goals, samples=1000, steps=120, batch=256)
    assert following.miss_rms < 0.2 * 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((3, 3))}, "positions must be finite numbers of shape"),
        ({"positions": np.full((100, 3), np.nan)}, "positions must be finite numbers"),
        ({"faces": np.array([[0, 1, 1000]])}, "faces must be triangles"),
        ({"vertices": np.zeros((100, 2))}, "vertices must be finite positions"),
        ({"values": "own"}, "values must be"),
        ({"steps": 0}, "steps must be"),
        ({"rotations": np.zeros((100, 3))}, "rotations must be finite numbers"),
    ],
)
def test_bad_input_is_refused(rod, change, message):
    V, F = extract_mesh(rod, 16)
    given = {"vertices": V, "faces": F, "positions": V, **change}
    with pytest.raises(ValueError, match=message):
        follow_surface(rod, **given)


def test_a_curve_is_refused():
    with pytest.raises(ValueError, match="3 dimensions"):
        follow_surface(shapes.circle(0.5), np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((3, 3)))
