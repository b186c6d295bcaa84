"""Files of fields: shared tensors, modules of the user's own, and code that is run only where it is named."""

import json
import sys

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import nn

from implicit import Field, Siren, Units, decoder_field, load_field, save_field
from implicit.models import register
from implicit.models.field_file import builder_of

NETS = '''
from pathlib import Path
Path(__file__).with_name("was-run").touch()
import torch
from torch import nn

class Tied(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.first, self.middle = nn.Linear(3, width), nn.Linear(width, width)
        self.again, self.last = nn.Linear(width, width), nn.Linear(width, 1)
        self.again.weight = self.middle.weight

    def forward(self, x):
        for layer in (self.first, self.middle, self.again):
            x = torch.tanh(layer(x))
        return self.last(x)

def tied(width=8):
    torch.manual_seed(1)
    return Tied(width)

def normed():
    torch.manual_seed(2)
    return nn.Sequential(nn.utils.weight_norm(nn.Linear(3, 8)), nn.Softplus(), nn.BatchNorm1d(8), nn.Linear(8, 1))

def grown():
    torch.manual_seed(3)
    return nn.Sequential(nn.utils.parametrizations.weight_norm(nn.Linear(3, 8)), nn.ELU(), nn.Linear(8, 1))

class Decoder(nn.Module):
    def __init__(self):
        super().__init__()
        self.layer = nn.Linear(5, 1)

    def forward(self, points, code):
        return self.layer(torch.cat([points, code.expand(len(points), -1)], dim=1))

class Loose(nn.Linear):
    """Adds a tensor that is no buffer."""
    def __init__(self):
        super().__init__(3, 1)
        self.loose = torch.rand(1)

    def forward(self, x):
        return super().forward(x) + self.loose

def number():
    return 3
'''

# Published networks have the older weight norm, of which torch warns.
pytestmark = pytest.mark.filterwarnings("ignore:.*weight_norm:FutureWarning")


