"""Options under their former names."""

import inspect

import pytest
import torch

import implicit
from implicit import Along, Ball, Handle, expressibility, geometric_edit, prescribe, semantic_edit, shapes, smooth
from implicit.renamed import current_names, former_names

BALL = shapes.sphere(0.5)
HANDLE = Handle(Ball((0.5, 0, 0), 0.3, falloff=0.1), Along(0.02))
START = prescribe(BALL, HANDLE, 10, resolution=16)

CALLS = {
    "geometric_edit": ("parts", "steps", 2, lambda o: geometric_edit(BALL, HANDLE, points=60, resolution=16, **o)),
    "expressibility": ("parts", "steps", 3, lambda o: expressibility(BALL, HANDLE, points=60, **o)),
    "semantic_edit": ("least_cosine", "least_alignment", 0.25, lambda o: semantic_edit(BALL, *START, steps=1, **o)),
    "smooth": (
        "off", "off_surface_strength", 1.0,
        lambda o: smooth(BALL, steps=1, step_size=1e-4, points=60, resolution=16, **o),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_a_former_name_warns_of_the_new_one_and_does_the_same(name):
    old, new, value, call = CALLS[name]
    with pytest.warns(DeprecationWarning, match=rf"{name}\({old}=\.\.\.\) is now {name}\({new}=\.\.\.\)") as seen:
        former = call({old: value})
    assert seen[0].filename == __file__
    now = call({new: value})
    if name == "expressibility":
        assert former.steps == now.steps == value
        assert torch.equal(former.error, now.error)
    else:
        assert torch.equal(former.field.theta, now.field.theta)
        assert len(former.history) == len(now.history)


@pytest.mark.parametrize("name", CALLS)
def test_an_option_under_both_names_is_refused(name):
    old, new, value, call = CALLS[name]
    message = f"{old} is the former name of {new}, but both are given"
    with pytest.raises(TypeError, match=message):
        call({old: value, new: value})


@pytest.mark.parametrize("name", CALLS)
def test_the_signature_has_the_new_name_alone(name):
    old, new, *_ = CALLS[name]
    function = getattr(implicit, name)
    parameters = inspect.signature(function).parameters
    assert new in parameters
    assert old not in parameters
    assert former_names(function) == {old: new}


def test_names_of_a_file_of_before_become_those_of_today():
    assert current_names(geometric_edit, {"parts": 4, "points": 9}) == {"steps": 4, "points": 9}
    assert current_names(implicit.rigid_edit, {"steps": 4}) == {"steps": 4}


def test_the_steps_of_a_prediction_have_their_former_name():
    found = expressibility(BALL, HANDLE, steps=3, points=60)
    with pytest.warns(DeprecationWarning, match=r"Expressibility\.steps"):
        assert found.parts == 3
