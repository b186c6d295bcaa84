"""Quasi-Newton directions: those of BFGS with a full matrix, downhill, and exact on quadratics."""

import numpy as np

from meshref.quasi_newton import QuasiNewton


def random_positive(rng, size):
    basis, _ = np.linalg.qr(rng.standard_normal((size, size)))
    return basis @ np.diag(np.geomspace(1e-3, 10, size)) @ basis.T


def test_a_quadratic_is_minimised_in_as_many_steps_as_unknowns(rng):
    """With the best length along each direction; along preconditioned gradients alone it is nowhere near."""
    size = 6
    H, P, b = random_positive(rng, size), np.diag([1.0, 2, 3, 1, 2, 3]), rng.standard_normal(size)
    exact = np.linalg.solve(H, b)

    def minimised(window):
        memory, x = QuasiNewton(window), np.zeros(size)
        for _ in range(size):
            gradient = H @ x - b
            direction = memory.direction(gradient, np.linalg.solve(P, gradient))
            assert gradient @ direction < 0
            step = -(gradient @ direction) / (direction @ H @ direction) * direction
            memory.learn(step, H @ step, np.linalg.solve(P, H @ step))
            if window == 0:
                memory.forget()
            x = x + step
        return x

    np.testing.assert_allclose(minimised(size), exact, rtol=1e-6, atol=1e-6 * np.abs(exact).max())
    assert np.abs(minimised(0) - exact).max() > 0.1 * np.abs(exact).max()


def test_the_direction_is_that_of_bfgs_with_a_full_matrix(rng):
    """H' = (I - s y^T / s.y) H (I - y s^T / s.y) + s s^T / s.y, from H = P^-1; oldest lessons are dropped."""
    size, window = 5, 3
    P, G = random_positive(rng, size), random_positive(rng, size)
    memory, lessons = QuasiNewton(window), []
    for _ in range(5):
        s = rng.standard_normal(size)
        memory.learn(s, G @ s, np.linalg.solve(P, G @ s))
        lessons.append((s, G @ s))
    inverse = np.linalg.inv(P)
    for s, y in lessons[-window:]:
        left = np.eye(size) - np.outer(s, y) / (s @ y)
        inverse = left @ inverse @ left.T + np.outer(s, s) / (s @ y)
    gradient = rng.standard_normal(size)
    np.testing.assert_allclose(memory.direction(gradient, np.linalg.solve(P, gradient)), -inverse @ gradient)


def test_nothing_is_learned_from_a_step_along_which_the_gradient_rises_the_wrong_way(rng):
    memory = QuasiNewton(4)
    s, gradient = rng.standard_normal((2, 4, 3))
    memory.learn(s, -s, -s)
    np.testing.assert_array_equal(memory.direction(gradient, 2 * gradient), -2 * gradient)
    memory.learn(s, 3 * s, 3 * s)
    assert (memory.direction(gradient, 2 * gradient) != -2 * gradient).any()
    memory.forget()
    np.testing.assert_array_equal(memory.direction(gradient, 2 * gradient), -2 * gradient)
