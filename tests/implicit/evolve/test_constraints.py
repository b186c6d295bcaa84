"""What an edit holds, and how."""

import pytest
import torch

from implicit import (
    Area,
    Field,
    Holding,
    Siren,
    SurfaceIntegral,
    Volume,
    VolumeIntegral,
    shapes,
    smooth,
    surface_quadrature,
)
from implicit.evolve.constraints import (
    ConstraintSet,
    HardRows,
    KernelProjection,
    LinearConstraints,
    NotHeldError,
    Penalty,
)
from implicit.evolve.edit import EditStatus
from implicit.step.deformation import DeformationSpace
from implicit.step.least_squares import LeastSquares, Rows
from tests.implicit.conftest import Wobbly, seeded_siren

COARSE = {"steps": 2, "step_size": 1e-3, "points": 150, "directions": 50, "resolution": 16}


@pytest.fixture(scope="module")
def narrow():
    """A wobbly sphere of 185 parameters, and a quadrature of it that no edit sees."""
    field = Field(Wobbly(seeded_siren(8)))
    return field, surface_quadrature(field, 56)


def moment_about_y(points):
    return points[:, 0] ** 2 + points[:, 2] ** 2


@pytest.mark.parametrize(
    "constraints",
    [
        (VolumeIntegral(moment_about_y),),
        (Volume(), Area()),
        (SurfaceIntegral(moment_about_y), Volume()),
    ],
    ids=["moment", "volume-and-area", "surface-moment-and-volume"],
)
def test_any_integral_is_held_to_a_millionth(narrow, constraints):
    """Measured afterwards on a quadrature that the loop has not seen."""
    field, before = narrow
    edit = smooth(field, constraints=constraints, holding=Holding(resolution=16, fine_resolution=48), **COARSE)
    assert edit.status is EditStatus.DONE
    after = surface_quadrature(edit.field, 56)
    for constraint in constraints:
        held = constraint.value(edit.field, after)
        assert held == pytest.approx(constraint.value(field, before), rel=1e-6)


def test_projection_keeps_the_volume_to_first_order_and_a_penalty_by_its_price(narrow):
    field, sample = narrow
    before = Volume().value(field, sample)

    def drift(**holding):
        held = {"constraints": (Volume(),), "holding": Holding(resolution=16, fine_resolution=32, **holding)}
        edited = smooth(field, **COARSE, **(held if holding else {})).field
        return Volume().value(edited, surface_quadrature(edited, 32)) / before - 1

    lost = 1 + drift()
    cheap, dear = (abs(drift(enforce="penalty", penalty=price)) for price in (1e-3, 1.0))
    assert abs(drift(enforce="projection")) < 0.1 * (1 - lost)
    assert dear < 0.1 * cheap
    assert cheap < 1 - lost


def test_a_bound_that_is_met_changes_nothing_and_one_that_would_be_broken_holds():
    """A shrinking ball: its volume stops at the bound, and a bound below all it comes to is never felt."""
    field = shapes.sphere(radius=0.5)
    options = {"steps": 4, "step_size": 5e-3, "points": 40, "directions": None, "resolution": 16}
    options["holding"] = Holding(resolution=48, fine_resolution=48)
    free, unfelt, held = (
        shapes.exact_volume(edit.field)
        for edit in (
            smooth(field, constraints=constraints, **options)
            for constraints in ((), (Volume(0.1, "at least"),), (Volume(0.45, "at least"),))
        )
    )
    assert unfelt == pytest.approx(free, rel=1e-6)
    assert free < 0.45
    # Held by a coarse quadrature on the way, whose error leaves the bound met by that much at the end.
    assert 0.45 * (1 - 1e-6) <= held < 0.45 * (1 + 1e-5)


def test_unknown_ways_of_holding_are_refused(wobbly):
    with pytest.raises(ValueError, match="enforce must be"):
        Holding(enforce="gently")
    with pytest.raises(ValueError, match="penalty must be a positive"):
        Holding(penalty=0.0)
    with pytest.raises(ValueError, match="bound must be one of"):
        smooth(wobbly, constraints=(Volume(bound="roughly"),), **COARSE)


