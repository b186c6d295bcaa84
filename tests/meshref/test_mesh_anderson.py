"""Anderson's acceleration: exact on linear iterations after as many steps as they have unknowns."""

import numpy as np
import pytest

from meshref.anderson import Anderson


def iterated(G, x, steps, window):
    acceleration = Anderson(window)
    for _ in range(steps):
        x = acceleration.combined(x, G(x))
    return x


def test_a_linear_iteration_ends_after_as_many_steps_as_unknowns(rng):
    """x = A x + b with eigenvalues up to 0.999, which 1000 plain steps do not bring home."""
    basis, _ = np.linalg.qr(rng.standard_normal((4, 4)))
    A, b = basis @ np.diag([0.999, 0.9, -0.5, 0.2]) @ basis.T, rng.standard_normal(4)
    exact = np.linalg.solve(np.eye(4) - A, b)
    found = iterated(lambda x: A @ x + b, np.zeros(4), 7, window=6)
    np.testing.assert_allclose(found, exact, atol=1e-6 * np.abs(exact).max())
    plain = np.zeros(4)
    for _ in range(1000):
        plain = A @ plain + b
    assert np.abs(plain - exact).max() > 0.1 * np.abs(exact).max()


def test_the_first_step_and_a_fixed_point_are_plain():
    acceleration = Anderson(3)
    np.testing.assert_array_equal(acceleration.combined(np.zeros((2, 3)), np.ones((2, 3))), np.ones((2, 3)))
    for _ in range(3):
        np.testing.assert_array_equal(acceleration.combined(np.ones((2, 3)), np.ones((2, 3))), np.ones((2, 3)))


def test_what_is_forgotten_does_not_count(rng):
    acceleration = Anderson(3)
    for _ in range(4):
        acceleration.combined(rng.standard_normal(5), rng.standard_normal(5))
    acceleration.forget()
    image = rng.standard_normal(5)
    np.testing.assert_array_equal(acceleration.combined(rng.standard_normal(5), image), image)


def test_arguments_stay_as_they_are(rng):
    acceleration = Anderson(2)
    x, image = rng.standard_normal((2, 4, 3))
    kept = x.copy(), image.copy()
    for _ in range(3):
        acceleration.combined(x, image)
        assert (x == kept[0]).all()
        assert (image == kept[1]).all()
    assert acceleration.combined(x, image) == pytest.approx(image)
