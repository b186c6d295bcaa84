"""The measures of a comparison, on spheres and motions whose answers are known."""

from types import SimpleNamespace

import numpy as np
import pytest

import implicit
import implicit.shapes
import meshref
from compare import Case, HandleSpec
from compare.cases.subject import Subject
from compare.operations.operation import Halfway, Outcome, operation_of
from compare.operations.rigid import strain
from compare.runs.measure import between, curve, measure, measure_field
from compare.runs.operations import target_motion

EVERYWHERE = {"kind": "halfspace", "point": [0.0, 0.0, -9.0], "normal": [0.0, 0.0, 1.0]}


def unit_sphere(scale=1.0):
    """The unit sphere as a subject; the user's units are `scale` of the field's."""
    field = implicit.shapes.sphere(1.0)
    field.units = implicit.Units(scale, (0.0, 0.0, 0.0))
    V, F = meshref.icosphere(4)
    return Subject(field, V, F, V.copy())


def grow(distance):
    """Every point is to move outward by the distance."""
    return Case("spot", "geometric", (HandleSpec(EVERYWHERE, {"kind": "along", "distance": distance}),))


def measured(case, subject, displacement, other=None):
    target = target_motion(case, subject)
    own = Outcome(displacement, "by hand", "Done.", True, 0.0)
    other = Outcome(np.zeros_like(displacement) if other is None else other, "by hand", "Done.", True, 0.0)
    return measure(case, subject, target, own, operation_of(case.operation).error_field(subject, target, own, other))


def test_growing_a_sphere_has_the_energy_volume_and_area_of_the_formula():
    """d = a n on the unit sphere: Killing energy 32 pi a^2, volume (1 + a)^3, area (1 + a)^2, error 0."""
    subject, a = unit_sphere(), 0.1
    row = measured(grow(a), subject, a * subject.V)
    assert row["killing_energy"] == pytest.approx(32 * np.pi * a**2, rel=2e-3)
    assert row["volume_drift"] == pytest.approx((1 + a) ** 3 - 1, rel=1e-7)
    assert row["area_drift"] == pytest.approx((1 + a) ** 2 - 1, rel=1e-7)
    assert row["error_max"] == pytest.approx(0, abs=1e-8)
    assert row["handle_error_max"] == pytest.approx(0, abs=1e-8)


def test_scaling_costs_eight_areas_of_killing_and_six_of_arap():
    """d = a x: J = a I, so |P (J + J') P|^2 = 8 a^2, and each face is in three cells with the edges' 2 a^2 A."""
    subject, a = unit_sphere(), 0.1
    row = measured(grow(a), subject, a * subject.V)
    area = meshref.area(subject.V, subject.F)
    assert row["killing_energy"] == pytest.approx(8 * a**2 * area, rel=1e-12)
    assert row["killing_spokes_and_rims"] == pytest.approx(8 * a**2 * area, rel=1e-10)
    assert row["killing_ambient"] == pytest.approx(8 * a**2 * area, rel=1e-12)
    assert row["killing_notebook"] == pytest.approx(8 * a**2 * len(subject.F), rel=1e-12)
    assert row["arap_energy"] == pytest.approx(6 * a**2 * area, rel=1e-10)


def test_a_finite_turn_costs_no_arap_energy_but_linear_energy_of_fourth_order():
    """x -> R x by the angle t: J + J' = R + R' - 2 I, which is -2 (1 - cos t) times the projector along two axes."""
    subject, t = unit_sphere(), 0.5
    turned = subject.V @ np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]]).T
    row = measured(grow(0.1), subject, turned - subject.V)
    assert row["arap_energy"] < 1e-20
    assert row["volume_drift"] == pytest.approx(0, abs=1e-13)
    # |P Z P|^2 with Z = I - e e' is 1 + (e.n)^4, whose mean over the sphere is 6/5.
    assert row["killing_energy"] == pytest.approx((2 * (1 - np.cos(t))) ** 2 * 4 * np.pi * 6 / 5, rel=5e-3)


def test_statistics_of_an_error_are_those_over_the_area():
    """By Archimedes, z is spread evenly over a sphere: mean 0, mean square 1/3, and |z| stays below 0.95 on 95 %."""
    subject = unit_sphere()
    case, still = Case("spot", "smooth"), np.zeros_like(subject.V)
    own = Outcome(0.1 * subject.V[:, 2:] * subject.V, "by hand", "Done.", True, 0.0)
    target = target_motion(case, subject)
    error = operation_of(case.operation).error_field(
        subject, target, own, Outcome(still, "by hand", "Done.", True, 0.0)
    )
    row = measure(case, subject, target, own, error)
    assert row["error_mean"] == pytest.approx(0, abs=1e-12)
    assert row["error_rms"] == pytest.approx(0.1 / 3**0.5, rel=2e-3)
    assert row["error_p95"] == pytest.approx(0.095, rel=0.01)
    assert row["error_max"] == pytest.approx(0.1, rel=1e-9)


