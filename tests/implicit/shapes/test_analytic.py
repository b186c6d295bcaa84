"""Shapes given by formulas: their measures, their smoothness, and that they save and load."""

from __future__ import annotations

import json
from importlib import resources

import numpy as np
import pytest
import torch

from implicit import extract_mesh, load_field, save_field, shapes, surface_quadrature
from implicit.sensitivity.boundary_sensitivity import basis

PRIMITIVES = ["sphere", "circle", "torus", "box", "rounded_box", "capsule", "cylinder", "ellipsoid"]
BODIES = ["cactus", "bracket", "dumbbell", "chair"]


def cloud(field, n=20_000, seed=0):
    lower, upper = field.bounds
    unit = torch.rand(n, field.dimension, dtype=field.dtype, generator=torch.Generator().manual_seed(seed))
    return lower + unit * (upper - lower)


def volume_of(field, sample):
    """Volume by the divergence theorem: the integral of x . n / D."""
    return sample.integrate((sample.points * sample.normals).sum(dim=1)) / field.dimension


@pytest.mark.parametrize("name", ["sphere", "torus", "capsule", "rounded_box", "circle"])
def test_area_and_volume_formulas_agree_with_integration(name):
    field = getattr(shapes, name)()
    sample = surface_quadrature(field, 96)
    # The curvature of a capsule and a rounded box jumps, which costs the quadrature its order.
    tolerance = 1e-5 if name in ("sphere", "torus", "circle") else 1e-3
    assert float(sample.weights.sum()) == pytest.approx(shapes.exact_area(field), rel=tolerance)
    assert volume_of(field, sample) == pytest.approx(shapes.exact_volume(field), rel=tolerance)


def test_volume_formula_of_the_ellipsoid_agrees_with_integration():
    field = shapes.ellipsoid((0.7, 0.5, 0.4), (0.02, -0.05, 0.1))
    assert volume_of(field, surface_quadrature(field, 96)) == pytest.approx(shapes.exact_volume(field), rel=1e-5)


def test_formulas_follow_the_parameters_that_are_edited():
    field = shapes.sphere(0.5, parameters="radius")
    larger = field.with_theta(torch.tensor([0.7], dtype=torch.float64))
    assert shapes.exact_area(larger) == pytest.approx(shapes.exact_area(shapes.sphere(0.7)), rel=1e-12)


def test_an_unknown_formula_is_refused_with_the_alternative():
    with pytest.raises(TypeError, match=r"No formula .* area of a field of a SmoothUnion. Take implicit.integrate"):
        shapes.exact_area(shapes.cactus())


