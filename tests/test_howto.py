"""The tasks of docs/howto.md do what they say when they are copied."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import implicit
import meshref
from compare.commands.cli import main
from compare.runs.records import read
from compare.studies.plan import check_options, plan
from compare.studies.study import find_study
from implicit import shapes

PAGE = (Path(__file__).parents[1] / "docs" / "howto.md").read_text(encoding="utf-8")
TASKS = dict(zip(re.findall(r"^## (.*)$", PAGE, re.MULTILINE), re.split(r"^## .*$", PAGE, flags=re.MULTILINE)[1:]))


def code_of(task, language="python"):
    (text,) = (said for name, said in TASKS.items() if task in name)
    return re.search(rf"```{language}\n(.*?)```", text, re.DOTALL)[1]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run(task):
    names = {}
    exec(compile(code_of(task), f"docs/howto.md, {task}", "exec"), names)
    return names


@pytest.mark.nightly
def test_a_siren_checkpoint_is_dragged():
    """The bundled network of spot, by the notebook's names."""
    state = shapes.bundled("spot").module.state_dict()
    last = max(int(name.split(".")[1]) for name in state)
    named = {}
    for name, tensor in state.items():
        _, k, kind = name.split(".")
        named[f"net.{k}.{kind}" if int(k) == last else f"net.{k}.linear.{kind}"] = tensor
    torch.save(named, "siren.pth")
    names = run("SIREN")
    before, after = (implicit.extract_mesh(field, 48)[0][:, 2].max() for field in (names["field"], names["edit"].field))
    assert after - before == pytest.approx(0.06, abs=0.006)
    torch.testing.assert_close(implicit.load_field("dragged.safetensors").theta, names["edit"].field.theta)


@pytest.mark.nightly
def test_a_file_in_millimetres_comes_back_in_millimetres():
    """A ball of radius 40 about (100, 50, -20); the bump raises its end along x by 3."""
    V, F = meshref.icosphere(3)
    meshref.write_mesh("part.stl", 40 * V + np.array([100.0, 50.0, -20.0]), F)
    run("millimetres")
    edited, _ = meshref.read_mesh("edited.stl")
    assert edited[:, 0].max() == pytest.approx(143, abs=1.0)
    assert edited[:, 0].min() == pytest.approx(60, abs=1.0)
    assert edited[:, 2].min() == pytest.approx(-60, abs=1.0)


@pytest.mark.nightly
def test_handles_of_ones_own_hold_and_pull_at_the_first_guess():
    record = run("energy curve")["record"]
    assert not record.failed
    curve = [row.killing_energy for row in record.sides["implicit"].curve]
    assert len(curve) == 4
    assert curve[0] == 0
    assert curve == sorted(curve)
    assert record.sides["implicit"].displacement_max == pytest.approx(0.15, rel=0.2)


def write_three_files():
    V, F = meshref.icosphere(2)
    for name, stretch in (("a", 1.0), ("b", 1.3), ("c", 1.6)):
        meshref.write_mesh(f"{name}.ply", V * np.array([stretch, 1.0, 1.0]), F)
    Path("widths.toml").write_text(code_of("three files", "toml"), encoding="utf-8")


def test_a_study_of_three_files_and_two_widths_has_six_cases():
    write_three_files()
    study = find_study("widths.toml", quick=True)
    check_options(study)
    cases = plan(study, Path("inputs"))
    widths = [case.parameters["fit"]["width"] for case in cases]
    assert [Path(case.shape).name for case in cases] == ["a.ply", "a.ply", "b.ply", "b.ply", "c.ply", "c.ply"]
    assert widths == [32, 64] * 3


@pytest.mark.nightly
def test_the_study_runs_and_its_report_has_its_title_and_chart_on_top():
    """Smaller than it stands there: the page has figures in view, a test has not."""
    write_three_files()
    text = Path("widths.toml").read_text(encoding="utf-8")
    small = text.replace("vertices = 2000", "vertices = 300\nfit.steps = 100\nresolution = 24").replace(
        "32, 64", "8, 16"
    )
    assert small != text
    Path("widths.toml").write_text(small, encoding="utf-8")
    words = code_of("three files", "bash").split()[1:]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--quick", "--quiet"])
    assert ended.value.code == 0
    assert len(read("results/widths")) == 6
    page = Path("results/widths/report.html").read_text(encoding="utf-8")
    assert "<h1>How wide must the network be?</h1>" in page
    assert page.index("data:image/png") < page.index('class="finding')


@pytest.mark.nightly
def test_a_smoothing_is_animated():
    names = run("animated")
    with Image.open("smoothing.gif") as film:
        assert film.n_frames > len(names["edit"].trail)
    volumes = [meshref.volume(V, F) for V, F in names["edit"].frames(names["V"], names["F"])]
    assert volumes == pytest.approx([volumes[0]] * 5, rel=0.02)
