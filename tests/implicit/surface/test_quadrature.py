"""Quadrature and samples against closed forms and their order of convergence."""

import math

import numpy as np
import pytest
import torch
from skimage.measure import marching_cubes

from implicit import (
    Field,
    SurfaceError,
    Volume,
    decoder_field,
    extract_mesh,
    sample_surface,
    shapes,
    surface_quadrature,
)
from implicit.families import CHAIRS
from implicit.sensitivity.shape_functionals import volume_terms
from implicit.surface.marching import Grid, march, near_surface
from implicit.surface.quadrature import carried, meshed_quadrature

TORUS_AREA = 4 * math.pi**2 * 0.7 * 0.25
TORUS_VOLUME = 2 * math.pi**2 * 0.7 * 0.25**2


def torus_errors(resolution):
    field = shapes.torus(0.7, 0.25)
    sample = surface_quadrature(field, resolution)
    return (
        abs(float(sample.weights.sum()) / TORUS_AREA - 1),
        abs(Volume().value(field, sample) / TORUS_VOLUME - 1),
    )


def test_torus_area_and_volume_are_within_1e_5():
    assert max(torus_errors(64)) < 1e-5


def test_quadrature_converges_with_order_three_and_a_half_or_better():
    coarse, fine = torus_errors(24), torus_errors(72)
    for before, after in zip(coarse, fine, strict=True):
        assert math.log(before / after) / math.log(3) > 3.5


def test_divergence_theorem_holds_for_x():
    """int x . n = 3 V about any origin: the field x has divergence 3."""
    field = shapes.torus(0.6, 0.2)
    sample = surface_quadrature(field, 64)
    volume = 2 * math.pi**2 * 0.6 * 0.2**2
    for shift in (0.0, 5.0):
        flux = sample.integrate(((sample.points + shift) * sample.normals).sum(dim=1))
        assert flux / 3 == pytest.approx(volume, rel=2e-5)


def test_a_constant_field_has_no_flux():
    sample = surface_quadrature(shapes.torus(0.7, 0.25), 48)
    assert float((sample.weights @ sample.normals).norm()) < 1e-5


def test_a_circle_has_its_length_and_area():
    field = shapes.circle(0.5)
    sample = surface_quadrature(field, 32)
    assert float(sample.weights.sum()) == pytest.approx(math.pi, rel=1e-6)
    assert float(volume_terms(sample).sum()) == pytest.approx(math.pi / 4, rel=1e-6)


def test_quadrature_points_lie_on_the_surface_with_outward_unit_normals():
    field = shapes.sphere(radius=0.5, center=(0.1, -0.2, 0.05))
    sample = surface_quadrature(field, 32, exact_points=True)
    assert float(field.value(sample.points).abs().max()) < 1e-12
    outward = (sample.points - torch.tensor([0.1, -0.2, 0.05], dtype=torch.float64)) / 0.5
    torch.testing.assert_close(sample.normals, outward, rtol=0, atol=1e-9)


def test_random_samples_are_even_and_repeat_with_their_seed():
    field = shapes.torus(0.6, 0.25)
    sample = sample_surface(field, 4000, seed=3)
    assert torch.equal(sample.points, sample_surface(field, 4000, seed=3).points)
    assert not torch.equal(sample.points, sample_surface(field, 4000, seed=4).points)
    # Moments of the torus in closed form: int z^2 = area r^2 / 2, int x^2 = int y^2 over it.
    area = float(sample.weights.sum())
    assert area == pytest.approx(4 * math.pi**2 * 0.6 * 0.25, rel=3e-3)
    assert sample.integrate(sample.points[:, 2] ** 2) / area == pytest.approx(0.25**2 / 2, rel=0.02)


def test_a_sample_can_change_its_precision():
    sample = surface_quadrature(shapes.sphere(radius=0.5), 16).to(torch.float32)
    assert {part.dtype for part in (sample.points, sample.normals, sample.weights)} == {torch.float32}


def test_mesh_of_a_sphere_faces_outward_and_lies_on_it():
    V, F = extract_mesh(shapes.sphere(radius=0.5), 64)
    a, b, c = (V[F[:, k]] for k in range(3))
    assert np.abs(np.linalg.norm(V, axis=1) - 0.5).max() < 1e-12
    assert np.einsum("ij,ij->", np.cross(a, b), c) / 6 == pytest.approx(math.pi / 6, rel=2.5e-3)


def test_mesh_of_a_circle_keeps_the_inside_on_its_left():
    V, E = extract_mesh(shapes.circle(0.5), 64)
    a, b = V[E[:, 0]], V[E[:, 1]]
    assert 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() == pytest.approx(math.pi / 4, rel=2e-3)


def test_a_field_without_surface_is_refused():
    field = shapes.sphere(radius=0.5)
    with pytest.raises(SurfaceError, match="no surface in its bounds"):
        surface_quadrature(field.with_theta(field.theta * 0 + 1e-9), 8)


def test_a_surface_that_leaves_the_bounds_is_refused():
    with pytest.raises(SurfaceError, match="leaves the bounds"):
        extract_mesh(Field(shapes.torus(0.7, 0.25).module, bounds=((-0.8,) * 3, (0.8,) * 3)), 16)