@pytest.mark.parametrize("name", ["sphere", "torus", "rounded_box", "capsule", "circle"])
def test_distances_have_gradient_one(name):
    field = getattr(shapes, name)()
    points = cloud(field)
    points = points[field.value(points) > -0.05]
    lengths = field.gradient(points).norm(dim=1)
    torch.testing.assert_close(lengths, torch.ones_like(lengths), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", PRIMITIVES + BODIES)
def test_shapes_fit_in_the_unit_box_with_room_to_spare(name):
    field = getattr(shapes, name)()
    points = cloud(field, 100_000)
    inside = points[field.value(points) < 0]
    assert len(inside) > 1000
    assert float(inside.abs().max()) <= 0.8
    assert field.bounds.abs().eq(1).all()


@pytest.mark.parametrize("name", PRIMITIVES + BODIES)
def test_shapes_save_and_load_with_the_same_bits(name, tmp_path):
    field = getattr(shapes, name)()
    field = field.with_theta(field.theta * 1.01)
    save_field(field, tmp_path / "shape.safetensors")
    loaded = load_field(tmp_path / "shape.safetensors")
    points = cloud(field, 1000)
    assert torch.equal(loaded.value(points), field.value(points))
    assert torch.equal(loaded.theta, field.theta)
    assert torch.equal(loaded.bounds, field.bounds)


@pytest.mark.parametrize("name", PRIMITIVES + BODIES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_values_and_derivatives_are_finite_even_at_centres_and_on_axes(name, dtype):
    field = getattr(shapes, name)(dtype=dtype)
    points = torch.cat([cloud(field, 200), torch.zeros(1, field.dimension, dtype=dtype)])
    points = torch.cat([points, torch.eye(field.dimension, dtype=dtype) * 0.3])
    gradients, hessians = field.gradient_and_hessian(points)
    assert torch.isfinite(field.value(points)).all()
    assert torch.isfinite(gradients).all()
    assert torch.isfinite(hessians).all()


@pytest.mark.parametrize("radius", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("scale", [1.0, 5.0], ids=["distance", "not-a-distance"])
def test_growing_the_radius_moves_a_sphere_outward(radius, scale):
    """f = scale (|x| - r): every point moves out by exactly dr, whatever the scale; also where the box must grow."""
    field = shapes.sphere(radius, scale=scale, parameters="radius")
    directions = torch.randn(64, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    points = radius * directions / directions.norm(dim=1, keepdim=True)
    torch.testing.assert_close(basis(field, points), torch.ones(64, 1, dtype=torch.float64))
    assert float(field.bounds[1].min()) > radius


def test_union_and_difference_follow_the_set_operations_up_to_the_blend():
    a, b = shapes.sphere(0.4, (0.2, 0.0, 0.0)), shapes.sphere(0.4, (-0.2, 0.0, 0.0))
    points = cloud(a)
    fa, fb = a.value(points), b.value(points)
    swell = 0.05 / 2**0.5 * np.log(2)
    for excess in (
        torch.minimum(fa, fb) - shapes.smooth_union(a, b, blend=0.05).value(points),
        shapes.smooth_difference(a, b, blend=0.05).value(points) - torch.maximum(fa, -fb),
        shapes.smooth_intersection(a, b, blend=0.05).value(points) - torch.maximum(fa, fb),
    ):
        assert float(excess.min()) > -1e-12
        assert float(excess.max()) == pytest.approx(swell, rel=0.01)


@pytest.mark.parametrize("edge", [0.05, 0.1])
def test_the_smallest_radius_of_an_edge_is_what_was_asked(edge):
    rectangle = shapes.box((0.6, 0.5), edge=edge)
    sample = surface_quadrature(rectangle, 400)
    assert 1 / float(rectangle.mean_curvature(sample.points).max()) == pytest.approx(edge, rel=1e-3)


@pytest.mark.parametrize(("name", "genus"), [("cactus", 0), ("bracket", 3), ("dumbbell", 0), ("chair", 0)])
def test_bodies_are_one_piece_of_known_genus(name, genus):
    V, F = extract_mesh(getattr(shapes, name)(), 96)
    edges = np.unique(np.sort(F[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert len(V) - len(edges) + len(F) == 2 - 2 * genus


def test_edits_reach_the_parts_of_a_combination():
    moved = shapes.sphere(0.3, (0.4, 0.0, 0.0))
    moved = moved.with_theta(torch.tensor([0.3, -0.4, 0.0, 0.0], dtype=torch.float64))
    union = shapes.smooth_union(moved, shapes.sphere(0.2), blend=0.01)
    assert float(union.value(torch.tensor([[-0.6, 0.0, 0.0]], dtype=torch.float64))) < 0
    assert float(union.value(torch.tensor([[0.6, 0.0, 0.0]], dtype=torch.float64))) > 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.sphere(-1.0), r"radius of a sphere must be positive and finite, but is -1.0"),
        (lambda: shapes.torus(0.2, 0.3), r"A torus needs r < R, but r = 0.3 and R = 0.2"),
        (lambda: shapes.rounded_box((0.5, 0.4, 0.05), 0.1), r"must be at most each of"),
        (lambda: shapes.capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), r"length of a capsule must be positive"),
        (lambda: shapes.smooth_union(shapes.sphere(), shapes.circle()), r"share dimension and dtype, but body 1 has 2"),
        (lambda: shapes.smooth_union(shapes.sphere(), shapes.bundled("spot")), r"body 1 is none"),
        (
            lambda: shapes.smooth_intersection(shapes.sphere(0.1, (0.5, 0, 0)), shapes.sphere(0.1, (-0.5, 0, 0))),
            r"The bodies do not meet",
        ),
        (lambda: shapes.bundled("teapot"), r"no bundled field 'teapot'; there are spot, cactus, bracket"),
    ],
)
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


@pytest.mark.parametrize("name", shapes.BUNDLED)
def test_bundled_fields_are_small_good_and_come_with_their_report(name):
    field = shapes.bundled(name)
    assert field.theta.numel() == 2273
    data = resources.files("implicit") / "data"
    assert len((data / f"{name}.safetensors").read_bytes()) < 100_000
    report = json.loads((data / f"{name}.json").read_text())
    assert report["good"]
    assert report["mean_distance"] < 0.001
    assert report["genus"] == report["genus_mesh"] == {"spot": 0, "cactus": 0, "bracket": 3}[name]
    assert report["parameters"] == 2273
    assert field.units.scale == report["scale"]


@pytest.mark.parametrize("name", ["cactus", "bracket"])
def test_a_bundled_network_lies_on_the_shape_that_it_was_fitted_to(name):
    """Its surface, moved to the units of the formula, is within 1 % of the cube of the formula's, on average 0.1 %."""
    field, formula = shapes.bundled(name).to(torch.float64), getattr(shapes, name)()
    V, _ = extract_mesh(field, 64)
    values, gradients = formula.value_and_gradient(field.units.to_user(torch.from_numpy(V)))
    distance = (values / gradients.norm(dim=1)).abs()
    assert float(distance.mean()) < 0.002
    assert float(distance.max()) < 0.02


def test_loading_a_field_leaves_the_global_random_state_alone():
    before = torch.get_rng_state()
    shapes.bundled("spot")
    assert torch.equal(torch.get_rng_state(), before)