@pytest.fixture
def nets(tmp_path, monkeypatch):
    """The path of a file of networks, and a way to import it as the test's own."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "nets.py").write_text(NETS)
    return folder / "nets.py"


def made(nets, name, *arguments):
    namespace = {"__file__": str(nets), "__name__": "made"}
    exec(nets.read_text(), namespace)  # the text above
    module = namespace[name](*arguments)
    (nets.parent / "was-run").unlink()
    return module


def moved(field, by=0.05):
    """The field after an edit of all its parameters."""
    noise = torch.randn(field.theta.shape, generator=torch.Generator().manual_seed(4), dtype=field.dtype)
    return field.with_theta(field.theta + by * noise)


def points(like=torch.float32):
    return torch.rand(40, 3, generator=torch.Generator().manual_seed(0), dtype=like) * 2 - 1


@pytest.mark.parametrize("name", ["tied", "normed", "grown"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_edited_module_of_the_users_own_comes_back(nets, tmp_path, name, dtype):
    patterns = {"normed": ["*weight*", "*bias*"]}.get(name)
    field = moved(Field(made(nets, name).to(dtype), parameters=patterns, level=0.1, units=Units(2.0, (1.0, 2.0, 3.0))))
    save_field(field, tmp_path / "a.safetensors", builder=f"{nets}:{name}")
    again = load_field(tmp_path / "a.safetensors", module=f"{nets}:{name}")
    assert torch.equal(again.value(points(dtype)), field.value(points(dtype)))
    assert torch.equal(again.theta, field.theta)
    assert (again.level, again.units) == (0.1, field.units)


def test_a_saved_field_can_be_edited_and_saved_again_under_the_same_name(nets, tmp_path):
    name = f"{nets}:tied"
    field = moved(Field(made(nets, "tied", 6)))
    save_field(field, tmp_path / "a.safetensors", builder=name, arguments={"width": 6})
    twice = moved(load_field(tmp_path / "a.safetensors", module=name))
    save_field(twice, tmp_path / "b.safetensors", builder=name, arguments={"width": 6})
    assert torch.equal(load_field(tmp_path / "b.safetensors", module=name).value(points()), twice.value(points()))


def test_a_function_and_a_module_load_as_a_name_does_and_the_module_is_left_alone(nets, tmp_path):
    field = moved(Field(made(nets, "tied")))
    save_field(field, tmp_path / "a.safetensors", builder=f"{nets}:tied")
    module = made(nets, "tied")
    before = [p.clone() for p in module.parameters()]
    for given in (module, lambda **arguments: made(nets, "tied", *arguments.values())):
        loaded = load_field(tmp_path / "a.safetensors", module=given)
        assert torch.equal(loaded.value(points()), field.value(points()))
    assert all(torch.equal(a, b) for a, b in zip(before, module.parameters(), strict=True))


def test_a_package_is_named_by_dots(nets, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(nets.parent))
    field = Field(made(nets, "tied"))
    save_field(field, tmp_path / "a.safetensors", builder="nets:tied")
    assert torch.equal(
        load_field(tmp_path / "a.safetensors", module="nets:tied").value(points()), field.value(points())
    )
    sys.modules.pop("nets")


def test_a_code_and_the_decoder_of_the_users_own_come_back(nets, tmp_path):
    field = moved(decoder_field(made(nets, "Decoder"), torch.tensor([0.3, -0.2])))
    save_field(field, tmp_path / "a.safetensors", builder=f"{nets}:Decoder")
    again = load_field(tmp_path / "a.safetensors", module=f"{nets}:Decoder")
    assert again.takes_code
    assert torch.equal(again.value(points()), field.value(points()))


@pytest.mark.parametrize("form", ["file", "package"])
def test_code_is_not_run_because_a_file_names_it(nets, tmp_path, monkeypatch, form):
    name = f"{nets}:tied" if form == "file" else "nets:tied"
    monkeypatch.syspath_prepend(str(nets.parent))
    save_field(Field(made(nets, "tied")), tmp_path / "a.safetensors", builder=name)
    for known in [known for known in sys.modules if known == "nets" or known.startswith("implicit_named_")]:
        del sys.modules[known]
    ran = nets.parent / "was-run"
    ran.unlink()
    before = set(sys.modules)
    with pytest.raises(ValueError, match=r"No code is run because a file names it.*module=.*--module"):
        load_field(tmp_path / "a.safetensors")
    assert builder_of(tmp_path / "a.safetensors") == (name, {})
    assert not ran.exists()
    assert set(sys.modules) == before
    load_field(tmp_path / "a.safetensors", module=name)
    assert ran.exists()
    sys.modules.pop("nets", None)


def test_a_header_that_claims_an_architecture_runs_nothing_else(nets, tmp_path):
    """Text in place of a registered name is a name that is not known, whatever it says."""
    save_field(Field(Siren(width=4)), tmp_path / "a.safetensors")
    with safe_open(tmp_path / "a.safetensors", framework="pt") as file:
        header = json.loads(file.metadata()["field"])
    header["architecture"]["name"] = f"{nets}:tied"
    save_file(load_file(tmp_path / "a.safetensors"), tmp_path / "a.safetensors", {"field": json.dumps(header)})
    with pytest.raises(ValueError, match="is not known"):
        load_field(tmp_path / "a.safetensors")
    assert not (nets.parent / "was-run").exists()


class TiedSiren(nn.Module):
    """Two layers of one weight, registered by the tests."""

    def __init__(self, width: int = 8) -> None:
        super().__init__()
        self.first, self.middle = nn.Linear(3, width), nn.Linear(width, width)
        self.again, self.last = nn.Linear(width, width), nn.Linear(width, 1)
        self.again.weight = self.middle.weight

    def forward(self, x):
        for layer in (self.first, self.middle, self.again):
            x = torch.sin(layer(x))
        return self.last(x).squeeze(-1)

    def describe(self):
        return {"name": "tied-of-the-tests", "arguments": {"width": self.first.out_features}}


def test_shared_parameters_of_a_registered_class_stay_shared(tmp_path):
    register("tied-of-the-tests", TiedSiren)
    field = moved(Field(TiedSiren()))
    save_field(field, tmp_path / "a.safetensors")
    again = load_field(tmp_path / "a.safetensors")
    assert torch.equal(again.value(points()), field.value(points()))
    assert len(again.theta) == len(field.theta)
    state = load_file(tmp_path / "a.safetensors")
    assert torch.equal(state["again.weight"], state["middle.weight"])


def test_a_file_of_before_with_shared_parameters_loads_as_the_shape_that_was_saved(tmp_path):
    """They had the edited values under the first of the names, and those before the edit under the others."""
    register("tied-of-the-tests", TiedSiren)
    start = Field(TiedSiren())
    field = moved(start)
    save_field(field, tmp_path / "a.safetensors")
    state = load_file(tmp_path / "a.safetensors")
    block = next(block for block in start.layout if block.name == "middle.weight")
    state["again.weight"] = start.theta[block.where].view(block.shape).clone()
    with safe_open(tmp_path / "a.safetensors", framework="pt") as file:
        metadata = file.metadata()
    save_file(state, tmp_path / "a.safetensors", metadata)
    assert torch.equal(load_field(tmp_path / "a.safetensors").value(points()), field.value(points()))


class Unregistered(TiedSiren):
    def describe(self):
        return {"name": "unregistered-of-the-tests", "arguments": {}}


class NoJson(TiedSiren):
    def describe(self):
        return {"name": "tied-of-the-tests", "arguments": {"width": np.int64(8)}}


class Squared(TiedSiren):
    """Says that it is another class than it is."""

    def forward(self, x):
        return super().forward(x) ** 2 - 0.01


class Wordless(TiedSiren):
    def describe(self):
        return "tied"


@pytest.mark.parametrize(
    ("kind", "error", "message"),
    [
        (Unregistered, ValueError, r"no architecture of that name is registered.*register\('unregistered"),
        (NoJson, TypeError, "must be plain data that JSON can say"),
        (Squared, ValueError, "read back would have other values"),
        (Wordless, TypeError, "must return .*name.*arguments"),
    ],
)
def test_what_could_not_be_loaded_is_not_saved(tmp_path, kind, error, message):
    register("tied-of-the-tests", TiedSiren)
    with pytest.raises(error, match=message):
        save_field(Field(kind()), tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("builder", "arguments", "error", "message"),
    [
        ("{}:tied", {"width": 5}, ValueError, r"first.weight has shape \(8, 3\) in the file and \(5, 3\)"),
        ("{}:tied", {"depth": 5}, ValueError, "could not build a module.*depth"),
        ("{}:tied", {"width": np.int64(8)}, TypeError, "arguments must be plain data"),
        ("{}:tied", [8], TypeError, "arguments must be a dictionary"),
        ("{}:none", None, ValueError, "defines no function none. It defines .*tied"),
        ("{}:number", None, ValueError, "must return a torch module, but returned a int"),
        ("{}", None, ValueError, "name of a function must be"),
        ("{}:ti ed", None, ValueError, "name of a function must be"),
        (3, None, TypeError, "name of a function must be"),
        ("gone.py:tied", None, ValueError, "there is no file gone.py"),
        ("gone.nets:tied", None, ValueError, "there is no module gone"),
        (None, {"width": 8}, TypeError, "arguments are those of a builder"),
    ],
)
def test_a_builder_that_does_not_build_the_module_is_refused_at_saving(
    nets, tmp_path, builder, arguments, error, message
):
    name = builder.format(nets) if isinstance(builder, str) else builder
    with pytest.raises(error, match=message):
        save_field(Field(made(nets, "tied")), tmp_path / "a.safetensors", builder=name, arguments=arguments)
    assert not (tmp_path / "a.safetensors").exists()


def test_a_tensor_that_the_state_does_not_hold_is_found_by_reading_back(nets, tmp_path):
    with pytest.raises(ValueError, match="not among its parameters and buffers"):
        save_field(Field(made(nets, "Loose")), tmp_path / "a.safetensors", builder=f"{nets}:Loose")
    assert not (tmp_path / "a.safetensors").exists()


def test_code_that_has_changed_since_is_refused_at_loading(nets, tmp_path):
    save_field(Field(made(nets, "tied")), tmp_path / "a.safetensors", builder=f"{nets}:tied")
    nets.write_text(NETS.replace("torch.tanh", "torch.sin"))
    with pytest.raises(ValueError, match="gives other values than the field had when it was saved"):
        load_field(tmp_path / "a.safetensors", module=f"{nets}:tied")


def test_a_file_of_other_code_names_the_first_tensor_that_does_not_fit(nets, tmp_path):
    save_field(Field(made(nets, "tied")), tmp_path / "a.safetensors", builder=f"{nets}:tied")
    with pytest.raises(ValueError, match=r"does not fit the module of .*0.bias is missing in the file"):
        load_field(tmp_path / "a.safetensors", module=f"{nets}:normed")
    with pytest.raises(TypeError, match="a function or a torch module, but is 3"):
        load_field(tmp_path / "a.safetensors", module=3)


def test_a_decoder_that_is_a_function_is_refused_with_the_remedy(tmp_path):
    with pytest.raises(TypeError, match="Make it a torch module"):
        save_field(decoder_field(lambda x, z: x.norm(dim=1) - z[0], torch.ones(1)), tmp_path / "a.safetensors")


def test_a_file_of_torch_or_numpy_is_said_to_be_another_format(tmp_path):
    torch.save(nn.Linear(3, 1).state_dict(), tmp_path / "a.pth")
    torch.save(nn.Linear(3, 1).state_dict(), tmp_path / "old.pt", _use_new_zipfile_serialization=False)
    np.savez(tmp_path / "a.npz", a=np.zeros(3))
    for name in ("a.pth", "old.pt"):
        with pytest.raises(ValueError, match=r"what torch.save writes.*load_network\(path, \"auto\"\)"):
            load_field(tmp_path / name)
    with pytest.raises(ValueError, match=r"what numpy.save writes"):
        load_field(tmp_path / "a.npz")


def test_where_a_module_gives_its_values_is_kept_but_no_function_that_says_so(nets, tmp_path):
    nets.write_text(NETS + "def rest():\n    return nn.Linear(3, 4)\n")
    name = f"{nets}:rest"
    field = moved(Field(made(nets, "rest"), output=2))
    save_field(field, tmp_path / "a.safetensors", builder=name)
    assert torch.equal(load_field(tmp_path / "a.safetensors", module=name).value(points()), field.value(points()))
    with pytest.raises(TypeError, match="cannot hold the function that the field has as output"):
        save_field(Field(made(nets, "rest"), output=lambda y: y[:, 2]), tmp_path / "b.safetensors", builder=name)
    assert not (tmp_path / "b.safetensors").exists()


def test_a_file_of_another_format_is_called_that_and_a_cut_one_cut(tmp_path):
    torch.save({"a": torch.zeros(3)}, tmp_path / "x.pth")
    (tmp_path / "x.onnx").write_bytes(b"\x08\x07abcd")
    (tmp_path / "x.safetensors").write_bytes(b"\x08\x07abcd")
    for name, said in (("x.pth", "torch.save writes"), ("x.onnx", "of another format"), ("x.safetensors", "cut short")):
        with pytest.raises(ValueError, match=said):
            load_field(tmp_path / name)
