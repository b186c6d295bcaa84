"""Mean curvature and Laplacian against closed forms and libigl."""

import igl
import numpy as np
import pytest

from meshref import MeshError, area, cotangent_laplacian, icosphere, mass_matrix, mean_curvature, torus


@pytest.mark.parametrize("radius", [0.1, 1.0, 30.0])
def test_kappa_is_two_over_r_on_a_sphere(radius):
    V, F = icosphere(4, radius, center=(1, 2, 3))
    np.testing.assert_allclose(mean_curvature(V, F), 2 / radius, rtol=5e-4)
    np.testing.assert_allclose(mean_curvature(V, F[:, ::-1]), -2 / radius, rtol=5e-4)


def test_curvature_of_a_torus_converges_with_order_two():
    """kappa = 1 / r + cos v / (R + r cos v) at the angle v round the tube."""
    error = []
    for k in (1, 2, 4):
        around, across = 40 * k, 16 * k
        v = 2 * np.pi * np.tile(np.arange(across), around) / across
        exact = 1 / 0.4 + np.cos(v) / (1 + 0.4 * np.cos(v))
        error.append(np.abs(mean_curvature(*torus(around, across, 1.0, 0.4)) - exact).max())
    orders = np.log2(np.divide(error[:-1], error[1:]))
    np.testing.assert_allclose(orders, 2, atol=0.1)


def test_the_curvature_of_a_boundary_is_not_a_number():
    V, F = icosphere(3)
    kappa = mean_curvature(V, F[1:])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(kappa)), np.sort(F[0]))


def test_the_laplacian_is_minus_that_of_libigl():
    V, F = torus(20, 11)
    difference = cotangent_laplacian(V, F) + igl.cotmatrix(V, F)
    assert abs(difference).max() < 1e-12


def test_the_laplacian_is_the_energy_of_the_gradient(rng):
    """u^T L u = sum of A |grad u|^2, and constants cost nothing."""
    V, F = icosphere(2)
    u = rng.standard_normal(len(V))
    L = cotangent_laplacian(V, F)
    gradient = (igl.grad(V, F) @ u).reshape(3, -1).T
    energy = (igl.doublearea(V, F).ravel() / 2) @ (gradient**2).sum(axis=1)
    assert u @ (L @ u) == pytest.approx(energy, rel=1e-12)
    assert np.abs(L @ np.ones(len(V))).max() < 1e-13
    assert np.linalg.eigvalsh(L.toarray())[0] > -1e-13


def test_clamped_cotangents_stay_in_their_range():
    V, F = torus(40, 5)  # long thin faces
    L = cotangent_laplacian(V, F, cotangents=(0, 1)).tocoo()
    off_diagonal = L.data[L.row != L.col]
    assert off_diagonal.max() <= 0
    assert off_diagonal.min() >= -1 - 1e-15


def test_voronoi_masses_are_those_of_libigl_and_add_up(rng):
    V, F = icosphere(2)
    V = V + 0.05 * rng.standard_normal(V.shape)  # obtuse faces among others
    M = mass_matrix(V, F)
    np.testing.assert_allclose(M.diagonal(), igl.massmatrix(V, F, igl.MASSMATRIX_TYPE_VORONOI).diagonal(), rtol=1e-12)
    assert M.diagonal().sum() == pytest.approx(area(V, F), rel=1e-13)
    assert mass_matrix(V, F, "barycentric").diagonal().sum() == pytest.approx(area(V, F), rel=1e-13)


def test_an_unknown_mass_is_refused():
    with pytest.raises(MeshError, match="kind must be one of 'voronoi', 'barycentric'"):
        mass_matrix(*icosphere(1), kind="full")
