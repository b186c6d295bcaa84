"""Studies: the grid, what is refused before any work, what a folder keeps, the table and the curves."""

import csv
import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import implicit
import implicit.shapes
import meshref
from compare import Case, Record, find_study, run_study
from compare.cases.labels import labels
from compare.cases.settings import setting_of
from compare.errors import InputError
from compare.reports.table import write_table
from compare.runs.lock import lock
from compare.runs.records import FILE, read
from compare.studies.curves import Point, curves, draw_charts
from compare.studies.plan import check_options, combinations, plan
from compare.studies.study import Chart, Study, built_in, parse_study
from compare.studies.study_folder import STUDY_FILE, require_folder_of

CHEAP = """
title = "A cheap study"
shapes = ["ball.safetensors"]
operations = ["rigid"]
[settings]
vertices = 150
resolution = 16
implicit.points = 60
[grid]
implicit.steps = [1]
[[charts]]
x = "implicit.steps"
y = "seconds"
"""


@pytest.fixture
def ball(tmp_path):
    """A folder with a field in a file."""
    implicit.save_field(implicit.shapes.sphere(0.6), tmp_path / "ball.safetensors")
    return tmp_path


def write(folder, text):
    path = folder / "cheap.toml"
    path.write_text(text)
    return str(path)


# The grid


@pytest.mark.parametrize("quick", [False, True], ids=["full", "quick"])
@pytest.mark.parametrize("name", sorted(built_in()))
def test_a_built_in_study_sets_only_what_its_editors_take(name, quick):
    study = find_study(name, quick=quick)
    check_options(study)
    assert study.title
    assert study.charts
    assert len(list(combinations(study))) * len(study.shapes) * len(study.operations) >= (2 if quick else 5)


def test_the_grid_is_every_combination_and_tables_vary_together(ball):
    text = """
shapes = ["ball.safetensors"]
operations = ["smooth"]
[settings]
implicit.points = 50
[grid]
seed = [3, 4]
flow = [{steps = 1, step_size = 2e-3}, {steps = 2, step_size = 1e-3}]
"""
    study = find_study(write(ball, text))
    assert study.varied == ["seed", "steps", "step_size"]
    cases = plan(study, ball)
    names = ("seed", "steps", "step_size", "implicit.points")
    assert [tuple(setting_of(case, name) for name in names) for case in cases] == [
        (3, 1, 2e-3, 50),
        (3, 2, 1e-3, 50),
        (4, 1, 2e-3, 50),
        (4, 2, 1e-3, 50),
    ]
    assert len({case.key for case in cases}) == 4


def test_handles_are_the_same_at_every_setting_and_settings_go_to_their_operation(ball):
    text = """
shapes = ["ball.safetensors"]
operations = ["rigid", "geometric"]
[settings]
geometric.implicit.parts = 2
rigid.implicit.steps = 5
[grid]
vertices = [200, 400]
resolution = [16, 32]
"""
    cases = plan(find_study(write(ball, text)), ball)
    assert len(cases) == 8
    for operation, option in (("geometric", {"parts": 2}), ("rigid", {"steps": 5})):
        of = [case for case in cases if case.operation == operation]
        assert len({json.dumps(case.to_dict()["handles"]) for case in of}) == 1
        assert all(option.items() <= case.parameters["implicit"].items() for case in of)
    assert not any("parts" in case.parameters["implicit"] for case in cases if case.operation == "rigid")


def test_a_study_says_which_body_of_a_mesh_it_is_about(tmp_path):
    V, F = meshref.icosphere(2)
    meshref.write_mesh(tmp_path / "two.off", np.concatenate([V, V / 2 + 5]), np.concatenate([F, F + len(V)]))
    text = 'shapes = ["two.off"]\noperations = ["rigid"]\n[settings]\n{}\n[grid]\nvertices = [200]\n'
    with pytest.raises(InputError, match=r"--bodies largest \(in a case, bodies of its fit"):
        plan(find_study(write(tmp_path, text.format(""))), tmp_path)
    (case,) = plan(find_study(write(tmp_path, text.format('fit.bodies = "largest"'))), tmp_path)
    assert case.parameters["fit"]["bodies"] == "largest"


def test_a_study_of_networks_fits_them_to_the_surface_of_a_bundled_shape(tmp_path):
    study = dataclasses.replace(find_study("width", quick=True), shapes=("cactus",))
    cases = plan(study, tmp_path)
    assert {case.shape for case in cases} == {str(tmp_path / "cactus.ply")}
    assert [setting_of(case, "fit.width") for case in cases] == list(study.grid["fit.width"])
    assert len({case.subject_key for case in cases}) == len(cases)


