"""Every object that a user meets prints as a few readable lines, never as a dump of numbers."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch

import implicit
from implicit import families, shapes
from implicit.families.samples import draw_samples
from implicit.fitting.fit import Progress
from implicit.surface.quadrature import meshed_quadrature

BALL = shapes.sphere(0.5)
SIREN = implicit.Field(implicit.Siren(3, 32, 3), units=implicit.Units(2.5, (1.0, 0.0, 0.0)))
SAMPLE = implicit.surface_quadrature(BALL, 16)
FLAT = implicit.surface_quadrature(shapes.circle(0.5), 16)


def code_field():
    return implicit.decoder_field(lambda points, code: points.norm(dim=1) - code[0], torch.full((3,), 0.5))


def family_model():
    decoder = implicit.models.DeepSdf(4, 16, 2, 1)
    report = {"validation": {"shapes": 8, "mean_iou": 0.98765, "least_iou": 0.9}}
    return families.FamilyModel(families.CHAIRS, decoder, torch.zeros(400, 4), torch.zeros(400, 8), None, report)


def density(points):
    return points[:, 0]


TRAINING = implicit.Training(
    4000, 29.83, tuple(Progress(k, 0.1 * k, 1e-3) for k in range(100)), 1.2345e-3, 1.51, 0.02, implicit.FitStatus.DONE
)
BUMPY = implicit.Topology(40, 78, tuple(1.0 / (k + 1) for k in range(40)))

# What is printed, and what a reader must find in it.
OBJECTS = {
    "field": (lambda: SIREN, ["Siren", "P = 2,273", "float32, cpu", "[-1.0, -1.0, -1.0] to [1.0, 1.0, 1.0]", "2.5 x"]),
    "analytic field": (lambda: BALL, ["Sphere", "P = 4", "float64, cpu", "inside below level 0"]),
    "field of a code": (code_field, ["a function", "P = 3 (a code)"]),
    "plane field": (lambda: shapes.circle(), ["2 coordinates"]),
    "module of a field": (lambda: shapes.bracket().module, ["SmoothDifference(4 bodies: SmoothUnion, Cylinder"]),
    "module of a shape": (lambda: shapes.torus(0.5, 0.1).module, ["Torus(R=0.5, r=0.1)"]),
    "sample": (lambda: SAMPLE, [f"{len(SAMPLE):,} points in 3D", "area 3.14", "float64, cpu"]),
    "sample of a curve": (lambda: FLAT, ["in 2D", "length 3.14"]),
    "meshed sample": (lambda: meshed_quadrature(BALL, 16), ["triangles on", "vertices", "area 3.14"]),
    "soundness": (lambda: implicit.field_soundness(BALL, 16), ["1 piece,", "Euler number 2", "1, 1, 1 (1st"]),
    "topology": (lambda: BUMPY, ["40 components", "Euler number 78", "areas 1, 0.5, 0.3333, ..."]),
    "training": (lambda: TRAINING, ["DONE after 4,000 steps, 29.8 s", "0.00123", "1.51 degrees"]),
    "family": (lambda: families.CHAIRS, ["chairs", "parameters (seat"]),
    "family model": (family_model, ["chairs by DeepSdf", "400 codes of 4 numbers", "IoU 0.988"]),
    "family samples": (
        lambda: draw_samples(families.CHAIRS, families.CHAIRS.draw(2), 30),
        ["30 points for each of 2 shapes"],
    ),
    "basis function": (lambda: implicit.basis_function(SIREN, 0), ["layers.0.weight[0, 0]", "theta[0] of P = 2,273"]),
    "surface modes": (
        lambda: implicit.surface_modes(BALL, SAMPLE, 4),
        ["4 directions of P = 4", f"{len(SAMPLE):,} points"],
    ),
    "volume": (lambda: implicit.Volume(), ["Volume()"]),
    "bounded area": (lambda: implicit.Area(2.0, "at most"), ["Area(target=2, bound='at most')"]),
    "volume integral": (lambda: implicit.VolumeIntegral(density), ["VolumeIntegral(density)"]),
    "surface integral": (lambda: implicit.SurfaceIntegral(torch.linalg.norm), ["SurfaceIntegral(linalg_norm)"]),
    "integral": (lambda: implicit.Integral(0.5, 1e-6), ["0.5", "1e-06"]),
    "units": (lambda: implicit.Units(2.0, (1.0, 0.0, 0.0)), ["scale=2.0"]),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_prints_as_a_few_readable_lines(name):
    make, facts = OBJECTS[name]
    text = repr(make())
    assert len(text.splitlines()) <= 5
    assert len(text) <= 400
    assert "tensor(" not in text
    assert " at 0x" not in text
    for fact in facts:
        assert fact in text, text


def test_what_is_printed_is_what_the_object_holds():
    """The numbers follow the object: another sample, another text."""
    half = implicit.SurfaceSample(SAMPLE.points, SAMPLE.normals, SAMPLE.weights / 2)
    assert f"area {float(SAMPLE.weights.sum()) / 2:.6g}" in repr(half)
    assert "float32, cpu" in repr(SAMPLE.to(torch.float32))
    assert "above level 0.5" in repr(implicit.Field(shapes.sphere(0.5).module, level=0.5, inside="positive"))
    moved = implicit.Field(shapes.sphere(0.25).module)
    assert "radius=0.25" in repr(moved.module)


def test_a_notebook_shows_a_field_as_a_table_in_which_nothing_is_markup_of_the_users():
    html = SIREN._repr_html_()
    assert html.count("<tr>") == 6
    assert "<td>Siren of 3 coordinates</td>" in html
    evil = type("<script>", (torch.nn.Module,), {"forward": lambda self, x: x.norm(dim=1) * self.a})()
    evil.a = torch.nn.Parameter(torch.ones(()))
    assert "<script>" not in implicit.Field(evil)._repr_html_()


def test_a_notebook_shows_an_edit_as_a_table_of_what_it_came_to():
    bump = implicit.Handle(implicit.Ball((0.5, 0.0, 0.0), 0.1, falloff=0.3), implicit.Along(0.02))
    edit = implicit.geometric_edit(BALL, bump, rest="free", steps=1, points=60, resolution=16)
    edit = dataclasses.replace(edit, notes=("a <b> of the user's",))
    html = edit._repr_html_()
    assert f"{edit.status.name}: {edit.status.value}" in html
    assert "60 points in 3D" in html
    assert f"moved by {float(edit.displacement.norm(dim=1).max()):.3g} at most" in html
    assert "1 before, 1 after" in html
    assert "a &lt;b&gt; of the user&#x27;s" in html
    assert len(repr(edit).splitlines()) == 2
    assert "tensor(" not in repr(edit)


def test_functionals_print_by_value_and_stay_equal_by_it():
    assert implicit.Volume() == implicit.Volume()
    assert hash(implicit.Area(1.0)) == hash(implicit.Area(1.0))
    assert repr(implicit.Volume(0.25)) == "Volume(target=0.25)"
    callable_object = SimpleNamespace()
    with pytest.raises(TypeError, match="h must be a function"):
        implicit.VolumeIntegral(callable_object)
