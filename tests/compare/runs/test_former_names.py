"""Cases and studies of before name options of the editors as these were called then."""

import numpy as np
import pytest

import implicit.shapes
import meshref
from compare import Case, HandleSpec
from compare.errors import InputError
from compare.operations.operation import operation_of
from compare.runs.subject import Subject
from compare.studies.plan import check_options
from compare.studies.study import find_study

BUMP = HandleSpec({"kind": "ball", "center": [0.5, 0, 0], "radius": 0.2}, {"kind": "along", "distance": 0.02})
SIZE = {"points": 60, "resolution": 16}


@pytest.mark.parametrize(
    ("operation", "former", "today"),
    [
        ("geometric", {"parts": 2}, {"steps": 2}),
        ("smooth", {"off": 0.5}, {"off_surface_strength": 0.5}),
    ],
)
def test_a_case_of_before_is_edited_as_one_of_today(operation, former, today):
    V, F = meshref.icosphere(1)
    subject = Subject(implicit.shapes.sphere(0.5), 0.5 * V, F, V)
    handles = () if operation == "smooth" else (BUMP,)
    outcomes = []
    for options in (former, today):
        parameters = {"steps": 1, "step_size": 1e-4, "implicit": {**SIZE, **options}}
        case = Case("ball", operation, handles, parameters)
        outcomes.append(operation_of(operation).edit_field(case, subject))
    np.testing.assert_array_equal(outcomes[0].displacement, outcomes[1].displacement)
    assert outcomes[0].details["steps"] == outcomes[1].details["steps"]


def test_a_study_takes_the_former_names_and_refuses_what_never_was_one(tmp_path):
    text = """
shapes = ["spot"]
operations = ["geometric", "smooth"]
[settings]
geometric.implicit.{name} = 2
smooth.implicit.off = 0.5
[grid]
vertices = [200, 400]
"""
    path = tmp_path / "study.toml"
    path.write_text(text.format(name="parts"))
    check_options(find_study(str(path)))
    path.write_text(text.format(name="pieces"))
    with pytest.raises(InputError, match=r"geometric\.implicit\.pieces does nothing"):
        check_options(find_study(str(path)))