def test_contradictory_targets_end_in_a_status():
    """No ball of this volume has this area."""
    field = shapes.sphere(radius=0.5, parameters=["radius"])
    assert not isinstance(field.module, Siren)
    edit = smooth(field, constraints=(Volume(), Area(target=4.0)), **COARSE)
    assert edit.status is EditStatus.CONSTRAINT_NOT_HELD
    assert torch.equal(edit.field.theta, field.theta)


def ball_and_set(constraints, enforce="rows", **options):
    ball = shapes.sphere(0.5, parameters=["radius"])
    holding = Holding(enforce=enforce, resolution=32, fine_resolution=32, **options)
    return ball, ConstraintSet.of(ball, constraints, holding)


def test_the_row_of_a_constraint_leads_to_its_target():
    """Of a sphere told to hold one percent more volume: the radius that the row asks for encloses it."""
    target = 1.01 * shapes.exact_volume(shapes.sphere(0.5))
    ball, held = ball_and_set((Volume(target=target),))
    linear = held.linearised(ball, DeformationSpace(ball), held.measure(ball))
    grown = ball.with_theta(ball.theta + linear.gap / linear.matrix[:, 0])
    assert shapes.exact_volume(grown) == pytest.approx(target, rel=1e-4)


def test_rows_allow_for_what_a_like_step_changed_beyond_the_first_order():
    """A ball told to grow by a tenth: its second try comes nearer by far than the first."""
    ball, held = ball_and_set((Volume(target=1.1 * shapes.exact_volume(shapes.sphere(0.5))),))
    space, start, curved = DeformationSpace(ball), held.measure(ball), ()
    missed = []
    for _ in range(2):
        linear = held.linearised(ball, space, start, curved)
        after = held.measure(ball.with_theta(ball.theta + linear.gap / linear.matrix[:, 0]))
        missed.append(held.violation(after))
        curved = held.beyond_first_order(after, curved)
    beyond = (1 + 0.1 / 3) ** 3 - 1.1
    assert missed[0] == pytest.approx(beyond / 1.1, rel=1e-3)
    assert missed[1] == pytest.approx(1 - (1 + (0.1 - beyond) / 3) ** 3 / 1.1, rel=1e-2)
    assert missed[1] < 0.1 * missed[0]


@pytest.mark.parametrize(
    ("bound", "factor", "violation"),
    [
        ("equal", 1.25, 0.2),
        ("equal", 0.8, 0.25),
        ("at least", 1.25, 0.2),
        ("at least", 0.8, 0.0),
        ("at most", 1.25, 0.0),
        ("at most", 0.8, 0.25),
    ],
)
def test_the_violation_is_the_gap_over_the_target_where_the_bound_is_broken(bound, factor, violation):
    """Of a ball whose volume is V and is to be factor V."""
    volume = shapes.exact_volume(shapes.sphere(0.5))
    ball, held = ball_and_set((Volume(factor * volume, bound),))
    measured = held.measure(ball)
    assert held.violation(measured) == pytest.approx(violation, abs=1e-5)
    assert held.values(measured) == {"volume": pytest.approx(volume, rel=1e-5)}


