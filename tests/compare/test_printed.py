"""What is printed of a case, a handle, a subject, a study and a fit is a line or two, without dumps of arrays."""

import dataclasses
import inspect

import compare
import implicit.shapes
import meshref
from compare import Case, FitReport, HandleSpec, Study, Subject


def test_the_package_lists_all_that_it_offers():
    assert set(compare.__all__) <= set(dir(compare))


def test_help_names_the_falloff_of_every_region():
    for region in (implicit.Ball, implicit.Box, implicit.HalfSpace, implicit.NearPoints):
        assert "falloff: Length" in inspect.getdoc(region)


UP = HandleSpec({"kind": "ball", "center": [0, 0, 1], "radius": 0.3}, {"kind": "along", "distance": 0.1})


def test_a_case_and_a_handle_are_a_line_each():
    assert repr(UP) == "HandleSpec(ball center=[0, 0, 1] radius=0.3; along distance=0.1)"
    case = Case("shapes/spot.obj", "rigid", (UP,), {"implicit": {"steps": 3}})
    assert repr(case) == (
        "Case(shapes/spot.obj, rigid, 1 handle, vertices=4000, resolution=96, seed=0, implicit={'steps': 3})"
    )
    assert repr(Case("spot", "smooth")) == "Case(spot, smooth, vertices=4000, resolution=96, seed=0)"


def test_a_subject_is_a_line_with_its_sizes():
    V, F = meshref.icosphere(2)
    subject = Subject(implicit.shapes.sphere(), V, F, V, fit={"good": False})
    assert repr(subject).endswith(
        f"common mesh of {len(V)} vertices and {len(F)} faces, scale 1, fit below the stated quality, 0 notes)"
    )


def test_a_study_is_a_line_with_its_grid():
    study = Study("damping", "", ("spot",), ("rigid",), {"implicit.damping": (0.1, 0.2)})
    assert repr(study) == "Study(damping: rigid of spot; implicit.damping in [0.1, 0.2])"


def test_a_fit_is_its_verdict_and_the_numbers_that_matter():
    numbers = {field.name: 0.001 for field in dataclasses.fields(FitReport)}
    report = FitReport(**{**numbers, "verdict": "Good.", "parameters": 2273, "steps": 600, "seconds": 3.0})
    assert repr(report).splitlines() == [
        "FitReport(Good.",
        "  mean distance 0.100% of the diagonal, volume +0.10%, normals 0.0 degrees, 2273 parameters, 600 steps, 3 s)",
    ]
