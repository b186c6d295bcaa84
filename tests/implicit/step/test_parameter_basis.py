"""Bases of parameter changes: the two forms span the same, and all maps of one agree with each other."""

import pytest
import torch

from implicit import sample_surface
from implicit.sensitivity.boundary_sensitivity import parameter_gradient, parameter_gradient_and_slope
from implicit.step import parameter_basis
from implicit.step.parameter_basis import AllParameters, Directions, PointSensitivities, spanned


@pytest.fixture
def bases(wobbly, monkeypatch):
    points = sample_surface(wobbly, 30).points
    found = []
    for many in (10_000, 0):
        monkeypatch.setattr(parameter_basis, "MANY_PARAMETERS", many)
        found.append(spanned(wobbly, points, points[:0] + 0.1, 30))
    return found


def test_both_forms_span_the_same_changes_by_orthonormal_ones(wobbly, bases):
    """So that rows at a later field have the same products with each other in both."""
    assert [type(basis) for basis in bases] == [Directions, PointSensitivities]
    later = wobbly.with_theta(1.01 * wobbly.theta)
    points = sample_surface(wobbly, 9, seed=4).points
    generator = torch.Generator().manual_seed(3)
    combinations = torch.randn(9, 2, 4, generator=generator, dtype=torch.float64)
    for options in ((), (combinations,)):
        products = []
        for basis in bases:
            rows = basis.rows(later, points, *options).flatten(0, -2)
            products.append(rows @ rows.T)
        torch.testing.assert_close(*products, rtol=1e-6, atol=1e-9 * float(products[0].abs().max()))


def test_rows_and_changes_of_a_basis_agree(wobbly, bases):
    points = sample_surface(wobbly, 7, seed=5).points
    generator = torch.Generator().manual_seed(6)
    combinations = torch.randn(7, 2, 4, generator=generator, dtype=torch.float64)
    gradient = torch.randn(wobbly.theta.shape, generator=generator, dtype=torch.float64)
    for basis in [*bases, AllParameters(wobbly)]:
        c = torch.randn(basis.count, generator=generator, dtype=torch.float64)
        change = basis.change(c)
        torch.testing.assert_close(basis.rows(wobbly, points) @ c, parameter_gradient(wobbly, points) @ change)
        combined = combinations @ parameter_gradient_and_slope(wobbly, points) @ change
        torch.testing.assert_close(basis.rows(wobbly, points, combinations) @ c, combined)
        torch.testing.assert_close(basis.transposed(gradient) @ c, gradient @ change)
        if basis.count < len(wobbly.theta):
            torch.testing.assert_close(change.norm(), c.norm())
