"""Published networks of one shape: written with random weights, loaded as fields, compared with a plain reading.

The readings below follow the publications and know nothing of implicit.models: lists of matrices, one after the other.
"""

import math
import re

import pytest
import torch
from safetensors.torch import save_file

import implicit

GENERATOR = torch.Generator()


@pytest.fixture(autouse=True)
def _seed():
    GENERATOR.manual_seed(5)


def random(*shape):
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64) / (shape[-1] ** 0.5 if len(shape) > 1 else 10)


def points(dimension=3):
    return 2 * torch.rand(60, dimension, generator=GENERATOR, dtype=torch.float64) - 1


def sines(prefix, widths):
    state = {}
    for k in range(len(widths) - 1):
        state[f"{prefix}.{k}.0.weight"] = random(widths[k + 1], widths[k]) / 5
        state[f"{prefix}.{k}.0.bias"] = random(widths[k + 1])
    return state


def read_sines(state, prefix, x, first=30.0, later=30.0):
    count = len(state) // 2
    for k in range(count):
        x = x @ state[f"{prefix}.{k}.0.weight"].T + state[f"{prefix}.{k}.0.bias"]
        if k < count - 1:
            x = torch.sin((first if k == 0 else later) * x)
    return x[:, 0]


def layers(inputs, width, depth, skip, outputs, *, normed, newer=False):
    """lin0 ... lin`depth`; the layer before the skip puts out less by what is given again."""
    state = {}
    for k in range(depth + 1):
        rows = outputs if k == depth else width - inputs if k + 1 == skip else width
        columns = inputs if k == 0 else width
        state[f"lin{k}.bias"] = random(rows)
        g, v = ("parametrizations.weight.original0", "parametrizations.weight.original1")
        if not normed:
            state[f"lin{k}.weight"] = random(rows, columns)
        else:
            state[f"lin{k}.{g if newer else 'weight_g'}"] = random(rows, 1).abs() + 0.5
            state[f"lin{k}.{v if newer else 'weight_v'}"] = random(rows, columns)
    return state


def matrix(state, name):
    if f"{name}.weight" in state:
        return state[f"{name}.weight"]
    g, v = (state[key] for kind in ("weight_g", "weight_v") if (key := f"{name}.{kind}") in state)
    return g * v / v.norm(dim=1, keepdim=True)


def read_layers(state, x, depth, skip, octaves=0, scale=1.0):
    x = scale * x
    columns = [x]
    for k in range(octaves):
        columns += [torch.sin(2**k * x), torch.cos(2**k * x)]
    start = torch.cat(columns, dim=1)
    h = start
    for k in range(depth + 1):
        if k == skip:
            h = torch.cat([h, start], dim=1) / math.sqrt(2)
        h = h @ matrix(state, f"lin{k}").T + state[f"lin{k}.bias"]
        if k < depth:
            # nn.Softplus(beta=100), which is the identity from 100 h = 20 on
            h = torch.where(100 * h > 20, h, torch.log1p(torch.exp((100 * h).clamp(max=20))) / 100)
    return h[:, 0] / scale


