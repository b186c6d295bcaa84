"""Meshes, cells and samples of continuous fields that are not smooth, against closed forms."""

import math

import numpy as np
import pytest
import torch

from implicit import Field, SurfaceError, Units, Volume, extract_mesh, sample_surface, shapes, surface_quadrature
from implicit.sensitivity.shape_functionals import volume_terms
from implicit.surface.marching import Grid, march
from implicit.surface.soundness import changes, field_soundness
from tests.implicit.surface.polytopes import CUBE, OCTAHEDRON, LargestOf, distance_out, polytope
from tests.implicit.surface.test_projection import OF_DISTANCE, OfDistance, of_distance

POLYTOPES = pytest.mark.parametrize("shape", [CUBE, OCTAHEDRON], ids=["cube", "octahedron"])


@pytest.mark.parametrize("spread", [1.0, 100.0, 1e4])
@POLYTOPES
def test_every_vertex_of_a_relu_network_lies_on_its_surface(shape, spread):
    """A tenth of them and more were refused where the slopes of two faces differ by a factor of ten."""
    normals, offset, _, _ = shape
    V, _ = extract_mesh(polytope(normals, offset, spread), 32)
    assert float(distance_out(normals, offset, torch.from_numpy(V)).abs().max()) < 1e-10


def errors(shape, resolution, spread=1.0):
    normals, offset, area, volume = shape
    field = polytope(normals, offset, spread)
    sample = surface_quadrature(field, resolution)
    return abs(float(sample.weights.sum()) / area - 1), abs(Volume().value(field, sample) / volume - 1)


@pytest.mark.parametrize("resolution", [24, 48, 96])
@POLYTOPES
def test_area_and_volume_of_a_polytope_are_of_second_order(shape, resolution):
    """Within a multiple of the squared cell. Cells that cut the edges off miss 0.3 of a cell of the area."""
    of_area, of_volume = errors(shape, resolution)
    assert of_area < 0.9 * (2 / resolution) ** 2
    assert of_volume < 0.15 * (2 / resolution) ** 2


@POLYTOPES
def test_faces_of_unlike_slopes_cost_little(shape):
    assert max(errors(shape, 48, spread=100.0)) < 3e-3


def test_a_square_has_its_length_and_area():
    """Turned by a radian; with a vertex on each edge that crosses a corner nothing is cut off."""
    turn = torch.tensor([[math.cos(1), math.sin(1)], [-math.sin(1), math.cos(1)]], dtype=torch.float64)
    normals = torch.cat([turn, -turn])
    field = Field(LargestOf(normals, 0.5, torch.ones(4)), bounds=((-1, -1), (1, 1)))
    sample = surface_quadrature(field, 32)
    assert float(sample.weights.sum()) == pytest.approx(4, rel=1e-9)
    assert float(volume_terms(sample).sum()) == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("name", [name for name in OF_DISTANCE if name != "cube"])
def test_saturated_fields_have_the_area_and_volume_of_the_shape(name):
    field = of_distance(name)
    sample = surface_quadrature(field, 32)
    assert float(sample.weights.sum()) == pytest.approx(math.pi, rel=1e-5)
    assert Volume().value(field, sample) == pytest.approx(math.pi / 6, rel=1e-5)


@pytest.mark.parametrize("name", ["occupancy", "truncated"])
def test_saturated_fields_converge_with_the_fourth_order_as_smooth_ones_do(name):
    errors = [abs(float(surface_quadrature(of_distance(name), n).weights.sum()) / math.pi - 1) for n in (16, 48)]
    assert math.log(errors[0] / errors[1]) / math.log(3) > 3.5


@pytest.mark.parametrize("method", ["stratified", "uniform", "farthest", "rejection"])
@pytest.mark.parametrize("name", ["occupancy", "truncated", "kinked at the surface"])
def test_samples_of_any_continuous_field(name, method):
    sample = sample_surface(of_distance(name), 200, method, resolution=32)
    torch.testing.assert_close(sample.points.norm(dim=1), torch.full((200,), 0.5, dtype=torch.float64))
    torch.testing.assert_close(sample.normals, sample.points / 0.5, rtol=0, atol=1e-6)
    assert float(sample.weights.sum()) == pytest.approx(math.pi, rel=0.2 if method == "rejection" else 1e-3)


def test_normals_are_those_of_the_cells_where_the_gradient_vanishes_on_the_surface():
    sample = sample_surface(of_distance("cube"), 200, resolution=32)
    assert float((sample.normals * sample.points).sum(dim=1).min()) / 0.5 > 0.999