def test_a_study_comes_back_from_json():
    for study in built_in().values():
        assert Study.from_dict(json.loads(json.dumps(study.to_dict()))) == study


# What is refused


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[grid]", "[gird]", "no key gird in .*Did you mean grid"),
        ("[grid]", "[[grid", "is no TOML"),
        ('"rigid"', '"rigit"', "but is 'rigit'. Did you mean rigid"),
        ('["rigid"]', '"rigid"', "must have operations, a list of names"),
        ("vertices", "verticse", "no setting verticse .*Did you mean vertices"),
        ("implicit.points", "implicit.point", "does nothing in a rigid edit.*Did you mean implicit.points"),
        ("implicit.points", "steps", "The setting steps does nothing in a rigid edit"),
        ("implicit.points", "smooth.steps", "for an operation that it does not name"),
        ("implicit.points", "implicit.steps", "implicit.steps is set in two places"),
        ("implicit.points", "fit.width", "ball.safetensors is one already"),
        ("[1]", "1", "must be a list of values, but is 1"),
        ("[1]", "[1, 1]", "names a value twice"),
        ("[1]", "[{a = 1}, 2]", "must all set the same settings"),
        ('y = "seconds"', 'y = "second"', "y of a chart .*Did you mean seconds"),
        ('y = "seconds"', 'z = "seconds"', "no key z in a chart"),
        ('y = "seconds"', "", "needs x and y, but has x"),
        ("vertices = 150", "vertices = 15", "vertices must be a whole number, at least 100"),
        ("ball.safetensors", "bal.safetensors", "There is no file"),
        ("= 60", "= inf", "must be a word, a finite number or a list, but is inf"),
        ("= 60", "= 2020-01-01", "must be a word, a finite number or a list, but is 2020-01-01"),
        ("= [1]", "= [1, nan]", "must be a word, a finite number or a list, but is nan"),
        ("[grid]\nimplicit.steps = [1]", "", "x of a chart .* is 'implicit.steps'"),
    ],
)
def test_what_makes_no_study_is_refused_before_any_work(old, new, message, ball):
    path = write(ball, CHEAP.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        run_study(path, ball / "out")
    assert not (ball / "out").exists()


def test_a_name_that_is_nearly_that_of_a_study_is_told(tmp_path):
    with pytest.raises(InputError, match="Did you mean resolution"):
        find_study("resolutoin")


# The folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A study of one case, done."""
    folder = tmp_path_factory.mktemp("study")
    implicit.save_field(implicit.shapes.sphere(0.6), folder / "ball.safetensors")
    path = write(folder, CHEAP)
    return folder, path, run_study(path, folder / "out")


def test_a_study_leaves_its_settings_rows_table_chart_and_report(finished):
    folder, path, records = finished
    out = folder / "out"
    assert [record.failed for record in records] == [False]
    assert read(out) == records
    assert {"study.json", FILE, "table.csv", "chart.png", "chart.pdf", "report.html", "meshes"} <= {
        file.name for file in out.iterdir()
    }
    assert Study.from_dict(json.loads((out / STUDY_FILE).read_text())["study"]) == find_study(path)
    assert not (out / "running").exists()


def test_what_is_done_is_not_done_again_and_another_study_is_refused(finished):
    folder, path, records = finished
    told = []
    assert run_study(path, folder / "out", on_record=told.append) == records
    assert told == []
    other = folder / "other.toml"
    other.write_text(Path(path).read_text().replace("implicit.points = 60", "implicit.points = 61"))
    with pytest.raises(InputError, match=r"another study: .*"):
        run_study(str(other), folder / "out")
    renamed = dataclasses.replace(find_study(path), settings={**find_study(path).settings, "vertices": 151})
    with pytest.raises(InputError, match=r"settings\.vertices was 150, and is 151 now"):
        run_study(renamed, folder / "out")


def test_a_shape_that_has_changed_is_noticed(finished):
    folder, path, _ = finished
    field = folder / "ball.safetensors"
    before = field.read_bytes()
    try:
        implicit.save_field(implicit.shapes.sphere(0.5), field)
        with pytest.raises(InputError, match="has changed since the study"):
            run_study(path, folder / "out")
    finally:
        field.write_bytes(before)


def test_a_folder_of_other_things_is_refused_but_not_that_of_a_study_killed_at_its_beginning(ball):
    study = find_study(write(ball, CHEAP))
    with pytest.raises(InputError, match="not empty and holds no study"):
        require_folder_of(study, ball)
    (ball / "out" / "inputs").mkdir(parents=True)
    for name in ("running", ".study.json.123.part"):
        (ball / "out" / name).touch()
    require_folder_of(study, ball / "out")


def test_a_folder_in_use_is_refused_until_its_process_is_gone(tmp_path):
    """Even if it is killed, and leaves its file behind."""
    program = (
        "import sys, time; from pathlib import Path; from compare.runs.lock import lock\n"
        "with lock(Path(sys.argv[1])): print('locked', flush=True); time.sleep(1000)\n"
    )
    holder = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=f"in use by another run, process {holder.pid}"), lock(tmp_path):
            pass
    finally:
        holder.send_signal(signal.SIGKILL)
        holder.communicate()
    assert (tmp_path / "running").exists()
    with lock(tmp_path):
        assert (tmp_path / "running").read_text() == str(os.getpid())
    assert not (tmp_path / "running").exists()