def agrees(field, x, wanted):
    torch.testing.assert_close(field.value(x), wanted, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("prefix", ["", "module."])
def test_a_siren_of_its_authors_evaluates_as_its_layout_reads(tmp_path, dimension, prefix):
    state = sines("net.net", [dimension, 20, 20, 20, 1])
    torch.save({f"{prefix}{k}": v for k, v in state.items()}, tmp_path / "model_final.pth")
    bounds = ((-1,) * dimension, (1,) * dimension)
    field = implicit.load_network(tmp_path / "model_final.pth", "siren", bounds=bounds, dtype=torch.float64)
    x = points(dimension)
    agrees(field, x, read_sines(state, "net.net", x))


def test_a_siren_of_i3d_evaluates_as_its_layout_reads(tmp_path):
    state = sines("net", [3, 20, 20, 1])
    torch.save(state, tmp_path / "best.pth")
    options = {"first_frequency": 60.0, "frequency": 15.0}
    field = implicit.load_network(tmp_path / "best.pth", "i3d", **options, dtype=torch.float64)
    x = points()
    agrees(field, x, read_sines(state, "net", x, 60.0, 15.0))


def notebook(read):
    """The state of the notebook's Siren: net.k.linear, and net.K for the last layer, which has no sine."""
    state, last = {}, len(read) // 2 - 1
    for name, tensor in read.items():
        place, kind = re.fullmatch(r"net\.(\d+)\.0\.(weight|bias)", name).groups()
        state[f"net.{place}.{kind}" if int(place) == last else f"net.{place}.linear.{kind}"] = tensor
    return state


@pytest.mark.parametrize("prefix", ["", "module."])
def test_a_siren_of_the_notebook_evaluates_as_its_layout_reads_with_its_factors_or_a_warning(tmp_path, prefix):
    read = sines("net", [3, 20, 20, 20, 1])
    torch.save({f"{prefix}{name}": tensor for name, tensor in notebook(read).items()}, tmp_path / "siren.pth")
    x = points()
    known = {"first_frequency": 60.0, "frequency": 15.0}
    field = implicit.load_network(tmp_path / "siren.pth", "sine_layers", **known, dtype=torch.float64)
    agrees(field, x, read_sines(read, "net", x, 60.0, 15.0))
    with pytest.warns(UserWarning, match="does not tell the factors in its sines.*30 was taken"):
        field = implicit.load_network(tmp_path / "siren.pth", dtype=torch.float64)
    agrees(field, x, read_sines(read, "net", x))
    with pytest.raises(
        ValueError, match=r"fits the layout of sine_layers. Load it by load_network\(path, 'sine_layers'\)"
    ):
        implicit.load_checkpoint(tmp_path / "siren.pth", "auto")


def test_a_notebooks_siren_whose_last_layer_is_a_sine_is_refused(tmp_path):
    state = notebook(sines("net", [3, 8, 8, 1]))
    for kind in ("weight", "bias"):
        state[f"net.2.linear.{kind}"] = state.pop(f"net.2.{kind}")
    save_file(state, tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=r"its last layer, net\.2, is a sine"):
        implicit.load_network(tmp_path / "a.safetensors", "sine_layers")


def test_a_network_of_igr_evaluates_as_its_layout_reads(tmp_path):
    state = layers(3, 32, 8, 4, 1, normed=False)
    torch.save({"epoch": 100, "model_state_dict": state}, tmp_path / "100000.pth")
    x = points()
    for name in ("igr", "auto"):
        field = implicit.load_network(tmp_path / "100000.pth", name, dtype=torch.float64)
        agrees(field, x, read_layers(state, x, 8, 4))


@pytest.mark.parametrize("newer", [False, True], ids=["older weight norm", "newer weight norm"])
@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_a_network_of_neus_evaluates_as_its_layout_reads(tmp_path, newer, scale):
    state = layers(39, 64, 8, 4, 257, normed=True, newer=newer)
    color = layers(289, 32, 4, -1, 3, normed=True)
    content = {
        "nerf": {"pts_linears.0.bias": random(3)},
        "color_network_fine": color,
        "sdf_network_fine": state,
        "variance_network_fine": {"variance": torch.tensor(0.3)},
        "optimizer": {"state": {0: {"step": torch.tensor(1.0)}}, "param_groups": [{"lr": 1e-3}]},
        "iter_step": 300000,
    }
    torch.save(content, tmp_path / "ckpt_300000.pth")
    field = implicit.load_network(tmp_path / "ckpt_300000.pth", "neus", scale=scale, dtype=torch.float64)
    plain = {key.replace("parametrizations.weight.original0", "weight_g"): value for key, value in state.items()}
    plain = {key.replace("parametrizations.weight.original1", "weight_v"): value for key, value in plain.items()}
    x = points()
    agrees(field, x, read_layers(plain, x, 8, 4, 6, scale))
    assert len(field.theta) == sum(v.numel() for v in state.values())


def test_a_network_of_volsdf_evaluates_as_its_layout_reads(tmp_path):
    state = layers(39, 64, 8, 4, 257, normed=True)
    render = layers(289, 32, 4, -1, 3, normed=True)
    content = {f"rendering_network.{k}": v for k, v in render.items()} | {"density.beta": torch.tensor(0.1)}
    content |= {f"implicit_network.{k}": v for k, v in state.items()}
    torch.save({"epoch": 2000, "model_state_dict": {f"module.{k}": v for k, v in content.items()}}, tmp_path / "a.pth")
    x = points()
    for name in ("volsdf", "auto"):
        field = implicit.load_network(tmp_path / "a.pth", name, dtype=torch.float64)
        agrees(field, x, read_layers(state, x, 8, 4, 6))


SMALL = {
    "siren": lambda: sines("net.net", [3, 8, 8, 1]),
    "i3d": lambda: sines("net", [3, 8, 8, 1]),
    "igr": lambda: layers(3, 12, 4, 2, 1, normed=False),
    "neus": lambda: layers(15, 24, 4, 2, 5, normed=True),
    "volsdf": lambda: {f"implicit_network.{k}": v for k, v in layers(15, 24, 4, 2, 5, normed=True).items()},
}
INNER = {
    "siren": "net.net.1.0.weight", "i3d": "net.1.0.weight", "igr": "lin3.weight", "neus": "lin3.weight_v",
    "volsdf": "lin3.weight_v",
}  # fmt: skip


@pytest.mark.parametrize("architecture", SMALL)
def test_the_layout_is_found_by_itself_and_the_field_can_be_saved(tmp_path, architecture):
    save_file(SMALL[architecture](), tmp_path / "a.safetensors")
    field = implicit.load_network(tmp_path / "a.safetensors", "auto")
    implicit.save_field(field, tmp_path / "b.safetensors")
    x = points().float()
    assert torch.equal(implicit.load_field(tmp_path / "b.safetensors").value(x), field.value(x))
    assert torch.equal(implicit.load_network(tmp_path / "a.safetensors", architecture).theta, field.theta)


@pytest.mark.parametrize("architecture", SMALL)
def test_the_first_tensor_that_does_not_fit_is_named_as_in_the_file(tmp_path, architecture):
    name = INNER[architecture]
    full = f"implicit_network.{name}" if architecture == "volsdf" else name
    for what, change in {
        f"{name} is missing": lambda state: state.pop(full),
        f"{name} has shape": lambda state: state.update({full: state[full][:, :-1].contiguous()}),
        f"{name} holds NaN": lambda state: state[full].fill_(math.nan),
        "norm.weight belongs to no layer": lambda state: state.update({full.replace(name, "norm.weight"): random(4)}),
    }.items():
        state = SMALL[architecture]()
        change(state)
        save_file(state, tmp_path / "a.safetensors")
        with pytest.raises(ValueError, match=what):
            implicit.load_network(tmp_path / "a.safetensors", architecture)


@pytest.mark.parametrize("architecture", SMALL)
def test_the_network_of_another_layout_is_refused(tmp_path, architecture):
    others = {"siren": "i3d", "i3d": "igr", "igr": "neus", "neus": "volsdf", "volsdf": "siren"}
    save_file(SMALL[others[architecture]](), tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=f"layout of {architecture}: .* Wanted is"):
        implicit.load_network(tmp_path / "a.safetensors", architecture)


def test_a_decoder_and_a_network_are_loaded_by_the_function_for_them(tmp_path):
    save_file(SMALL["siren"](), tmp_path / "s.safetensors")
    with pytest.raises(ValueError, match=r"siren is an architecture that takes no code.*load_network\(path, 'siren'\)"):
        implicit.load_checkpoint(tmp_path / "s.safetensors", "siren")
    with pytest.raises(ValueError, match=r"fits the layout of siren. Load it by load_network"):
        implicit.load_checkpoint(tmp_path / "s.safetensors", "auto")
    with pytest.raises(ValueError, match=r"imnet is an architecture that takes a code.*load_checkpoint"):
        implicit.load_network(tmp_path / "s.safetensors", "imnet")
    with pytest.raises(
        ValueError, match="architecture must be one of siren, sine_layers, i3d, igr, neus, volsdf, auto"
    ):
        implicit.load_network(tmp_path / "s.safetensors", "nerf")


def test_the_layout_of_a_decoder_is_found_by_itself(tmp_path):
    from implicit.models import DeepSdf, DualSdf, ImNet

    for decoder in (ImNet(8, 4), DeepSdf(5, 24), DualSdf(6, 20, spheres=9)):
        save_file(decoder.state_dict(), tmp_path / "a.safetensors")
        found, _ = implicit.load_checkpoint(tmp_path / "a.safetensors", "auto")
        assert found.describe()["name"] == decoder.describe()["name"]


def test_a_network_of_igr_with_a_code_is_not_taken_for_a_decoder_of_deepsdf(tmp_path):
    save_file(layers(3 + 8, 24, 8, 4, 1, normed=False), tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=r"lin0.weight takes 11 numbers.*codes are not read"):
        implicit.load_network(tmp_path / "a.safetensors", "igr")
    for load in (implicit.load_network, implicit.load_checkpoint):
        with pytest.raises(ValueError, match=r"fits no published layout.*It holds lin0.bias.*known are imnet"):
            load(tmp_path / "a.safetensors", "auto")


def test_an_option_of_another_architecture_is_refused(tmp_path):
    save_file(SMALL["igr"](), tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match="frequency is no option of igr, which takes scale, sharpness"):
        implicit.load_network(tmp_path / "a.safetensors", "auto", frequency=20)
    with pytest.raises(ValueError, match="scale must be a positive number"):
        implicit.load_network(tmp_path / "a.safetensors", "igr", scale=0)
