"""Fields of a user's own module in cases, commands, studies and workers; code that runs where it is named, only."""

import json
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

import implicit
import implicit.shapes
import meshref
from compare import Case, fit_mesh, prepare_subject, run_case, run_cases
from compare.cases.case import NameOfFile
from compare.errors import InputError
from compare.runs.executors import executor_of
from compare.runs.records import read
from compare.studies.study import find_study
from compare.studies.study_folder import run_study

NETS = '''
from pathlib import Path
with Path(__file__).with_name("was-run").open("a") as file:
    file.write("run ")
import torch
from torch import nn

class Ball(nn.Module):
    """A ball that a few sines dent, with radius and dents as parameters."""

    def __init__(self, dents):
        super().__init__()
        self.radius = nn.Parameter(torch.tensor(0.6))
        self.dents = nn.Parameter(torch.zeros(dents, 3))

    def forward(self, x):
        k = torch.arange(1, len(self.dents) + 1).to(x)
        waves = torch.sin(k[:, None] * x[:, None, :] + k[:, None])
        return x.norm(dim=1) - self.radius + (waves * self.dents).sum(dim=(1, 2)) / 10

def make(dents=4):
    return Ball(dents)

def network():
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 24), nn.Softplus(20), nn.Linear(24, 24), nn.Softplus(20), nn.Linear(24, 1))

def flat():
    return nn.Linear(2, 1)
'''

STUDY = """
title = "A ball of one's own"
shapes = ["ball.safetensors"]
operations = ["smooth"]
settings = { vertices = 150, resolution = 16, steps = 1 }
keep_meshes = false
[grid]
step_size = [1e-4]
"""


@pytest.fixture
def ball(tmp_path, monkeypatch):
    """The folder of nets.py and of a field that its make builds, as the current one."""
    (tmp_path / "nets.py").write_text(NETS)
    monkeypatch.chdir(tmp_path)
    namespace = {"__file__": str(tmp_path / "nets.py"), "__name__": "made"}
    exec(NETS, namespace)
    field = implicit.Field(namespace["make"](3))
    implicit.save_field(field, "ball.safetensors", builder="nets.py:make", arguments={"dents": 3})
    forgotten()
    return tmp_path


def forgotten():
    """Forget all code that was imported by its name, so that it runs again where it is imported again."""
    for name in [name for name in sys.modules if name.startswith("implicit_named_")]:
        del sys.modules[name]
    Path("was-run").unlink()


def a_case(**changes):
    case = Case("ball.safetensors", "smooth", (), {"steps": 1, "step_size": 1e-4}, 150, 16, module="nets.py:make")
    return replace(case, **changes)


def test_a_case_keeps_the_name_of_the_module_in_its_data_and_its_key():
    case = Case("ball.safetensors", "smooth", module="nets.py:make")
    assert case.to_dict()["module"] == "nets.py:make"
    assert "nets.py:make" in repr(case)
    without = replace(case, module=None)
    assert "module" not in without.to_dict()
    assert Case.from_dict(without.to_dict()) == without
    assert Case.from_json(case.to_json()) == case


def test_keys_differ_by_the_module_and_are_those_of_before_without_one(ball):
    case = a_case()
    other = replace(case, module="others.py:make")
    assert len({case.key, other.key, replace(case, module=None).key}) == 3
    assert len({case.subject_key, other.subject_key, replace(case, module=None).subject_key}) == 3


def test_a_case_of_ones_own_field_is_run_and_its_results_load_again(ball):
    record = run_case(a_case(), folder=ball / "run")
    assert not record.failed
    subject = prepare_subject(a_case(), folder=ball / "run")  # read back from there
    assert subject.field.theta.numel() == 10
    path = ball / "run" / record.artefacts["field"].path
    assert implicit.load_field(path, module="nets.py:make").theta.numel() == 10
    with pytest.raises(ValueError, match="No code is run because a file names it"):
        implicit.load_field(path)


