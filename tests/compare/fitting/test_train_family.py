"""The command that trains a model of a family, at the smallest size."""

import json
import shlex

import pytest

from compare.commands.cli import main
from implicit import families

TINY = "--shapes 3 --latent 4 --width 32 --steps 3 --batch 300 --validation 1"


def run(line):
    with pytest.raises(SystemExit) as end:
        main(shlex.split(line))
    return end.value.code


@pytest.mark.nightly
def test_a_model_is_written_with_its_scores_and_the_command_that_makes_it_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(f"train-family dualsdf lamps -o model.safetensors --half --quiet {TINY}") == 0
    report = json.loads((tmp_path / "model.json").read_text())
    model = families.load_model("model.safetensors")
    assert model.report == report
    assert report["validation"]["shapes"] == 1
    (tmp_path / "model.safetensors").rename("first.safetensors")
    assert run(report["command"].removeprefix("implicit-vs-mesh ") + " --quiet") == 0
    again = families.load_model("model.safetensors")
    assert (again.latents == model.latents).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("-o model.pth", "ending in .safetensors"),
        ("-o there.safetensors", "is there already"),
        ("-o model.safetensors --steps 0 --shapes 0", "--shapes and --steps must be at least 1"),
        ("-o model.safetensors --device cuda", "no CUDA device"),
    ],
)
def test_bad_input_is_refused_before_any_work(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    (tmp_path / "there.safetensors").write_bytes(b"")
    assert run(f"train-family deepsdf chairs {arguments}") == 2
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there.safetensors"]