def linear_constraints(signs):
    """x_0 + x_1 = 1 and x_2 = 2."""
    C = torch.tensor([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    r = torch.tensor([1.0, 2.0], dtype=torch.float64)
    return LinearConstraints(C, r, torch.tensor(signs, dtype=torch.float64), torch.tensor([2.0, 2.0]).double())


def distance_to(target):
    """The least squares |x - target|^2."""
    target = torch.tensor(target, dtype=torch.float64)
    system = LeastSquares(3, target)
    system.add(Rows(torch.eye(3, dtype=torch.float64), target, torch.ones(3, dtype=torch.float64)))
    return system


@pytest.mark.parametrize(
    ("signs", "target", "nearest"),
    [
        ([0, 0], [0.0, 0.0, 0.0], [0.5, 0.5, 2.0]),
        ([1, 0], [0.0, 0.0, 0.0], [0.5, 0.5, 2.0]),
        ([1, 0], [2.0, 0.0, 0.0], [2.0, 0.0, 2.0]),
        ([-1, 1], [2.0, 1.0, 0.0], [1.0, 0.0, 2.0]),
        ([-1, -1], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    ],
)
def test_hard_rows_take_the_nearest_point_that_the_bounds_allow(signs, target, nearest):
    _, x = HardRows().solve(distance_to(target), 0.0, linear_constraints(signs))
    torch.testing.assert_close(x, torch.tensor(nearest, dtype=torch.float64), atol=1e-12, rtol=0)


def test_the_projection_leaves_the_functionals_as_they_are_to_first_order():
    """Of a step (3, 1, 1), what changes x_0 + x_1 or x_2 is taken out."""
    _, x = KernelProjection().solve(distance_to([3.0, 1.0, 1.0]), 0.0, linear_constraints([0, 0]))
    torch.testing.assert_close(x, torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64), atol=1e-12, rtol=0)


def test_a_penalty_weighs_squared_relative_gaps_against_the_step():
    """|x|^2 + p |(C x - r) / s|^2 is least at x = C^T r p / (s^2 + p |C|^2), for rows at right angles."""
    linear, price = linear_constraints([0, 0]), 3.0
    system, penalty = distance_to([0.0, 0.0, 0.0]), Penalty(price)
    for rows in penalty.penalty_rows(linear):
        system.add(rows)
    _, x = penalty.solve(system, 0.0, linear)
    pull = [price / (4 + 2 * price), price / (4 + 2 * price), 2 * price / (4 + price)]
    torch.testing.assert_close(x, torch.tensor(pull, dtype=torch.float64), atol=1e-12, rtol=0)


def test_newtons_method_finds_the_radius_of_a_volume():
    """A ball after a step of no motion that is to hold a tenth more: x is the change of its radius."""
    volume = shapes.exact_volume(shapes.sphere(0.5))
    ball, held = ball_and_set((Volume(1.1 * volume),))
    space, zero = DeformationSpace(ball), torch.zeros(1, dtype=torch.float64)
    x, measured = held.restore(ball, zero, space, lambda C, r: torch.linalg.pinv(C) @ r)
    assert float(x) == pytest.approx(0.5 * (1.1 ** (1 / 3) - 1), rel=1e-4)
    assert held.violation(measured) < 1e-8
    assert held.measure(ball.with_theta(ball.theta + x)).values == pytest.approx(measured.values, rel=1e-8)


def test_a_correction_that_goes_nowhere_is_told_of():
    volume = shapes.exact_volume(shapes.sphere(0.5))
    ball, held = ball_and_set((Volume(1.1 * volume),))
    zero = torch.zeros(1, dtype=torch.float64)
    with pytest.raises(NotHeldError, match=r"0\.091 from its target"):
        held.restore(ball, zero, DeformationSpace(ball), lambda C, r: 0 * (torch.linalg.pinv(C) @ r))


class Damping(Volume):
    """A user's own functional, named as a column of every history."""


class Sphericity(Volume):
    """The same of smoothing alone."""


@pytest.mark.parametrize("functional", [Damping(), Sphericity()], ids=["of-the-loop", "of-the-operation"])
def test_a_functional_named_as_a_column_of_the_records_is_refused(wobbly, functional):
    name = type(functional).__name__.lower()
    with pytest.raises(ValueError, match=rf"constraints\[1\] is called '{name}', but the records"):
        smooth(wobbly, constraints=(Area(), functional), **COARSE)


def test_a_name_that_only_another_operation_records_will_do(wobbly):
    held = ConstraintSet.of(wobbly, (Sphericity(), Area(), Area()), Holding(resolution=16, fine_resolution=16))
    assert held.names == ("sphericity", "area_2", "area_3")
