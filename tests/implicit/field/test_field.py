"""Fields: conventions, parameters, and files."""

import pytest
import torch
from torch import nn

from implicit import Field, Siren, Units, decoder_field, load_field, save_field, shapes


def small():
    return Siren(width=8, generator=torch.Generator().manual_seed(0)).double()


def test_the_default_network_is_the_papers():
    assert len(Field(Siren()).theta) == 2273


def test_inside_is_negative_for_an_occupancy():
    """Inside large, level 0.5."""

    class Ball(nn.Module):
        def __init__(self):
            super().__init__()
            self.radius = nn.Parameter(torch.tensor(0.5))

        def forward(self, x):
            return torch.sigmoid(10 * (self.radius - x.norm(dim=1)))

    field = Field(Ball(), level=0.5, inside="positive")
    assert field.value(torch.tensor([[0.1, 0, 0], [0.9, 0, 0]])).sign().tolist() == [-1, 1]
    torch.testing.assert_close(field.normal(torch.tensor([[0.5, 0.0, 0.0]])), torch.tensor([[1.0, 0.0, 0.0]]))


def test_derivatives_match_differences(any_field):
    x = torch.rand(6, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) + 0.2
    step = 1e-5
    for axis in range(3):
        way = step * torch.eye(3, dtype=torch.float64)[axis]
        slope = (any_field.value(x + way) - any_field.value(x - way)) / (2 * step)
        torch.testing.assert_close(any_field.gradient(x)[:, axis], slope, rtol=1e-6, atol=1e-8)
        bend = (any_field.gradient(x + way) - any_field.gradient(x - way)) / (2 * step)
        torch.testing.assert_close(any_field.hessian(x)[:, :, axis], bend, rtol=1e-5, atol=1e-7)


def test_editing_leaves_the_module_alone_until_written_back():
    module = small()
    before = [p.clone() for p in module.parameters()]
    field = Field(module)
    edited = field.with_theta(field.theta + 1)
    assert all(torch.equal(a, b) for a, b in zip(before, module.parameters(), strict=True))
    edited.write_back()
    assert all(torch.equal(a + 1, b) for a, b in zip(before, module.parameters(), strict=True))


def test_dropout_is_off_and_batch_norm_fixed():
    module = nn.Sequential(nn.Linear(3, 8), nn.BatchNorm1d(8), nn.Dropout(0.5), nn.Linear(8, 1))
    field = Field(module, parameters=["0.*", "3.*"])
    x = torch.randn(5, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(field.value(x), field.value(x))
    torch.testing.assert_close(field.value(x)[:1], field.value(x[:1]))
    assert module.training


def test_another_precision_still_writes_back_to_the_original():
    module = Siren(width=8)
    field = Field(module).to(torch.float64)
    assert field.value(torch.zeros(1, 3, dtype=torch.float64)).dtype == torch.float64
    field.with_theta(field.theta * 0 + 0.25).write_back()
    assert all((p == 0.25).all() and p.dtype == torch.float32 for p in module.parameters())


def test_a_latent_code_is_edited_and_written_back():
    decoder = nn.Linear(3 + 4, 1)
    latent = torch.zeros(4)
    field = decoder_field(lambda x, z: decoder(torch.cat([x, z.expand(len(x), -1)], dim=1)), latent)
    field.with_theta(field.theta + 2).write_back()
    assert latent.tolist() == [2, 2, 2, 2]


def test_a_saved_field_comes_back_with_everything(tmp_path):
    field = Field(small(), level=0.1, inside="positive", units=Units(3.0, (1.0, 2.0, 3.0)))
    save_field(field, tmp_path / "a.safetensors")
    again = load_field(tmp_path / "a.safetensors")
    x = torch.rand(9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert torch.equal(field.value(x), again.value(x))
    assert again.units == field.units
    assert again.level == 0.1
    assert again.inside == "positive"


def test_an_analytic_field_comes_back(tmp_path):
    field = shapes.torus(0.6, 0.2)
    save_field(field, tmp_path / "a.safetensors")
    x = torch.rand(9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert torch.equal(field.value(x), load_field(tmp_path / "a.safetensors").value(x))


def test_a_missing_a_torn_and_a_foreign_file_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="There is no field file"):
        load_field(tmp_path / "none.safetensors")
    path = tmp_path / "a.safetensors"
    save_field(Field(small()), path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match="not a whole safetensors file"):
        load_field(path)
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="holds no field"):
        load_field(path)


def test_a_module_that_does_not_describe_itself_cannot_be_saved(tmp_path):
    with pytest.raises(TypeError, match="describes itself"):
        save_field(Field(nn.Linear(3, 1)), tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Field(nn.ReLU()), "must have parameters to edit"),
        (lambda: Field(nn.Linear(3, 1), parameters=["x*"]), "'x\\*' matches none of weight, bias"),
        (lambda: Field(nn.Linear(3, 1), inside="out"), "inside must be"),
        (lambda: Field(nn.Linear(3, 1), bounds=((1, 1, 1), (0, 0, 0))), "bounds must be"),
    ],
)
def test_bad_arguments_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("layer", [nn.Linear(2, 1), nn.Linear(3, 2)], ids=["dimension", "outputs"])
def test_a_module_of_another_shape_is_refused(layer):
    with pytest.raises(TypeError, match="values"):
        Field(layer)


def test_parameters_that_are_not_finite_are_refused():
    layer = nn.Linear(3, 1)
    with torch.no_grad():
        layer.weight[0, 0] = float("nan")
    with pytest.raises(ValueError, match="NaN or infinite"):
        Field(layer)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (torch.zeros(3), "must have shape"),
        (torch.zeros(2, 2), "must have shape"),
        (torch.tensor([[0.0, float("inf"), 0.0]]), "points\\[0\\] is not finite"),
    ],
)
def test_bad_points_are_refused(points, message):
    with pytest.raises(ValueError, match=message):
        Field(nn.Linear(3, 1)).value(points)
