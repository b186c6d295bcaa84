"""Bracketed zeros against Brent's method of scipy, and jumps told from zeros."""

import math

import pytest
import torch
from scipy.optimize import brentq
from torch import Tensor, nn

from implicit import Field
from implicit.surface.bracketing import bracketed_zeros


class AlongX(nn.Module):
    """A function of the first coordinate alone, which counts the points that it is asked for."""

    def __init__(self, function) -> None:
        super().__init__()
        self.shift = nn.Parameter(torch.zeros(1, dtype=torch.float64))
        self.function = function

    def forward(self, points: Tensor) -> Tensor:
        return self.function(points[:, 0]) + 0 * self.shift


FUNCTIONS = {
    "line": lambda x: 3 * x - 1,
    "kink": lambda x: torch.where(x < 0.21, 1e-3 * (x - 0.2), 1e-5 + 1e3 * (x - 0.21)),
    "cube": lambda x: (x - 0.3) ** 3,
    "root": lambda x: torch.sign(x - 0.3) * (x - 0.3).abs().sqrt(),
    "saturated": lambda x: torch.tanh(2000 * (x - 0.123)),
    "flat, then steep": lambda x: torch.relu(x - 0.7) * 50 - 1e-6 + 1e-9 * x,
    "exponential": lambda x: torch.exp(8 * x) - 2,
    "downward": lambda x: 0.4 - x,
}


def zeros_of(function, low, high, tolerance=1e-12):
    field = Field(AlongX(function), check=False)
    start, end = (torch.tensor([[x, 0.1, -0.2]], dtype=torch.float64) for x in (low, high))
    return bracketed_zeros(field, start, end, field.value(start), field.value(end), tolerance)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_zero_is_that_of_brents_method(name):
    function = FUNCTIONS[name]
    found = zeros_of(function, -0.9, 1.0)
    exact = brentq(lambda x: float(function(torch.tensor(x, dtype=torch.float64))), -0.9, 1.0, xtol=1e-14, maxiter=1000)
    assert float(found.points[0, 0]) == pytest.approx(exact, abs=2e-12 if name != "cube" else 1e-8)
    assert found.points[0, 1:].tolist() == pytest.approx([0.1, -0.2], abs=1e-15)
    assert not bool(found.jumps.any())


@pytest.mark.parametrize("size", [1.0, 0.5, 0.1])
def test_a_jump_over_zero_is_no_zero(size):
    """x - 0.3 with a step that is nearly all of the change, or two thirds, or a fifth of it."""
    found = zeros_of(lambda x: size * torch.sign(x - math.pi / 10) + 0.2 * (x - math.pi / 10), -0.5, 1.0)
    assert bool(found.jumps.all())
    assert float(found.points[0, 0]) == pytest.approx(math.pi / 10, abs=1e-12)


def test_segments_are_narrowed_each_by_itself():
    """A thousand brackets about the zeros of a sine, in both directions."""
    generator = torch.Generator().manual_seed(0)
    zeros = torch.randint(-3, 4, (1000,), generator=generator).double() * 0.25
    low, high = (zeros + s * (0.01 + 0.2 * torch.rand(1000, generator=generator).double()) for s in (-1, 1))
    field = Field(AlongX(lambda x: torch.sin(4 * math.pi * x)))
    start, end = (torch.stack([x, 0 * x, 0 * x], dim=1) for x in (low, high))
    found = bracketed_zeros(field, start, end, field.value(start), field.value(end), 1e-13)
    torch.testing.assert_close(found.points[:, 0], zeros, rtol=0, atol=2e-13)


def test_a_smooth_zero_takes_few_evaluations():
    """Superlinear: bisection alone would need 41 from a bracket of 1.9 to 1e-12."""
    asked = []

    def function(x):
        asked.append(len(x))
        return torch.exp(x) - 1.3

    zeros_of(function, -0.9, 1.0)
    assert len(asked) - 3 <= 12  # less the probe of the constructor and both ends


def test_no_function_takes_more_than_three_bisections():
    for function in FUNCTIONS.values():
        asked = []

        def counted(x, function=function, asked=asked):
            asked.append(len(x))
            return function(x)

        zeros_of(counted, -0.9, 1.0)
        assert len(asked) < 3 * math.log2(1.9 / 1e-12)