# The table and the curves


def test_cases_are_told_apart_by_the_settings_in_which_they_differ():
    few, many, other = (
        Case("spot", "smooth", parameters={"steps": 1, "implicit": {"points": points}}, seed=seed)
        for points, seed in ((50, 0), (60, 0), (50, 1))
    )
    assert labels([few, many, other]) == [
        "implicit.points 50, seed 0",
        "implicit.points 60, seed 0",
        "implicit.points 50, seed 1",
    ]
    assert labels([few, dataclasses.replace(few, shape="cactus")]) == ["", ""]


STUDY = parse_study(
    """
shapes = ["spot"]
operations = ["smooth"]
[grid]
vertices = [100, 200, 400, 800]
seed = [0, 1]
""",
    "made-up",
    Path(),
)


def made_up(case):
    """Records with an energy of 3 + 100 / vertices, and a failure."""
    side = {"method": "a", "complete": True, "status": "Done.", "seconds": case.vertices / 100}
    sides = {"mesh": {**side, "killing_energy": 3 + 100 / case.vertices}}
    failed = case.vertices == 200 and case.seed == 1
    return Record(case, case.key, "Failed. So." if failed else "Done.", failed, sides={} if failed else sides)


@pytest.fixture
def records():
    return [
        made_up(Case("spot", "smooth", vertices=point["vertices"], seed=point["seed"])) for point in combinations(STUDY)
    ]


def test_the_table_has_a_line_for_each_method_and_each_failure(records, tmp_path):
    write_table(records, tmp_path / "table.csv", STUDY.varied)
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert len(rows) == 8
    assert [row["vertices"] for row in rows] == ["100", "100", "200", "200", "400", "400", "800", "800"]
    assert float(rows[0]["killing_energy"]) == 4.0
    assert rows[3]["status"] == "Failed. So."
    assert rows[3]["killing_energy"] == ""


def test_a_curve_follows_one_axis_and_leaves_out_what_failed(records):
    found = curves(STUDY, records, Chart("seconds", "killing_energy"))
    assert found[("spot", "smooth", "mesh", "seed 0")] == [(1, 4.0), (2, 3.5), (4, 3.25), (8, 3.125)]
    assert [x for x, _ in found[("spot", "smooth", "mesh", "seed 1")]] == [1, 4, 8]


def test_against_last_is_the_relative_difference_to_the_finest(records):
    chart = Chart("vertices", "killing_energy", against_last=True)
    (x, first), *rest = curves(STUDY, records, chart)[("spot", "smooth", "mesh", "seed 0")]
    assert x == 100
    assert math.isclose(first, 0.875 / 3.125)
    assert [x for x, _ in rest] == [200, 400]
    without_last = [record for record in records if record.case.vertices < 800]
    assert curves(STUDY, without_last, chart) == {}, "another than the finest was taken for it"


def test_the_chart_is_a_picture_and_a_page(records, tmp_path):
    study = dataclasses.replace(STUDY, charts=(Chart("vertices", "killing_energy", True), Chart("seconds", "seconds")))
    draw_charts(study, records, tmp_path / "chart")
    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "chart.pdf").read_bytes().startswith(b"%PDF")
    assert Point(records[0], "mesh").value("seed") == 0
