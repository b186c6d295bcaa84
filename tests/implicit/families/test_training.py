"""Training a family: it learns, repeats bit by bit, and goes on from a checkpoint as if never interrupted."""

import pytest
import torch

from implicit import families
from implicit.families.train import _scale_codes
from implicit.models import DeepSdf, DualSdf
from implicit.models.weight_norm import with_weight_norm

TINY = {"shapes": 4, "latent": 4, "width": 32, "steps": 30, "batch": 400, "validation": 1}


class InterruptedHereError(Exception):
    pass


def weights(model):
    parts = [model.decoder, *([model.encoder] if model.encoder else [])]
    return torch.cat([p.flatten() for part in parts for p in part.parameters()] + [model.latents.flatten()])


TRAINED = ["dualsdf", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("deepsdf", "imnet"))]


@pytest.mark.parametrize("architecture", TRAINED)
def test_an_interrupted_training_ends_with_the_same_bits(architecture, tmp_path):
    whole = families.train_family("lamps", architecture, **TINY)
    path = tmp_path / "state.safetensors"

    def stop(step, steps, loss):
        if step == 21:
            raise InterruptedHereError

    with pytest.raises(InterruptedHereError):
        families.train_family("lamps", architecture, checkpoint=path, progress=stop, **TINY)
    steps = []
    resumed = families.train_family(
        "lamps", architecture, checkpoint=path, progress=lambda step, *_: steps.append(step), **TINY
    )
    assert steps[0] == 21  # the checkpoint is that of step 20
    torch.testing.assert_close(weights(resumed), weights(whole), rtol=0, atol=0)
    with pytest.raises(ValueError, match="belongs to another training"):
        families.train_family("lamps", architecture, checkpoint=path, **(TINY | {"latent": 5}))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match="not a whole checkpoint"):
        families.train_family("lamps", architecture, checkpoint=path, **TINY)


@pytest.mark.parametrize("architecture", TRAINED)
def test_the_loss_falls_and_codes_come_with_a_spread_of_one(architecture):
    losses = []
    options = TINY | (
        {"width": 64, "steps": 300, "batch": 1600} if architecture == "imnet" else {"steps": 200, "batch": 800}
    )
    model = families.train_family("lamps", architecture, progress=lambda *state: losses.append(state[2]), **options)
    assert losses[-1] < 0.5 * losses[0]
    if architecture != "imnet":  # its encoder gives codes between 0 and 1
        assert float(model.latents.std(dim=0).square().mean()) == pytest.approx(1.0, rel=1e-4)


def test_a_model_is_saved_and_loaded(tmp_path):
    model = families.train_family("chairs", "imnet", **(TINY | {"steps": 2}))
    families.save_model(model, tmp_path / "m.safetensors")
    again = families.load_model(tmp_path / "m.safetensors")
    torch.testing.assert_close(weights(again), weights(model), rtol=0, atol=0)
    torch.testing.assert_close(again.parameters, model.parameters, atol=1e-6, rtol=0)
    assert again.report == model.report
    assert again.family is model.family
    families.save_model(model, tmp_path / "h.safetensors", dtype=torch.float16)
    assert (tmp_path / "h.safetensors").stat().st_size < 0.6 * (tmp_path / "m.safetensors").stat().st_size
    torch.testing.assert_close(
        weights(families.load_model(tmp_path / "h.safetensors")), weights(model), atol=1e-3, rtol=1e-3
    )


def test_weights_without_a_model_are_no_model(tmp_path):
    from safetensors.torch import save_file

    save_file(DeepSdf(4, 16, 2, 1).state_dict(), tmp_path / "a.safetensors")
    with pytest.raises(ValueError, match="holds no model of a family"):
        families.load_model(tmp_path / "a.safetensors")


@pytest.mark.parametrize(
    "make",
    [
        lambda normed: DeepSdf(3, 16, 4, 2, weight_norm=normed),
        lambda normed: DualSdf(3, 16, (2, 2), 5, dropout=0.0, weight_norm=normed),
    ],
    ids=["deepsdf", "dualsdf"],
)
def test_weight_norm_and_scaled_codes_leave_the_function_as_it_was(make):
    plain = make(False)
    points, code = torch.rand(20, 3), torch.rand(3)
    expected = plain(points, code).detach()
    _scale_codes(plain, 0.25)
    normed = make(True)
    normed.load_state_dict(with_weight_norm(plain.state_dict(), normed))
    torch.testing.assert_close(normed(points, code / 0.25), expected)
    if isinstance(plain, DualSdf):
        torch.testing.assert_close(normed.spheres(code / 0.25), plain.spheres(code / 0.25))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("boats", "deepsdf"), "no family 'boats'; there are chairs"),
        (("chairs", "nerf"), "architecture must be deepsdf"),
    ],
)
def test_unknown_names_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        families.train_family(*arguments, **TINY)
    with pytest.raises(ValueError, match="must be at least 1"):
        families.train_family("chairs", "deepsdf", shapes=0)
