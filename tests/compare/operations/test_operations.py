"""An operation is one object: a fourth one goes through cases, runs, records, tables, studies and reports by itself."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

import implicit
from compare import Case, default_cases, find_study, prepare_subject, report, run_cases
from compare.cases import registry
from compare.cases.registry import OPERATIONS
from compare.commands.shown import print_table
from compare.errors import InputError
from compare.operations import Operation, operation_of, operations, register
from compare.operations.operation import Column, Headline, Outcome, normal_part
from compare.reports.figures import draw_figures
from compare.reports.table import write_table
from compare.runs.columns import columns, error_label
from compare.runs.records import read
from compare.studies.plan import check_options, options_of

RADIUS, DISTANCE = 0.6, 0.06


class Swell(Operation):
    """Move a ball's surface outward; the mesh side, for something to be wrong, goes half the way."""

    name = "swell"
    takes_handles = False
    settings = ("distance",)
    full: Mapping[str, Any] = {"distance": DISTANCE}
    quick: Mapping[str, Any] = full
    error_means = "motion along the normal minus the distance"
    error_name = "lag"
    headline = Headline("lag_rms", "{} behind")
    columns = (Column("lag_rms", "lag", "rms of what is missing", brief=False),)

    def option_sources(self):
        return {"implicit": (self.edit_field,), "mesh": ()}

    def edit_field(self, case, subject, progress=None):
        if progress is not None:
            progress(1, 1, "swell, neural field")
        field = implicit.shapes.sphere(RADIUS + case.parameters["distance"]).to(torch.float64)
        return Outcome(case.parameters["distance"] * subject.N, "larger ball", "Done.", True, 0.5, field=field)

    def mesh_editors(self):
        return {"mesh": self._half}

    def error_field(self, subject, target, own, other):
        return normal_part(subject, own.displacement) - DISTANCE

    @staticmethod
    def _half(case, subject, target, progress):
        return Outcome(case.parameters["distance"] / 2 * subject.N, "half", "Only half was done.", False, 0.1)


@pytest.fixture(scope="module")
def swell():
    operation = Swell()
    register(operation)
    yield operation
    registry._RULES.pop("swell")


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("ball") / "ball.safetensors"
    implicit.save_field(implicit.shapes.sphere(RADIUS), path)
    return path


@pytest.fixture(scope="module")
def swollen(swell, ball, tmp_path_factory):
    """The run of a case of the fourth operation: its folder and record."""
    points = torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=1).numpy()
    (case,) = default_cases(
        str(ball), RADIUS * points, points, operations=["swell"], quick=True, vertices=300, resolution=24
    )
    folder = tmp_path_factory.mktemp("swollen")
    (record,) = run_cases([case], folder=folder)
    assert not record.failed, record.status
    return folder, record


def test_a_fourth_operation_runs_and_has_the_numbers_of_the_formula(swollen):
    """A ball of radius r + d: volume (1 + d / r)^3 of the field itself; the mesh lags by d / 2 everywhere."""
    _, record = swollen
    neural, mesh = record.sides["implicit"], record.sides["mesh"]
    assert neural["volume_drift"] == pytest.approx(1.1**3 - 1, rel=1e-4)
    assert neural["lag_max"] < 1e-12
    assert mesh["lag_mean"] == pytest.approx(-DISTANCE / 2, rel=1e-12)
    assert mesh["lag_rms"] == pytest.approx(DISTANCE / 2, rel=1e-12)
    assert not {"error_rms", "strain_rms", "handle_error_rms"} & set(mesh)
    assert "ball, swell, mesh: Only half was done." in record.notes
    assert error_label(record) == "motion along the normal minus the distance, in the shape's unit of length"


def test_its_record_comes_back_from_its_row(swollen):
    folder, record = swollen
    assert read(folder) == [record]
    assert read(folder)[0].case.key == record.key