def test_too_coarse_a_grid_is_refused():
    with pytest.raises(ValueError, match="at least 4 cells"):
        extract_mesh(shapes.sphere(radius=0.5), 2)


def test_leaving_out_blocks_loses_no_body_and_no_thin_shell():
    """Four small balls far apart, and a shell two cells thick: all the volume is there."""
    balls = [shapes.sphere(radius=0.06, center=c) for c in ((0.6, 0, 0), (-0.6, 0, 0), (0, 0.6, 0), (0, 0, -0.6))]
    many = shapes.smooth_union(*balls, blend=0.01)
    shell = shapes.smooth_difference(shapes.sphere(radius=0.5), shapes.sphere(radius=0.5 - 2 * 2 / 128), blend=0.001)
    of_balls, of_shell = 4 * 4 / 3 * math.pi * 0.06**3, 4 / 3 * math.pi * (0.125 - 0.46875**3)
    for field, resolution, volume in ((many, 256, of_balls), (shell, 128, of_shell)):
        V, F = extract_mesh(Field(field.module, bounds=((-1,) * 3, (1,) * 3)), resolution)
        a, b, c = (V[F[:, k]] for k in range(3))
        assert np.einsum("ij,ij->", np.cross(a, b), c) / 6 == pytest.approx(volume, rel=0.03)


@pytest.mark.parametrize("name", ["spot", "bracket"])
def test_blocks_left_out_change_nothing_of_the_surface(name):
    """Chunks have the signs of the field at all their nodes, and marching over all nodes finds no more than they do."""
    field = shapes.bundled(name)
    grid = Grid.over(field, 100)
    index = torch.cartesian_prod(*[torch.arange(count) for count in grid.nodes])
    values = field.value(grid.place(index)).view(grid.nodes).numpy()
    for start, chunk in near_surface(field, grid):
        here = values[tuple(slice(a, a + n) for a, n in zip(start, chunk.shape, strict=True))]
        np.testing.assert_array_equal(chunk < 0, here < 0)
    whole, faces, _, _ = marching_cubes(values, 0.0)
    found = march(field, grid)
    assert len(found.points) == len(whole)
    assert len(found.faces) == len(faces)


@pytest.mark.parametrize("resolution", [64, 96, 128])
def test_a_truncated_distance_is_extracted_whole(resolution):
    """Level where |d| > 0.1, so at the middle of most blocks: the legs and the back of a chair were once cut off."""
    theta = CHAIRS.draw(1)[0]
    field = decoder_field(lambda x, z: CHAIRS.distance(z, x).clamp(-0.1, 0.1), theta)
    whole, _ = extract_mesh(CHAIRS.field(theta), resolution)
    found, _ = extract_mesh(field, resolution)
    np.testing.assert_allclose([found.min(0), found.max(0)], [whole.min(0), whole.max(0)], atol=1e-9)
    assert len(found) == len(whole)


@pytest.mark.parametrize("resolution", [12, 16, 31, 64, 97])
def test_chunks_fit_together(resolution):
    """Every edge of the mesh has two faces, in opposite directions, also where chunks meet and where f = 0 in nodes."""
    for field in (shapes.torus(0.6, 0.25), shapes.sphere(radius=0.5), shapes.bundled("spot")):
        _, F = extract_mesh(field, resolution)
        directed = np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])
        assert len(np.unique(directed, axis=0)) == len(directed)
        forward, backward = (set(map(tuple, part)) for part in (directed, directed[:, ::-1]))
        assert forward == backward


def test_a_quadrature_is_carried_along_with_a_surface_that_moves_little():
    """A ball that grows by a tenth of a cell, by nothing, and by a whole cell."""
    ball = shapes.sphere(radius=0.5, parameters=["radius"])
    before = meshed_quadrature(ball, 24)
    grown = ball.with_theta(ball.theta + 0.1 * ball.size / 24)
    after = carried(grown, before)
    assert torch.equal(after.faces, before.faces)
    radius = 0.5 + 0.1 * ball.size / 24
    torch.testing.assert_close(after.vertices.norm(dim=1), torch.full_like(after.vertices[:, 0], radius))
    assert float(after.sample.weights.sum()) == pytest.approx(4 * math.pi * radius**2, rel=1e-4)
    assert Volume().value_on(grown, after) == pytest.approx(4 / 3 * math.pi * radius**3, rel=1e-7)
    assert carried(ball, before) is before
    assert carried(ball.with_theta(ball.theta + ball.size / 24), before) is None


@pytest.mark.parametrize("name", ["spot", "bracket"])
def test_slopes_from_the_nodes_of_cells_are_good_enough_for_a_volume(name):
    """The distance of the cells from the surface is known to a twentieth by them, as far as the volume is concerned."""
    field = shapes.bundled(name).to(torch.float64)
    meshed = meshed_quadrature(field, 48)
    on_the_cells, exact = float(volume_terms(meshed.sample).sum()), Volume().value(field, meshed.sample)
    assert abs(Volume().value_on(field, meshed) - exact) < 0.05 * abs(on_the_cells - exact)


def test_a_grid_beyond_the_memory_limit_is_refused_at_once():
    with pytest.raises(MemoryError, match=r"more than the limit of 4\.0 GiB"):
        extract_mesh(shapes.sphere(radius=0.5), 5000)
