"""Products of rows by their factors against those of the rows themselves."""

import pytest
import torch

from implicit import Field
from implicit.sensitivity.closed_form import factors
from implicit.sensitivity.row_products import row_products
from tests.implicit.foreign import ARCHITECTURES, GENERAL, make

pytestmark = pytest.mark.filterwarnings("ignore:.*weight_norm.*:FutureWarning")


@pytest.mark.parametrize("name", [name for name in ARCHITECTURES if name not in GENERAL])
def test_products_of_rows_at_two_parameters_are_those_of_the_rows(name):
    """Of df/dtheta with combinations of it and its slopes, as a basis of before a step meets rows after it."""
    field = Field(make(name), level=0.1, inside="positive")
    generator = torch.Generator().manual_seed(1)
    here, there = (1.6 * torch.rand(n, 3, generator=generator, dtype=torch.float64) - 0.8 for n in (5, 4))
    noise = torch.randn(field.theta.shape, generator=generator, dtype=torch.float64)
    moved = field.with_theta(field.theta * (1 + 0.05 * noise))
    rows = factors(field, here)
    others = factors(moved, there, torch.randn(4, 2, 4, generator=generator, dtype=torch.float64))
    expected = rows.rows() @ others.rows().T
    for found, wanted in ((row_products(rows, others), expected), (row_products(others, rows), expected.T)):
        assert float((found - wanted).abs().max()) < 1e-13 * float(expected.abs().max())