def test_it_is_in_tables_pictures_and_the_report(swollen, tmp_path, capsys):
    folder, record = swollen
    page = report([record], tmp_path / "report.html", folder=folder).read_text(encoding="utf-8")
    assert "<h2>ball: swell</h2>" in page
    assert ">lag<small>" in page
    print_table([record])
    assert "swell" in capsys.readouterr().out
    (picture,) = draw_figures([record], folder, output=tmp_path, formats=["svg"], painter="matplotlib")
    assert picture.is_file()


def test_a_study_varies_its_settings_and_refuses_others(swollen, ball, tmp_path):
    _, record = swollen
    path = tmp_path / "swelling.toml"
    text = f"""shapes = ["{ball}"]
operations = ["swell"]
[grid]
distance = [0.03, 0.06]
[[charts]]
x = "distance"
y = "lag_rms"
"""
    path.write_text(text)
    study = find_study(str(path))
    check_options(study)
    write_table([record], tmp_path / "table.csv", study.varied)
    assert "0.06" in (tmp_path / "table.csv").read_text()
    path.write_text(text.replace("distance", "step_size"))
    with pytest.raises(
        InputError, match=r"step_size does nothing in a swell edit, which takes distance, resolution, seed"
    ):
        check_options(find_study(str(path)))


def test_a_name_of_no_operation_is_refused():
    with pytest.raises(ValueError, match="operation must be one of geometric, smooth, rigid"):
        Case("spot", "swell-not")
    with pytest.raises(ValueError, match="operation must be one of geometric, smooth, rigid"):
        operation_of("swell-not")


def test_an_operation_needs_a_name_of_its_own_and_every_part():
    class Second(Swell):
        name = "rigid"

    class AsASetting(Swell):
        name = "vertices"

    class WithoutEditor(Operation):
        name = "nothing"

    with pytest.raises(ValueError, match="There is an operation 'rigid' already"):
        register(Second())
    with pytest.raises(ValueError, match="names no setting, but is 'vertices'"):
        register(AsASetting())
    with pytest.raises(TypeError, match="edit_field"):
        WithoutEditor()


def test_default_settings_are_options_that_the_editors_take():
    for operation in (operation_of(name) for name in ("geometric", "smooth", "rigid")):
        for parameters in (operation.full, operation.quick):
            assert set(parameters) - {"implicit", "mesh"} == set(operation.settings)
            for side in ("implicit", "mesh"):
                assert set(parameters.get(side, {})) <= options_of(side, operation.name)


def test_every_headline_is_a_column_and_every_error_has_a_meaning():
    names = [column.name for column in columns()]
    assert len(names) == len(set(names))
    for operation in operations():
        assert operation.headline.column in names
        assert "{}" in operation.headline.words
        assert operation.error_means


def test_the_order_of_the_operations_is_that_of_the_tables():
    assert list(OPERATIONS)[:3] == ["geometric", "smooth", "rigid"]
    names = [column.name for column in columns()]
    assert names[:7] == [
        "killing_energy",
        "volume_drift",
        "area_drift",
        "handle_error_relative",
        "error_relative",
        "flow_error_relative",
        "strain_rms",
    ]


def test_handles_are_only_found_for_operations_that_take_them():
    V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 0.5]])
    for operation in operations():
        assert bool(operation.default_handles(V, V)) == operation.takes_handles


@pytest.mark.parametrize(("own", "taken"), [({}, "linear"), ({"method": "finite"}, "finite")], ids=["default", "named"])
def test_rigid_steps_are_linear_unless_the_case_names_a_method(ball, own, taken, monkeypatch):
    asked = {}

    def refuse(*_, **options):
        asked.update(options)
        raise RuntimeError("seen")

    monkeypatch.setattr(implicit, "rigid_edit", refuse)
    subject = prepare_subject(Case(str(ball), "smooth", vertices=150, resolution=16))
    (case,) = default_cases(str(ball), subject.V, subject.N, operations=("rigid",), quick=True)
    case = replace(case, parameters={"implicit": {**case.parameters["implicit"], **own}})
    with pytest.raises(RuntimeError, match="seen"):
        operation_of("rigid").edit_field(case, subject)
    assert asked["method"] == taken
    assert asked["points"] == case.parameters["implicit"]["points"]
