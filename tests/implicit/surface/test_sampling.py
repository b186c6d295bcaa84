"""Samples of the surface: uniform by a chi-square test, even, weighted, and refused where there is nothing."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import chi2

from implicit import Ball, SurfaceError, sample_surface, shapes, transport
from implicit.surface.sampling import farthest_order


def torus_cells(points, around, across):
    """Counts of points in cells of equal angles, and the exact share of area of each."""
    x, y, z = points.T
    ring = (x**2 + y**2).sqrt()
    u = torch.atan2(y, x) / (2 * math.pi) % 1
    v = torch.atan2(z, ring - 0.55) / (2 * math.pi) % 1
    index = (u * around).long() * across + (v * across).long()
    counts = np.bincount(index.numpy(), minlength=around * across)
    edges = np.linspace(0, 2 * math.pi, across + 1)
    # The area element is (R + r cos v) r du dv.
    band = 0.55 * np.diff(edges) + 0.25 * np.diff(np.sin(edges))
    return counts, np.tile(band / band.sum() / around, around)


def test_uniform_points_pass_a_chi_square_test_on_a_torus():
    """50,000 points in 600 cells of known area; a fair draw fails once in a thousand seeds."""
    sample = sample_surface(shapes.torus(0.55, 0.25), 50_000, "uniform", seed=1)
    counts, share = torus_cells(sample.points, 30, 20)
    statistic = ((counts - 50_000 * share) ** 2 / (50_000 * share)).sum()
    assert statistic < chi2.ppf(0.999, 599)
    # Too even would be wrong as well.
    assert statistic > chi2.ppf(0.001, 599)


def test_stratified_points_are_more_even_than_chance():
    sample = sample_surface(shapes.torus(0.55, 0.25), 50_000, "stratified", seed=1)
    counts, share = torus_cells(sample.points, 30, 20)
    assert ((counts - 50_000 * share) ** 2 / (50_000 * share)).sum() < chi2.ppf(0.001, 599)


@pytest.mark.parametrize("method", ["stratified", "uniform", "farthest", "rejection"])
def test_points_lie_on_the_surface_and_weights_sum_to_its_area(method):
    field = shapes.torus(0.55, 0.25)
    sample = sample_surface(field, 1500, method, seed=2)
    assert len(sample) == 1500
    assert float(field.value(sample.points).abs().max()) < 1e-10
    area = 4 * math.pi**2 * 0.55 * 0.25
    assert float(sample.weights.sum()) == pytest.approx(area, rel=0.03 if method == "rejection" else 1e-3)


@pytest.mark.parametrize("method", ["stratified", "uniform", "farthest", "rejection"])
def test_the_seed_decides(method):
    field = shapes.sphere(radius=0.5)
    first, again, other = (sample_surface(field, 200, method, seed=s).points for s in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_uniform_points_on_a_circle():
    sample = sample_surface(shapes.circle(0.5), 20_000, "uniform")
    angle = torch.atan2(sample.points[:, 1], sample.points[:, 0])
    counts = torch.histc(angle, 50, -math.pi, math.pi).numpy()
    assert chi2.ppf(0.001, 49) < ((counts - 400) ** 2 / 400).sum() < chi2.ppf(0.999, 49)


def test_farthest_points_keep_apart():
    line = torch.linspace(0, 1, 101, dtype=torch.float64)[:, None]
    assert sorted(line[farthest_order(line, 5), 0].tolist()) == pytest.approx([0, 0.25, 0.5, 0.75, 1])


@pytest.mark.parametrize("dimension", [2, 3])
def test_each_farthest_point_is_that_of_all_distances(dimension):
    points = torch.randn(60, dimension, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    distances = torch.cdist(points, points)
    chosen = [0]
    for _ in range(11):
        chosen.append(int(distances[chosen].amin(dim=0).argmax()))
    assert farthest_order(points, 12).tolist() == chosen


def test_farthest_points_on_a_sphere_are_nearly_as_far_apart_as_can_be():
    """At best n points are as far apart as in a hexagonal lattice, sqrt(8 pi / (sqrt(3) n)) R."""
    n = 800
    nearest = {}
    for method in ("farthest", "stratified"):
        points = sample_surface(shapes.sphere(radius=0.5), n, method).points
        nearest[method] = float(torch.pdist(points).min()) / (0.5 * math.sqrt(8 * math.pi / (math.sqrt(3) * n)))
    assert nearest["farthest"] > 0.6
    assert nearest["stratified"] < 0.3


@pytest.mark.parametrize("method", ["stratified", "uniform"])
def test_a_density_draws_more_and_weighs_less(method):
    """Ten times as many points an area above z = 0.2, and integrals as before: area, and first moment of a cap."""
    field = shapes.sphere(radius=0.5)
    n = 20_000
    sample = sample_surface(field, n, method, density=lambda x: 1.0 + 9.0 * (x[:, 2] > 0.2))
    above = sample.points[:, 2] > 0.2
    # By Archimedes the cap has 0.3 of the area.
    assert float(above.double().mean()) == pytest.approx(3.0 / (3.0 + 0.7), abs=0.02)
    assert float(sample.weights.sum()) == pytest.approx(math.pi, rel=0.02)
    assert float(sample.weights[above].sum()) == pytest.approx(0.3 * math.pi, rel=0.03)


def test_a_density_must_be_positive_and_have_a_method():
    field = shapes.sphere(radius=0.5)
    with pytest.raises(ValueError, match="density must be positive"):
        sample_surface(field, 10, density=Ball((0.0, 0.0, 0.5), 0.2))
    with pytest.raises(ValueError, match="one a point"):
        sample_surface(field, 10, density=lambda x: x)
    with pytest.raises(ValueError, match="A density needs method"):
        sample_surface(field, 10, "rejection", density=Ball((0.0, 0.0, 0.5), 0.2))


def test_a_sample_is_carried_to_another_surface():
    small, large = shapes.sphere(radius=0.4), shapes.sphere(radius=0.5)
    sample = sample_surface(small, 300)
    carried = transport(large, sample, 0.09 * sample.normals)  # 0.01 short: the rest is projection
    torch.testing.assert_close(carried.points, 1.25 * sample.points)
    torch.testing.assert_close(carried.normals, sample.normals)
    with pytest.raises(SurfaceError, match="did not reach the surface"):
        transport(large, sample, 0 * sample.points)
    with pytest.raises(ValueError, match="displacement must have shape"):
        transport(large, sample, sample.points[:5])


def test_an_unknown_method_and_no_points_are_refused():
    field = shapes.sphere(radius=0.5)
    with pytest.raises(ValueError, match="method must be"):
        sample_surface(field, 10, "hope")
    with pytest.raises(ValueError, match="n must be at least 1 point"):
        sample_surface(field, 0)


def test_no_surface_is_said():
    field = shapes.sphere(radius=0.5)
    with pytest.raises(SurfaceError, match="Check that there is one in the bounds"):
        sample_surface(field.with_theta(field.theta * 0 - 5.0), 10, "rejection")