def test_a_case_that_was_read_from_a_file_does_not_run_the_code_that_it_names(ball):
    case = Case.from_json(a_case().to_json())
    assert isinstance(case.module, NameOfFile)
    for one in (case, replace(case, vertices=200), pickle.loads(pickle.dumps(case))):
        with pytest.raises(InputError, match=r"No code is run because a file names it.*dataclasses.replace"):
            run_case(one)
    assert not (ball / "was-run").exists()
    assert type(replace(case, module="nets.py:make").module) is str


def test_a_shape_without_its_module_is_refused_and_runs_nothing(ball):
    with pytest.raises(ValueError, match=r"--module nets.py:make"):
        run_case(replace(a_case(), module=None))
    assert not (ball / "was-run").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"module": "nets.py"}, "module must be"),
        ({"module": 3}, "module must be"),
        ({"shape": "spot"}, "module builds the network of a field's file"),
        ({"shape": "ball.obj"}, "module builds the network of a field's file"),
    ],
)
def test_a_module_that_makes_no_sense_is_refused_by_the_case(changes, message):
    with pytest.raises(ValueError, match=message):
        a_case(**changes)


@pytest.mark.nightly
def test_workers_get_the_module_too(ball):
    with executor_of(1, None) as executor:
        (record,) = run_cases([a_case()], executor, folder=ball / "run")
    assert not record.failed, record.status


def test_the_command_runs_what_it_names_and_nothing_else(ball, command):
    words = ("run", "ball.safetensors", "--quick", "--quiet", "-o", "out", "--operations", "smooth")
    ended = command(*words, cwd=ball)
    assert ended.returncode == 2
    assert "--module nets.py:make" in ended.stderr
    assert not (ball / "was-run").exists()
    assert not (ball / "out").exists()
    ended = command(*words, "--module", "nets.py:make", cwd=ball)
    assert ended.returncode == 0, ended.stderr
    (record,) = read(ball / "out")
    assert record.case.module == "nets.py:make"
    assert command("figures", "out", "--formats", "png", cwd=ball).returncode == 0
    assert command("report", "out", cwd=ball).returncode == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "spot", "--module", "nets.py:make"), "none of spot is a field whose file needs one"),
        (("run", "ball.safetensors", "--module", "nets.py:gone"), "defines no function gone"),
        (("run", "ball.safetensors", "--module", "nets"), "name of a function must be"),
        (("run", "ball.safetensors", "--module", "gone.py:make"), "there is no file gone.py"),
        (("run", "ball.safetensors", "--module", "nets.py:network"), "0.bias is missing|could not build"),
    ],
)
def test_a_module_that_does_not_build_the_field_is_refused_before_work(ball, command, words, message):
    ended = command(*words, "-o", "out", cwd=ball)
    assert ended.returncode == 2
    assert any(part in " ".join(ended.stderr.split()) for part in message.split("|")), ended.stderr
    assert not (ball / "out").exists()


@pytest.mark.nightly
def test_a_study_runs_code_that_the_call_names_and_not_its_files(ball):
    (ball / "own.toml").write_text(STUDY)
    study = find_study("own.toml")
    with pytest.raises(InputError, match=r"--module nets.py:make"):
        run_study(study, "out")
    assert not (ball / "was-run").exists()
    records = run_study(study, "out", module="nets.py:make")
    assert [record.failed for record in records] == [False]
    assert json.loads(Path("out/study.json").read_text())["cases"][0]["module"] == "nets.py:make"
    forgotten()
    with pytest.raises(InputError, match=r"--module nets.py:make"):
        run_study(study, "out")  # all of it is done, and still nothing is run
    assert not (ball / "was-run").exists()
    (ball / "other.py").write_text(NETS)
    with pytest.raises(InputError, match=r"built by nets.py:make, but other.py:make is named now"):
        run_study(study, "out", module="other.py:make")


@pytest.mark.parametrize("line", ['module = "nets.py:make"', 'settings.module = "nets.py:make"'])
def test_a_study_cannot_name_code_in_its_file(ball, line):
    text = STUDY.replace("keep_meshes", f"{line}\nkeep_meshes") if line.startswith("module") else STUDY
    text = text.replace("{ vertices", '{ module = "nets.py:make", vertices') if "settings" in line else text
    (ball / "own.toml").write_text(text)
    with pytest.raises(InputError, match="module"):
        run_study(find_study("own.toml"), "out")
    assert not (ball / "was-run").exists()


