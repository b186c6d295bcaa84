"""Published layouts: written with random weights, loaded, and compared with a plain reading of each layout.

The readings below follow the publications and know nothing of implicit.models: lists of matrices, one after the other.
"""

import os
import pickle

import pytest
import torch
from safetensors.torch import save_file

import implicit
from implicit.models import DeepSdf, DualSdf, ImNet

SEED = 3


def random(*shape):
    return torch.randn(*shape, generator=random.generator) / (shape[-1] ** 0.5 if len(shape) > 1 else 10)


@pytest.fixture(autouse=True)
def _seed():
    random.generator = torch.Generator().manual_seed(SEED)


def plain(state, name, inputs, outputs):
    state[f"{name}.weight"], state[f"{name}.bias"] = random(outputs, inputs), random(outputs)


def normed(state, name, inputs, outputs):
    state[f"{name}.bias"] = random(outputs)
    state[f"{name}.weight_g"] = random(outputs, 1).abs() + 0.5
    state[f"{name}.weight_v"] = random(outputs, inputs)


def apply(state, name, x):
    """One layer, by whichever names it has."""
    if f"{name}.weight" in state:
        return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]
    v, g = state[f"{name}.weight_v"], state[f"{name}.weight_g"]
    return x @ (g * v / v.norm(dim=1, keepdim=True)).T + state[f"{name}.bias"]


def imnet_state(latent=256, width=128):
    state, widths = {}, [latent + 3, 8 * width, 8 * width, 8 * width, 4 * width, 2 * width, width, 1]
    for k in range(7):
        plain(state, f"linear_{k + 1}", widths[k], widths[k + 1])
    return state


def read_imnet(state, points, code):
    h = torch.cat([points, code.repeat(len(points), 1)], dim=1)  # points first
    for k in range(1, 7):
        a = apply(state, f"linear_{k}", h)
        h = torch.where(a > 0, a, 0.02 * a)
    a = apply(state, "linear_7", h)[:, 0]
    return torch.max(torch.min(a, a * 0.01 + 0.99), a * 0.01)


def deepsdf_state(latent=256, width=512):
    state, inputs = {}, latent + 3
    for k in range(8):
        normed(state, f"lin{k}", inputs if k == 0 else width, width - inputs if k == 3 else width)
    plain(state, "lin8", width, 1)
    return state


def read_deepsdf(state, points, code):
    start = torch.cat([code.repeat(len(points), 1), points], dim=1)  # code first
    h = start
    for k in range(8):
        if k == 4:
            h = torch.cat([h, start], dim=1)
        h = apply(state, f"lin{k}", h).clamp(min=0)
    return apply(state, "lin8", h)[:, 0].tanh()


def dualsdf_state(latent=128, width=512, spheres=256, *, dropout=True):
    state = {}
    step = 3 if dropout else 2
    for net, inputs, outputs, places in (
        ("deepsdf_net", latent + 3, 1, step),
        ("prim_attr_net", latent, 4 * spheres, 2),
    ):
        for k in range(4):
            normed(state, f"{net}.net1.{places * k}", inputs if k == 0 else width, width - inputs if k == 3 else width)
        for k in range(4):
            normed(state, f"{net}.net2.{places * k}", width, width)
        plain(state, f"{net}.net2.{places * 4}", width, outputs)
    return state


def read_skip(state, net, places, start):
    h = start
    for k in range(4):
        h = apply(state, f"{net}.net1.{places * k}", h).clamp(min=0)
    h = torch.cat([h, start], dim=1)
    for k in range(4):
        h = apply(state, f"{net}.net2.{places * k}", h).clamp(min=0)
    return apply(state, f"{net}.net2.{places * 4}", h)


def points_and_code(latent):
    return 2 * torch.rand(50, 3, generator=random.generator) - 1, random(latent)


