"""Directions that learn: a quadratic is minimised in as many steps as it has unknowns, and all go downhill."""

import numpy as np
import pytest

from implicit.step.preconditioned import Descent


def bowl(seed, n=6):
    """Return a positive definite matrix, and a diagonal one that is some way off from it."""
    generator = np.random.default_rng(seed)
    A = generator.normal(size=(n, n))
    A = A @ A.T + 0.1 * np.eye(n)
    return A, np.diag(A) * generator.uniform(0.5, 2, n), generator.normal(size=n)


@pytest.mark.parametrize("seed", range(3))
def test_a_quadratic_is_minimised_in_as_many_steps_as_it_has_unknowns(seed):
    """With exact line searches BFGS ends at the minimum of a quadratic after n steps, from any first matrix."""
    A, P, b = bowl(seed)
    x, memory = np.zeros(6), Descent(window=6)
    for _ in range(6):
        g = A @ x - b
        way = memory.direction(g, g / P)
        step = -(way @ g) / (way @ A @ way) * way
        memory.learn(step, A @ step, A @ step / P)
        x = x + step
    np.testing.assert_allclose(A @ x, b, atol=1e-7 * np.abs(b).max())


def test_the_first_direction_is_that_of_the_preconditioner_and_again_after_forgetting():
    A, P, b = bowl(0)
    memory = Descent(window=3)
    np.testing.assert_allclose(memory.direction(b, b / P), -b / P)
    memory.learn(b, A @ b, A @ b / P)
    assert np.abs(memory.direction(b, b / P) + b / P).max() > 1e-3
    # What it has learned it gives back: the step whose change of the gradient is asked for.
    np.testing.assert_allclose(memory.direction(A @ b, A @ b / P), -b, atol=1e-9)
    memory.forget()
    np.testing.assert_allclose(memory.direction(b, b / P), -b / P)


def test_no_step_that_curves_down_is_learned_from():
    _, P, b = bowl(1)
    memory = Descent(window=3)
    memory.learn(b, -b, -b / P)
    np.testing.assert_allclose(memory.direction(b, b / P), -b / P)