def test_a_curve_has_the_formula_at_every_step_and_the_field_where_it_was_measured():
    """Growing in two steps, the second measured on the field itself; scale 10, so a field's volume is 1000 times."""
    subject, a = unit_sphere(10.0), 0.2
    half, whole = Halfway(a / 2 * subject.V, 1.0), Halfway(a * subject.V, 3.0, volume=4.0, area=5.0)
    outcome = Outcome(a * subject.V, "by hand", "Done.", True, 3.0, path=[half, whole])
    start, middle, end = curve(subject, outcome, {"volume_before": 2000.0, "area_before": 200.0})
    assert set(start.values()) == {0.0}
    assert middle["volume_drift"] == pytest.approx((1 + a / 2) ** 3 - 1, rel=1e-12)
    assert middle["area_drift"] == pytest.approx((1 + a / 2) ** 2 - 1, rel=1e-12)
    area = meshref.area(subject.V, subject.F)
    assert middle["killing_energy"] == pytest.approx(8 * (a / 2) ** 2 * 100 * area, rel=1e-12)
    assert (end["step"], end["seconds"], end["volume_drift"], end["area_drift"]) == (2.0, 3.0, 1.0, 1.5)


def test_an_editor_that_solves_once_has_a_curve_of_two_points():
    subject = unit_sphere()
    outcome = Outcome(0.1 * subject.V, "by hand", "Done.", True, 2.0)
    rows = curve(subject, outcome, {})
    assert [row["seconds"] for row in rows] == [0.0, 2.0]
    assert rows[1]["volume_drift"] == pytest.approx(1.1**3 - 1, rel=1e-12)


def test_an_edit_that_goes_half_way_has_half_the_error():
    subject = unit_sphere()
    row = measured(grow(0.1), subject, 0.05 * subject.V)
    assert row["error_relative"] == pytest.approx(0.5, rel=1e-7)
    assert row["handle_error_relative"] == pytest.approx(0.5, rel=1e-7)
    assert row["error_rms"] == pytest.approx(0.05, rel=1e-7)


def test_numbers_are_in_the_users_units():
    """In units ten times as fine, lengths are 10, areas and energies 100, volumes 1000 times as large."""
    one, ten = (measured(grow(0.1), unit_sphere(scale), 0.05 * unit_sphere().V) for scale in (1.0, 10.0))
    for name, power in {
        "error_rms": 1,
        "handle_error_rms": 1,
        "displacement_max": 1,
        "killing_energy": 2,
        "killing_ambient": 2,
        "arap_energy": 2,
        "error_mean": 1,
        "error_p95": 1,
        "area_after": 2,
        "volume_before": 3,
        "volume_after": 3,
        "volume_drift": 0,
        "error_relative": 0,
        "killing_notebook": 0,  # a sum over faces of |J + J^T|^2, without areas
    }.items():
        assert ten[name] == pytest.approx(one[name] * 10**power, rel=1e-12), name


def test_a_rigid_motion_has_no_energy_and_no_strain():
    subject = unit_sphere()
    turn = np.cross([0.1, -0.2, 0.3], subject.V) + np.array([0.3, 0.1, -0.2])
    assert strain(subject, turn).max() < 1e-12
    assert meshref.killing_energy(subject.V, subject.F, turn) < 1e-20


def test_stretching_by_one_percent_is_a_strain_of_one_percent():
    """d = a z e_z where the normal is along x: the tangential strain is a along z, and nothing else."""
    subject = unit_sphere()
    a = 0.01
    stretch = a * subject.V * [0, 0, 1]
    equator = np.abs(subject.V[:, 2]) < 0.02
    assert strain(subject, stretch)[equator] == pytest.approx(a, rel=0.02)


def test_the_error_of_smoothing_is_the_difference_along_the_normal():
    subject = unit_sphere()
    case, V = Case("spot", "smooth"), subject.V
    own, other = SimpleNamespace(displacement=0.3 * V), SimpleNamespace(displacement=0.1 * V)
    np.testing.assert_allclose(
        operation_of(case.operation).error_field(subject, target_motion(case, subject), own, other), 0.2
    )


def test_overlapping_handles_add_up_in_a_geometric_edit():
    """As the neural editor has it."""
    case = Case("spot", "geometric", (*grow(0.1).handles, *grow(0.02).handles))
    target = target_motion(case, unit_sphere())
    assert target.largest == pytest.approx(0.12)


def test_a_handle_off_the_shape_is_refused():
    far = HandleSpec({"kind": "ball", "center": [5.0, 0.0, 0.0], "radius": 0.1}, {"kind": "along", "distance": 0.1})
    with pytest.raises(ValueError, match=r"Handle 1 of the case .* holds no vertex"):
        target_motion(Case("spot", "geometric", (far,)), unit_sphere())


def test_the_volume_of_the_field_itself_is_that_of_the_formula():
    row = measure_field(unit_sphere(2.0), implicit.shapes.sphere(0.9))
    assert row["volume_before"] == pytest.approx(8 * 4 / 3 * np.pi, rel=1e-5)
    assert row["volume_drift"] == pytest.approx(0.9**3 - 1, rel=1e-4)
    assert row["area_drift"] == pytest.approx(0.9**2 - 1, rel=1e-4)


def test_the_distance_between_two_spheres_is_the_difference_of_radii():
    subject = unit_sphere(10.0)
    V, F = subject.V, subject.F
    row = between(subject, (V, F), (1.2 * V, F), seed=0)
    assert row["chamfer"] == pytest.approx(2.0, rel=5e-3)
    assert row["hausdorff"] == pytest.approx(2.0, rel=5e-3)
    assert row["iou"] == pytest.approx(1.2**-3, abs=0.01)
    assert row["normal_consistency"] == pytest.approx(1, abs=5e-3)