def test_a_study_cannot_name_code_to_fit(ball):
    V, F = implicit.extract_mesh(implicit.shapes.sphere(0.5), 16)
    meshref.write_mesh(ball / "ball.ply", V, F)
    text = STUDY.replace("ball.safetensors", "ball.ply").replace(
        "vertices =", '"fit.module" = "nets.py:make", vertices ='
    )
    (ball / "own.toml").write_text(text)
    with pytest.raises(InputError, match=r"fit.module does nothing"):
        run_study(find_study("own.toml"), "out")
    case = Case("ball.ply", "smooth", (), {"fit": {"module": "nets.py:make", "steps": 2}, "steps": 1}, 150, 16)
    with pytest.raises(TypeError, match="module must be a torch module to train"):
        run_case(case)
    assert not (ball / "was-run").exists()


@pytest.mark.nightly
def test_a_module_of_ones_own_is_fitted_to_a_mesh(monkeypatch):
    monkeypatch.setattr("compare.fitting.fit.ON_SURFACE", 12_000)
    monkeypatch.setattr("compare.fitting.fit.ABOUT_SURFACE", ((10_000, 0.01), (10_000, 0.05)))
    monkeypatch.setattr("compare.fitting.fit.IN_CUBE", 8_000)
    monkeypatch.setattr("compare.fitting.fit.RESOLUTION", 64)
    monkeypatch.setattr("compare.fitting.fit.QUADRATURE", 64)
    V, F = implicit.extract_mesh(implicit.shapes.torus(0.6, 0.25), 48)
    torch.manual_seed(0)
    module = nn.Sequential(nn.Linear(3, 32), nn.Softplus(20), nn.Linear(32, 32), nn.Softplus(20), nn.Linear(32, 1))
    before = [p.clone() for p in module.parameters()]
    field, report = fit_mesh(100 * V, F, module=module, steps=300, learning_rate=1e-2)
    assert report.mean_distance < 0.01
    assert report.components == 1
    assert report.parameters == sum(p.numel() for p in module.parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, module.parameters(), strict=True))
    assert field.units.scale == pytest.approx(100 * (V.max(axis=0) - V.min(axis=0)).max() / 1.6)
    further, _ = fit_mesh(100 * V, F, start=field, steps=1)
    assert (further.theta - field.theta).abs().max() < 0.1
    with pytest.raises(TypeError, match=r"must map points \(N, 3\)"):
        fit_mesh(V, F, module=nn.Linear(2, 1))


def test_the_command_fits_a_module_that_it_names_and_the_file_runs_nothing(ball, command):
    V, F = implicit.extract_mesh(implicit.shapes.sphere(0.5), 16)
    meshref.write_mesh(ball / "ball.ply", V, F)
    words = ("fit", "ball.ply", "-o", "own.safetensors", "--steps", "20", "--quiet", "--module")
    for name, message in (("nets.py:flat", "must map points"), ("nets.py:gone", "defines no function gone")):
        ended = command(*words, name, cwd=ball)
        assert ended.returncode == 2
        assert message in " ".join(ended.stderr.split())
    ended = command(*words, "nets.py:network", "--width", "64", cwd=ball)
    assert ended.returncode == 2
    assert "width must be left out where module brings the network" in " ".join(ended.stderr.split())
    assert not (ball / "own.safetensors").exists()
    ended = command(*words, "nets.py:network", cwd=ball)
    assert ended.returncode == 0, ended.stderr
    forgotten()
    with pytest.raises(ValueError, match="No code is run"):
        implicit.load_field(ball / "own.safetensors")
    assert not (ball / "was-run").exists()
    assert implicit.load_field(ball / "own.safetensors", module="nets.py:network").theta.numel() == 721


def test_the_page_on_networks_of_ones_own_runs(tmp_path):
    page = Path(__file__).resolve().parents[2] / "docs" / "own-networks.md"
    (snippet,) = re.findall(r"^```python\n(.*?)^```$", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    ended = subprocess.run([sys.executable, "-c", snippet], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "P = 721" in ended.stdout
