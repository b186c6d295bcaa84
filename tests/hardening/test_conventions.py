"""What must not depend on place, unit, numbering, layout or precision, as far as hypothesis can find."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

import implicit
import meshref
from implicit import shapes
from meshref.primitives import split_in_four

SEEDS = st.integers(0, 10**6)
SCALES = st.floats(1e-3, 1e3)
few = settings(max_examples=6)


def mesh_of(seed):
    """A torus out of shape, and a displacement of its vertices."""
    rng = np.random.default_rng(seed)
    V, F = meshref.torus(9, 6)
    return V + 0.03 * rng.standard_normal(V.shape), F, 0.1 * rng.standard_normal(V.shape), rng


@few
@given(SEEDS, SCALES)
def test_measures_of_a_mesh_turn_shift_and_scale_with_it(seed, scale):
    V, F, D, rng = mesh_of(seed)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3)
    W, E = scale * V @ R.T + t, scale * D @ R.T
    assert meshref.volume(W, F) == pytest.approx(scale**3 * meshref.volume(V, F), rel=1e-9)
    assert meshref.area(W, F) == pytest.approx(scale**2 * meshref.area(V, F), rel=1e-9)
    np.testing.assert_allclose(scale * meshref.mean_curvature(W, F), meshref.mean_curvature(V, F), rtol=1e-6, atol=1e-8)
    for form in ("membrane", "spokes-and-rims", "ambient"):
        expected = scale**2 * meshref.killing_energy(V, F, D, form=form)
        assert meshref.killing_energy(W, F, E, form=form) == pytest.approx(expected, rel=1e-8)
    assert meshref.arap_energy(W, F, W + E) == pytest.approx(scale**2 * meshref.arap_energy(V, F, V + D), rel=1e-8)


@few
@given(SEEDS)
def test_the_numbering_of_vertices_and_faces_changes_nothing(seed):
    V, F, D, rng = mesh_of(seed)
    place = rng.permutation(len(V))  # old number of each new vertex
    number = np.argsort(place)
    G = np.roll(number[F[rng.permutation(len(F))]], int(rng.integers(3)), axis=1)
    handles = np.array([0, 8, 20, 33])
    assert meshref.volume(V[place], G) == pytest.approx(meshref.volume(V, F), rel=1e-12)
    assert meshref.killing_energy(V[place], G, D[place]) == pytest.approx(meshref.killing_energy(V, F, D), rel=1e-12)
    here, there = (
        meshref.killing(v, f, h, D[handles]).displacement
        for v, f, h in ((V, F, handles), (V[place], G, number[handles]))
    )
    np.testing.assert_allclose(there, here[place], atol=1e-9)


@few
@given(SEEDS)
def test_splitting_the_triangles_changes_no_measure_of_the_surface(seed):
    """A linear displacement stays linear on the parts."""
    V, F, _, rng = mesh_of(seed)
    A = rng.standard_normal((3, 3))
    W, G = split_in_four(V, F)
    assert meshref.volume(W, G) == pytest.approx(meshref.volume(V, F), rel=1e-12)
    assert meshref.area(W, G) == pytest.approx(meshref.area(V, F), rel=1e-12)
    assert meshref.killing_energy(W, G, W @ A) == pytest.approx(meshref.killing_energy(V, F, V @ A), rel=1e-10)


@few
@given(SEEDS)
def test_the_distance_to_a_mesh_moves_with_it(seed):
    V, F, _, rng = mesh_of(seed)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3)
    P = rng.standard_normal((20, 3))
    here, there = meshref.signed_distance(V, F, P), meshref.signed_distance(V @ R.T + t, F, P @ R.T + t)
    np.testing.assert_allclose(there.distance, here.distance, atol=1e-12)
    np.testing.assert_allclose(there.normal, here.normal @ R.T, atol=1e-6)


@few
@given(st.floats(0.2, 0.7), SCALES)
def test_a_field_times_a_constant_is_the_same_surface(radius, scale):
    plain, scaled = shapes.sphere(radius), shapes.sphere(radius, scale=scale)
    points = implicit.sample_surface(plain, 10, resolution=12).points
    torch.testing.assert_close(implicit.basis(scaled, points), implicit.basis(plain, points))
    torch.testing.assert_close(scaled.mean_curvature(points), torch.full_like(points[:, 0], 2 / radius))
    torch.testing.assert_close(scaled.normal(points), points / radius)


@few
@given(st.floats(0.2, 0.7), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_moved_body_has_the_same_volume_and_area(radius, x, y):
    ball = shapes.sphere(radius, (x, y, 0.05), bounds=((-1,) * 3, (1,) * 3))
    sample = implicit.surface_quadrature(ball, 24)
    assert implicit.Volume().value(ball, sample) == pytest.approx(4 / 3 * np.pi * radius**3, rel=2e-5)
    assert implicit.Area().value(ball, sample) == pytest.approx(4 * np.pi * radius**2, rel=2e-5)


@few
@given(SEEDS)
def test_single_precision_agrees_with_double_to_its_digits(seed):
    generator = torch.Generator().manual_seed(seed)
    single = implicit.Field(implicit.Siren(width=8, depth=2, generator=generator))
    double = single.to(torch.float64)
    points = torch.rand(20, 3, generator=generator) * 2 - 1
    torch.testing.assert_close(single.value(points), double.value(points.double()).float(), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(single.gradient(points), double.gradient(points.double()).float(), rtol=1e-3, atol=1e-4)


def mesh_variants():
    """One mesh in every layout that means the same; its coordinates are whole, so each number type can hold them."""
    V, F = meshref.box((-2, -1, 0), (3, 2, 4))
    frozen, wide = V.copy(), np.zeros((len(V), 6))
    frozen.flags.writeable = False
    wide[:, ::2] = V
    return {
        "lists": (V.tolist(), F.tolist()),
        "single precision": (V.astype(np.float32), F),
        "half precision": (V.astype(np.float16), F),
        "whole numbers": (V.astype(int), F),
        "columns first": (np.asfortranarray(V), np.asfortranarray(F)),
        "every other column": (wide[:, ::2], F),
        "read-only": (frozen, F),
        "backwards in memory": (V[::-1].copy()[::-1], F),
        "other byte order": (V.astype(">f8"), F.astype(">i4")),
        "small faces": (V, F.astype(np.uint8)),
        "whole floats": (V, F.astype(float)),
        "a torch tensor": (torch.from_numpy(V), torch.from_numpy(F)),
    }


@pytest.mark.parametrize("layout", mesh_variants())
def test_unusual_arrays_of_a_mesh_give_the_same_answers(layout):
    V, F = meshref.box((-2, -1, 0), (3, 2, 4))
    W, G = mesh_variants()[layout]
    handles, wanted = [0, 3, 5], np.eye(3)
    for function in (
        meshref.volume,
        meshref.centroid,
        meshref.vertex_normals,
        lambda v, f: meshref.signed_distance(v, f, wanted).distance,
        lambda v, f: meshref.killing(v, f, handles, wanted).displacement,
        lambda v, f: meshref.arap(v, f, handles, wanted, iterations=3).V,
        lambda v, f: meshref.biharmonic(v, f, handles, wanted).displacement,
        lambda v, f: meshref.mean_curvature_flow(v, f, steps=1, step_size=1e-2).V,
        lambda v, f: meshref.mend_mesh(v, f)[0],
        lambda v, f: meshref.iou(v, f, V, F, n=50),
    ):
        np.testing.assert_array_equal(function(W, G), function(V, F))


def test_unusual_tensors_of_points_give_the_same_answers():
    field = shapes.torus(0.5, 0.2)
    points = implicit.sample_surface(field, 12, resolution=12).points
    wide = torch.zeros(12, 6, dtype=torch.float64)
    wide[:, ::2] = points
    for variant in (points.T.contiguous().T, wide[:, ::2], points.clone().requires_grad_(), points.flip(0).flip(0)):
        for function in (field.value, field.normal, field.mean_curvature, lambda x: implicit.basis(field, x)):
            torch.testing.assert_close(function(variant), function(points), rtol=0, atol=0)
        assert not field.value(variant).requires_grad