@pytest.mark.parametrize("in_auto_encoder", [False, True])
def test_imnet_evaluates_as_its_layout_reads(tmp_path, in_auto_encoder):
    state = imnet_state()
    content = {f"generator.{k}": v for k, v in state.items()} if in_auto_encoder else state
    if in_auto_encoder:
        content["encoder.conv_1.weight"] = random(32, 1, 4, 4, 4)
    torch.save(content, tmp_path / "model.pth")
    decoder, codes = implicit.load_checkpoint(tmp_path / "model.pth", "imnet")
    points, code = points_and_code(256)
    torch.testing.assert_close(decoder(points, code), read_imnet(state, points, code), rtol=1e-5, atol=1e-6)
    assert codes.shape == (0, 256)
    assert (decoder.level, decoder.inside) == (0.5, "positive")


def test_deepsdf_evaluates_as_its_layout_reads(tmp_path):
    state = deepsdf_state()
    content = {"epoch": 2000, "model_state_dict": {f"module.{k}": v for k, v in state.items()}}
    torch.save(content, tmp_path / "latest.pth")
    table = random(5, 256)
    torch.save({"epoch": 2000, "latent_codes": {"weight": table}}, tmp_path / "codes.pth")
    decoder, codes = implicit.load_checkpoint(tmp_path / "latest.pth", "deepsdf", codes=tmp_path / "codes.pth")
    points, code = points_and_code(256)
    torch.testing.assert_close(decoder(points, code), read_deepsdf(state, points, code), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(codes, table)


@pytest.mark.parametrize("dropout", [True, False])
def test_dualsdf_evaluates_as_its_layout_reads(tmp_path, dropout):
    state = dualsdf_state(dropout=dropout)
    table = random(7, 128)
    latents = {"latent_embeddings.weight_mu": table, "latent_embeddings.weight_logvar": random(7, 128)}
    torch.save({"trainer_state_dict": state | latents, "epoch": 1}, tmp_path / "epoch.pth")
    decoder, codes = implicit.load_checkpoint(tmp_path / "epoch.pth", "dualsdf")
    points, code = points_and_code(128)
    start = torch.cat([code.repeat(len(points), 1), points], dim=1)
    fine = read_skip(state, "deepsdf_net", 3 if dropout else 2, start)[:, 0].tanh()
    torch.testing.assert_close(decoder(points, code), fine, rtol=1e-5, atol=1e-6)
    attributes = read_skip(state, "prim_attr_net", 2, code[None]).view(256, 4)
    away = (points[:, None] - attributes[None, :, 1:]).norm(dim=2) - attributes[:, 0].exp()
    torch.testing.assert_close(
        decoder.coarse(points, code), -torch.logsumexp(-100 * away, dim=1) / 100, rtol=1e-5, atol=1e-5
    )
    torch.testing.assert_close(codes, table)


@pytest.mark.parametrize(
    ("make", "architecture", "latent"),
    [(imnet_state, "imnet", 256), (deepsdf_state, "deepsdf", 256), (dualsdf_state, "dualsdf", 128)],
    ids=["imnet", "deepsdf", "dualsdf"],
)
def test_a_code_a_point_gives_what_one_code_gives(tmp_path, make, architecture, latent):
    save_file(make(), tmp_path / "a.safetensors")
    decoder, _ = implicit.load_checkpoint(tmp_path / "a.safetensors", architecture, dtype=torch.float64)
    points, code = (part.double() for part in points_and_code(latent))
    torch.testing.assert_close(decoder(points, code), decoder(points, code.repeat(len(points), 1)))


def test_sizes_other_than_the_published_are_read_off_the_tensors(tmp_path):
    save_file(imnet_state(8, 4), tmp_path / "i.safetensors")
    save_file(deepsdf_state(5, 24), tmp_path / "s.safetensors")
    save_file(dualsdf_state(6, 20, 9, dropout=False), tmp_path / "d.safetensors")
    assert implicit.load_checkpoint(tmp_path / "i.safetensors", "imnet")[0].describe() == ImNet(8, 4).describe()
    assert implicit.load_checkpoint(tmp_path / "s.safetensors", "deepsdf")[0].describe() == DeepSdf(5, 24).describe()
    dual = DualSdf(6, 20, spheres=9, dropout=0.0)
    assert implicit.load_checkpoint(tmp_path / "d.safetensors", "dualsdf")[0].describe() == dual.describe()


SMALL = {
    "imnet": lambda: imnet_state(8, 4),
    "deepsdf": lambda: deepsdf_state(5, 24),
    "dualsdf": lambda: dualsdf_state(6, 20, 9),
}
INNER = {"imnet": "linear_3.weight", "deepsdf": "lin5.weight_v", "dualsdf": "prim_attr_net.net2.4.weight_v"}


@pytest.mark.parametrize("architecture", SMALL)
def test_the_first_tensor_that_does_not_fit_is_named(tmp_path, architecture):
    name = INNER[architecture]
    for what, change in {
        "is missing": lambda state: state.pop(name),
        "has shape": lambda state: state.update({name: state[name][:, :-1].contiguous()}),
        "holds NaN": lambda state: state[name].fill_(float("nan")),
    }.items():
        state = SMALL[architecture]()
        change(state)
        save_file(state, tmp_path / "a.safetensors")
        with pytest.raises(ValueError, match=rf"{name} {what}"):
            implicit.load_checkpoint(tmp_path / "a.safetensors", architecture)
    state = SMALL[architecture]() | {"batch_norm.weight": random(4)}
    save_file(state, tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=r"batch_norm.weight belongs to no layer"):
        implicit.load_checkpoint(tmp_path / "a.safetensors", architecture)


@pytest.mark.parametrize("architecture", SMALL)
def test_the_checkpoint_of_another_architecture_is_refused(tmp_path, architecture):
    other = {"imnet": "deepsdf", "deepsdf": "dualsdf", "dualsdf": "imnet"}[architecture]
    save_file(SMALL[other](), tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match=f"layout of {architecture}.*is missing"):
        implicit.load_checkpoint(tmp_path / "a.safetensors", architecture)


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.99])
def test_a_file_cut_short_is_refused(tmp_path, suffix, kept):
    path = tmp_path / f"a{suffix}"
    (save_file if suffix == ".safetensors" else torch.save)(SMALL["deepsdf"](), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(ValueError, match=r"cut short|not a whole"):
        implicit.load_checkpoint(path, "deepsdf")


class Bomb:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (os.mkdir, (str(self.path),))


@pytest.mark.parametrize("how", ["torch", "legacy", "pickle"])
def test_code_in_a_pickle_is_refused_and_not_run(tmp_path, how):
    path, mark = tmp_path / "a.pth", tmp_path / "was-run"
    content = SMALL["deepsdf"]() | {"extra": Bomb(mark)}
    if how == "pickle":
        path.write_bytes(pickle.dumps(content, protocol=2))
    else:
        torch.save(content, path, _use_new_zipfile_serialization=how == "torch")
    with pytest.raises(ValueError, match=r"not executed|no checkpoint"):
        implicit.load_checkpoint(path, "deepsdf")
    assert not mark.exists()


def test_codes_of_another_model_are_refused(tmp_path):
    save_file(SMALL["deepsdf"](), tmp_path / "a.safetensors")
    torch.save({"latent_codes": random(4, 6)}, tmp_path / "codes.pth")
    with pytest.raises(ValueError, match=r"codes have shape \(4, 6\)"):
        implicit.load_checkpoint(tmp_path / "a.safetensors", "deepsdf", codes=tmp_path / "codes.pth")


def test_a_missing_file_and_an_unknown_architecture_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        implicit.load_checkpoint(tmp_path / "none.pth", "imnet")
    with pytest.raises(ValueError, match="architecture must be one of imnet"):
        implicit.load_checkpoint(tmp_path / "none.pth", "nerf")
