"""Distances between surfaces whose distance is known."""

import numpy as np
import pytest

from meshref import (
    MeshError,
    box,
    chamfer,
    handle_error,
    hausdorff,
    icosphere,
    iou,
    normal_consistency,
    sample_mesh,
    surface_distance,
)


def test_samples_lie_on_the_surface_evenly():
    V, F = box((0, 0, 0), (1, 2, 3))
    sample = sample_mesh(V, F, 60_000, seed=1)
    on_top = np.mean(sample.points[:, 2] == 3)
    assert on_top == pytest.approx(2 / 22, abs=0.005)
    top = sample.points[sample.points[:, 2] == 3]
    np.testing.assert_allclose(top[:, :2].mean(axis=0), [0.5, 1], atol=0.03)
    np.testing.assert_allclose(top[:, :2].var(axis=0), [1 / 12, 4 / 12], rtol=0.05)
    offset = np.einsum("ij,ij->i", sample.points - V[F[sample.face, 0]], sample.normals)
    np.testing.assert_allclose(offset, 0, atol=1e-14)


def test_the_same_seed_gives_the_same_bits():
    V, F = icosphere(2)
    first, again, other = (sample_mesh(V, F, 100, seed=s).points for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_concentric_spheres_are_as_far_as_their_radii():
    one, two = icosphere(4), icosphere(4, 1.5)
    found = surface_distance(*one, *two, n=5000)
    for value in (found.mean_1_to_2, found.mean_2_to_1, found.rms, found.max_1_to_2, found.max_2_to_1):
        assert value == pytest.approx(0.5, abs=2e-3)
    assert found.normal_consistency == pytest.approx(1, abs=3e-3)
    assert found.chamfer == chamfer(*one, *two, n=5000)
    assert found.hausdorff == hausdorff(*one, *two, n=5000)
    assert found.normal_consistency == normal_consistency(*one, *two, n=5000)


def test_a_surface_is_no_distance_from_itself():
    found = surface_distance(*icosphere(2), *icosphere(2), n=1000)
    assert found.hausdorff < 1e-15
    assert found.normal_consistency == pytest.approx(1, abs=1e-12)


def test_turned_faces_have_opposite_normals():
    V, F = icosphere(2)
    assert normal_consistency(V, F, V, F[:, ::-1], n=1000) == pytest.approx(-1, abs=1e-12)


def test_the_inside_of_a_triangle_counts():
    """A bump amid a flat face is seen, though all vertices of the flat one coincide with others."""
    V, F = box(subdivisions=2)
    bump = V.copy()
    bump[np.flatnonzero((V == [0.5, 0.5, 1.0]).all(axis=1)), 2] = 1.7
    assert hausdorff(*box(), bump, F, n=1000) == pytest.approx(0.7, rel=1e-12)
    assert hausdorff(bump, F, *box(), n=1000) == pytest.approx(0.7, rel=1e-12)


def test_overlap_of_shifted_boxes():
    one, two = box(), box((0.5, 0, 0), (1.5, 1, 1))
    assert iou(*one, *two, n=50_000) == pytest.approx(1 / 3, abs=0.01)
    assert iou(*one, *one, n=1000) == 1
    assert iou(*one, *box((5, 5, 5), (6, 6, 6)), n=50_000) == 0


@pytest.mark.parametrize("apart", [0.5, 1.0, 1.5])
def test_the_overlap_of_two_balls_is_that_of_their_lens(apart):
    """Unit balls at the distance d share pi (4 + d) (2 - d)^2 / 12."""
    V, F = icosphere(4)
    lens = np.pi * (4 + apart) * (2 - apart) ** 2 / 12
    exact = lens / (2 * 4 / 3 * np.pi - lens)
    assert iou(V, F, V + np.array([apart, 0, 0]), F, n=100_000) == pytest.approx(exact, abs=0.006)


def test_normals_of_two_planes_agree_by_the_cosine_between_them():
    """Two squares that share an edge, one turned about it."""
    V, F = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
    t = 0.3
    tilted = V @ np.array([[1, 0, 0], [0, np.cos(t), -np.sin(t)], [0, np.sin(t), np.cos(t)]]).T
    assert normal_consistency(V, F, tilted, F, n=1000) == pytest.approx(np.cos(t), rel=1e-12)


def test_handle_error_is_the_largest_miss():
    D = np.zeros((5, 3))
    D[3] = [1, 0, 0]
    assert handle_error(D, [1, 3], [[0, 0, 0], [1, 0, 2]]) == 2
    with pytest.raises(MeshError, match=r"wanted must have a row for each of the 1 handles"):
        handle_error(D, [1], np.zeros((2, 3)))


@pytest.mark.parametrize("n", [0, -5])
def test_the_number_of_points_must_be_positive(n):
    with pytest.raises(MeshError, match="n must be a whole number"):
        sample_mesh(*icosphere(1), n)


def test_inward_solids_have_no_overlap():
    V, F = icosphere(2)
    with pytest.raises(MeshError, match="oriented outwards"):
        iou(V, F[:, ::-1], V, F[:, ::-1], n=1000)