def test_a_small_saturated_ball_between_the_nodes_of_the_coarse_grid_is_not_lost():
    """Two balls of which the second, 0.06 across, is flat already at the next nodes where slopes are looked at."""

    def two(points):
        other = (points - points.new_tensor([0.6087, 0.6087, 0.6087])).norm(dim=1) - 0.03
        return torch.tanh(torch.minimum(points.norm(dim=1) - 0.4, other) / 0.002)

    field = Field(OfPoints(two))
    V, F = extract_mesh(field, 64)
    a, b, c = (V[F[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", np.cross(a, b), c) / 6
    assert np.linalg.norm(V, axis=1).max() > 1.0
    assert volume == pytest.approx(4 / 3 * math.pi * (0.4**3 + 0.03**3), rel=0.01)


class OfPoints(torch.nn.Module):
    def __init__(self, function) -> None:
        super().__init__()
        self.shift = torch.nn.Parameter(torch.zeros(1, dtype=torch.float64))
        self.function = function

    def forward(self, points):
        return self.function(points) + 0 * self.shift


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_has_a_surface(dtype):
    field = shapes.sphere(radius=0.5).to(dtype)
    V, _ = extract_mesh(field, 32)
    assert np.abs(np.linalg.norm(V, axis=1) - 0.5).max() < 1e-6
    eps = torch.finfo(dtype).eps
    for sample in (surface_quadrature(field, 32), sample_surface(field, 200), sample_surface(field, 200, "farthest")):
        assert sample.points.dtype == sample.weights.dtype == dtype
        assert float((sample.points.double().norm(dim=1) - 0.5).abs().max()) < eps + 1e-3  # cells are near, not on it
        assert float(sample.weights.double().sum()) == pytest.approx(math.pi, rel=eps + 2e-3)


def test_a_thresholded_field_is_refused_as_discontinuous():
    for function in (lambda d: torch.sign(d) + 0 * d, lambda d: d + 0.1 * torch.sign(d)):
        for look in (extract_mesh, surface_quadrature):
            with pytest.raises(SurfaceError, match=r"discontinuous.*before a threshold"):
                look(Field(OfDistance(function)), 16)


def test_the_surface_of_every_node_must_stay_in_the_bounds_too():
    field = of_distance("sharp occupancy")
    with pytest.raises(SurfaceError, match="leaves the bounds"):
        extract_mesh(Field(field.module, level=0.5, inside="positive", bounds=((-1, -1, -0.3), (1, 1, 1))), 32)


@pytest.mark.parametrize("field", [shapes.torus(0.6, 0.25), shapes.circle(0.47)], ids=["torus", "circle"])
def test_each_vertex_starts_between_ends_of_different_sign(field):
    found = march(field, Grid.over(field, 32))
    on_edge = ((found.upper - found.lower) != 0).sum(dim=1) == 1
    assert float(on_edge.double().mean()) > 0.99
    assert bool(((field.value(found.lower) < 0) != (field.value(found.upper) < 0))[on_edge].all())
    along = found.points - found.lower
    torch.testing.assert_close((along * (found.upper - found.lower)).sum(dim=1), along.norm(dim=1) * field.size / 32)


def test_soundness_of_a_relu_network_is_that_of_its_slopes():
    """Six faces of slopes 1 to 100: each percentile is the slope of a face, and no flatness is reported of a copy."""
    normals, offset, _, _ = CUBE
    found = field_soundness(polytope(normals, offset, 100.0))
    faces = 100.0 ** (torch.arange(6) / 5)
    for slope in (found.slope_low, found.slope_median, found.slope_high):
        assert float((faces / slope - 1).abs().min()) < 1e-6
    assert (found.pieces, found.topology.euler) == (1, 2)
    assert changes(found, field_soundness(polytope(normals, offset, 100.0))) == ()


def test_both_sides_of_a_sheet_thinner_than_a_cell_keep_their_vertices():
    """From the node within the sheet Newton's method leads all vertices to one side, which left it no volume."""
    sheet = shapes.rounded_box((0.5, 0.4, 0.01), 0.005, (0.0, 0.0, 0.2))
    vertices, _ = extract_mesh(sheet, 48)
    flat = vertices[(np.abs(vertices[:, :2]) < 0.3).all(axis=1)]
    above, below = ((side * (flat[:, 2] - 0.2) > 0.0099).sum() for side in (1, -1))
    assert above == below > 200
    exact = shapes.exact_volume(sheet)
    assert 0.85 * exact < Volume().value(sheet, surface_quadrature(sheet, 48)) < exact


def test_a_mesh_in_the_users_units_is_the_same_surface_there():
    """A unit sphere that is 40 x + (100, 50, -20) to the user has its radius and center there."""
    field = Field(shapes.sphere(1.0).module, bounds=((-2,) * 3, (2,) * 3), units=Units(40.0, (100.0, 50.0, -20.0)))
    V, F = extract_mesh(field, 16, units="user")
    np.testing.assert_allclose(np.linalg.norm(V - [100, 50, -20], axis=1), 40, rtol=1e-5)
    np.testing.assert_array_equal(F, extract_mesh(field, 16)[1])
    with pytest.raises(ValueError, match="units must be one of field, user, but is 'mm'"):
        extract_mesh(field, 16, units="mm")
