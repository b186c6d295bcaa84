"""Arrays are held to their annotations in these tests, and a refusal is heard first."""

import dataclasses

import numpy as np
import pytest
import torch
from annotation_check import checked
from jaxtyping import Float, TypeCheckError, jaxtyped
from numpy import ndarray

import implicit
from implicit import shapes
from implicit.sensitivity.frame import Frame, axes_of


@jaxtyped(typechecker=checked)
def halves(values: Float[ndarray, " n"], weights: Float[ndarray, " n"], way: str = "right") -> Float[ndarray, " n"]:
    if way == "refuse":
        raise ValueError("way must be right or wrong.")
    return (values if way == "right" else values[1:]) / 2


def test_an_array_that_an_annotation_excludes_gets_no_answer():
    three, four = np.ones(3), np.ones(4)
    np.testing.assert_array_equal(halves(three, three), three / 2)
    for values, weights in ((three, four), (three[:, None], three), (np.ones(3, dtype=int), three), ([1.0], three)):
        with pytest.raises((TypeCheckError, TypeError)):
            halves(values, weights)


def test_an_answer_of_another_shape_is_found():
    with pytest.raises(TypeCheckError, match="halves"):
        halves(np.ones(3), np.ones(3), "wrong")


def test_a_refusal_is_heard_before_the_check():
    with pytest.raises(ValueError, match="way must be right"):
        halves(np.ones(3), np.ones(4), "refuse")


def test_the_packages_are_held_to_it():
    with pytest.raises(TypeCheckError, match="axes_of"):
        axes_of(torch.eye(2, dtype=torch.int64))
    at = Frame.at(shapes.sphere(), torch.eye(3, dtype=torch.float64))
    with pytest.raises(TypeCheckError, match="Frame"):
        dataclasses.replace(at, points=at.points[:2])


def test_users_meet_the_words_of_the_project():
    with pytest.raises(ValueError, match="points must be"):
        implicit.basis(shapes.sphere(), torch.ones(2, 3, dtype=torch.float32))
