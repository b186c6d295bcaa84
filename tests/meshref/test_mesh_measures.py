"""Volume, area and the rest against closed forms, rational arithmetic and trimesh."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh

from meshref import (
    MeshError,
    area,
    box,
    centroid,
    component_count,
    components,
    cylinder,
    euler_number,
    face_normals,
    genus,
    icosphere,
    second_moment,
    sphericity,
    torus,
    vertex_areas,
    vertex_normals,
    volume,
)
from meshref.measures import volume_gradient


def exact_volume(V, F):
    """The volume of the coordinates as they are rounded, without further rounding."""
    points = [[Fraction(x) for x in point] for point in V.tolist()]
    total = Fraction(0)
    for f in F.tolist():
        a, b, c = (points[i] for i in f)
        cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]
        total += sum(x * y for x, y in zip(a, cross))
    return total / 6


@pytest.mark.parametrize("offset", [0.0, 1e2, 1e4, 1e6])
def test_volume_is_right_to_the_last_digits_far_from_the_origin(offset):
    V, F = torus(24, 16)
    V = V + np.array([offset, -offset, offset / 2])
    exact = exact_volume(V, F)
    assert abs(Fraction(volume(V, F)) / exact - 1) < 1e-14


def test_boxes_are_exact():
    V, F = box((1, 2, 3), (2, 4, 6), subdivisions=2)
    assert volume(V, F) == pytest.approx(6, rel=1e-14)
    assert area(V, F) == pytest.approx(2 * (2 + 3 + 6), rel=1e-14)
    np.testing.assert_allclose(centroid(V, F), [1.5, 3, 4.5], rtol=1e-14)
    np.testing.assert_allclose(second_moment(V, F), 6 * np.diag([1, 4, 9]) / 12, atol=1e-13)


def test_the_cylinder_is_the_prism_over_its_polygon():
    n, radius, height = 17, 0.7, 3.0
    V, F = cylinder(n, 5, radius, height)
    polygon = n / 2 * radius**2 * np.sin(2 * np.pi / n)
    assert volume(V, F) == pytest.approx(polygon * height, rel=1e-13)
    assert area(V, F) == pytest.approx(2 * polygon + 2 * n * radius * np.sin(np.pi / n) * height, rel=1e-13)


def errors_on_tori(measure, exact):
    meshes = [torus(4 * k, 3 * k, 1.0, 0.4) for k in (8, 16, 32)]
    return [abs(measure(V, F) / exact - 1) for V, F in meshes]


@pytest.mark.parametrize(
    ("measure", "exact"), [(volume, 2 * np.pi**2 * 0.4**2), (area, 4 * np.pi**2 * 0.4)], ids=["volume", "area"]
)
def test_volume_and_area_of_a_torus_converge_with_order_two(measure, exact):
    error = errors_on_tori(measure, exact)
    orders = np.log2(np.divide(error[:-1], error[1:]))
    np.testing.assert_allclose(orders, 2, atol=0.05)


def test_inward_faces_turn_the_sign_of_the_volume():
    V, F = icosphere(2)
    assert volume(V, F[:, ::-1]) == pytest.approx(-volume(V, F), rel=1e-14)


def test_trimesh_agrees():
    V, F = torus(20, 12)
    other = trimesh.Trimesh(V, F, process=False)
    assert volume(V, F) == pytest.approx(other.volume, rel=1e-12)
    assert area(V, F) == pytest.approx(other.area, rel=1e-12)
    np.testing.assert_allclose(centroid(V, F), other.center_mass, atol=1e-13)
    np.testing.assert_allclose(face_normals(V, F), other.face_normals, atol=1e-12)
    moment = second_moment(V, F)
    np.testing.assert_allclose(np.trace(moment) * np.eye(3) - moment, other.moment_inertia, atol=1e-12)


def test_the_centroid_moves_with_the_mesh(rng):
    V, F = torus(20, 12)
    V = V * [1, 2, 3]
    V[:, 0] += V[:, 1] ** 2 / 4
    shift = 1e4 * rng.standard_normal(3)
    np.testing.assert_allclose(centroid(V + shift, F) - shift, centroid(V, F), atol=1e-11)


@pytest.mark.parametrize("measure", [volume, centroid, second_moment, sphericity, genus])
def test_measures_of_the_inside_refuse_an_open_mesh(measure):
    V, F = icosphere(2)
    with pytest.raises(MeshError, match=r"needs a closed mesh, but 3 edges.*mend_mesh"):
        measure(V, F[1:])


def test_an_open_mesh_has_an_area():
    V, F = box()
    assert area(V, F[2:]) == pytest.approx(5, rel=1e-14)


def test_euler_number_and_genus():
    assert [euler_number(*icosphere(2)), genus(*icosphere(2))] == [2, 0]
    assert [euler_number(*torus(9, 7)), genus(*torus(9, 7))] == [0, 1]
    V, F = icosphere(2)
    assert euler_number(V, F[1:]) == 1
    V2, F2 = torus(9, 7)
    both = np.concatenate([V, V2 + 5]), np.concatenate([F, F2 + len(V)])
    assert [euler_number(*both), genus(*both), component_count(*both)] == [2, 1, 2]
    np.testing.assert_array_equal(components(*both), np.repeat([0, 1], [len(V), len(V2)]))


def test_only_the_sphere_has_sphericity_one():
    assert sphericity(*icosphere(5)) == pytest.approx(1, abs=1e-4)
    assert sphericity(*box()) == pytest.approx((np.pi / 6) ** (1 / 3), rel=1e-13)


@pytest.mark.parametrize("weighting", ["angle", "area"])
def test_vertex_normals_tend_to_those_of_the_sphere(weighting):
    error = [np.abs(vertex_normals(V, F, weighting) - V).max() for V, F in (icosphere(3), icosphere(4))]
    assert error[1] < 6e-3
    assert error[0] / error[1] > 1.8


def test_vertex_normals_by_angle_do_not_depend_on_the_triangulation():
    V, F = box()
    np.testing.assert_allclose(vertex_normals(V, F), np.sign(V - 0.5) / 3**0.5, atol=1e-15)


def test_vertex_areas_add_up():
    V, F = torus(12, 7)
    assert vertex_areas(V, F).sum() == pytest.approx(area(V, F), rel=1e-14)


def test_an_unknown_weighting_is_refused():
    with pytest.raises(MeshError, match="weighting must be one of 'angle', 'area'"):
        vertex_normals(*box(), weighting="length")


def test_the_gradient_of_the_volume_matches_differences(rng):
    V, F = torus(8, 6)
    way = rng.standard_normal(V.shape)
    step = 1e-4  # the volume is a cubic, so the error of the central difference is its square
    slope = (volume(V + step * way, F) - volume(V - step * way, F)) / (2 * step)
    assert (volume_gradient(V, F) * way).sum() == pytest.approx(slope, rel=1e-5)


def test_the_centroid_of_a_pyramid_is_a_quarter_up():
    """Where the mean of its vertices is a fifth up."""
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.3, 0.4, 2.0]])
    F = [[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    np.testing.assert_allclose(centroid(V, F), [0.5 * 0.75 + 0.3 / 4, 0.5 * 0.75 + 0.4 / 4, 0.5], rtol=1e-14)
