"""The minimum of the energy of finite rotations: stationary, its volume held, and pieces without handles at rest."""

import numpy as np
import pytest

import meshref
from implicit.step.enclosed_volume import EnclosedVolume
from implicit.step.local_global import Hold, LocalGlobal, MinimumStatus
from implicit.step.spokes_and_rims import SpokesAndRims
from implicit.step.surface_area import SurfaceArea


@pytest.fixture(scope="module")
def bar():
    return meshref.box(lower=(-0.1, -0.5, -0.1), upper=(0.1, 0.5, 0.1), subdivisions=3)


def ends(V, degrees):
    """Return which vertices the two ends hold, and where they are after a part of a twist of the upper end."""
    held = np.abs(V[:, 1]) > 0.4

    def places(fraction):
        angle = np.deg2rad(degrees) * fraction
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        return np.where(V[:, 1:2] > 0, V @ turn.T, V)

    return held, places


def nothing(V):
    return np.zeros(len(V))


def test_the_gradient_vanishes_at_the_minimum(bar):
    V, F = bar
    held, places = ends(V, 60)
    energy = SpokesAndRims(V, F)
    found = LocalGlobal(energy, Hold(held, nothing(V))).minimum(places, V, stages=2, tolerance=1e-9)
    assert found.status is MinimumStatus.CONVERGED
    np.testing.assert_array_equal(found.positions[held], places(1.0)[held])
    slopes = energy.gradient(found.positions)
    assert np.abs(slopes[~held]).max() < 1e-6 * np.abs(slopes[held]).max()
    assert found.energy == pytest.approx(energy.energy(found.positions))


def test_the_path_only_makes_a_first_guess(bar):
    V, F = bar
    held, places = ends(V, 90)
    solver = LocalGlobal(SpokesAndRims(V, F), Hold(held, nothing(V)))
    few, many = (solver.minimum(places, V, stages=n, tolerance=1e-9, iterations=2000) for n in (2, 9))
    assert few.energy == pytest.approx(many.energy, rel=1e-6)


def test_a_bar_turned_by_more_than_half_a_turn_remembers_which_way_it_went():
    """The goal of 225 degrees is that of 135 the other way round; the energy of a slender bar grows with the square."""
    V, F = meshref.box(lower=(-0.1, -1.0, -0.1), upper=(0.1, 1.0, 0.1), subdivisions=3)
    held = np.abs(V[:, 1]) > 0.8
    places = ends(V, 225)[1]
    solver = LocalGlobal(SpokesAndRims(V, F), Hold(held, nothing(V)))
    volume = EnclosedVolume(F, len(V)).value(V)
    straight, along = (solver.minimum(places, V, stages=n, tolerance=1e-4, volume=volume) for n in (1, 10))
    assert along.energy / straight.energy == pytest.approx((225 / 135) ** 2, rel=0.05)


def test_the_volume_is_held_at_the_minimum_under_it(bar):
    """Where the gradient is a multiple of that of the volume."""
    V, F = bar
    held, places = ends(V, 90)
    energy, volume = SpokesAndRims(V, F), EnclosedVolume(F, len(V))
    solver = LocalGlobal(energy, Hold(held, nothing(V)))
    free = solver.minimum(places, V, stages=3)
    found = solver.minimum(places, V, stages=3, tolerance=1e-9, iterations=2000, volume=volume.value(V))
    assert volume.value(free.positions) < 0.95 * volume.value(V)
    assert volume.value(found.positions) == pytest.approx(volume.value(V), rel=1e-12)
    assert found.volume_gap < 1e-12
    slopes, grown = energy.gradient(found.positions)[~held].ravel(), volume.gradient(found.positions)[~held].ravel()
    left = slopes - (slopes @ grown) / (grown @ grown) * grown
    assert np.linalg.norm(left) < 1e-5 * np.linalg.norm(slopes)


def test_a_pull_leaves_a_vertex_between_its_place_and_the_rest(bar):
    V, F = bar
    held, _ = ends(V, 0)
    middle = np.flatnonzero(~held)[:1]
    goals = V.copy()
    goals[middle] += 0.05

    def apart(price):
        pulls = nothing(V)
        pulls[middle] = price
        found = LocalGlobal(SpokesAndRims(V, F), Hold(held, pulls)).minimum(lambda _: goals, V, tolerance=1e-8)
        return float(np.linalg.norm(found.positions[middle] - goals[middle]))

    assert apart(1e6) < 1e-5
    assert apart(1e6) < apart(1.0) < apart(1e-3) <= 0.05 * 3**0.5


def test_a_piece_without_handles_stays(bar):
    V, F = bar
    both, faces = np.concatenate([V, V + 2.0]), np.concatenate([F, F + len(V)])
    held, places = ends(V, 45)
    solver = LocalGlobal(SpokesAndRims(both, faces), Hold(np.concatenate([held, nothing(V) > 0]), nothing(both)))
    found = solver.minimum(lambda t: np.concatenate([places(t), nothing(V)[:, None] + np.zeros(3)]), both)
    np.testing.assert_array_equal(found.positions[len(V) :], both[len(V) :])
    assert np.abs(found.positions[: len(V)] - V).max() > 0.05


def test_spent_iterations_are_said(bar):
    V, F = bar
    held, places = ends(V, 90)
    found = LocalGlobal(SpokesAndRims(V, F), Hold(held, nothing(V))).minimum(places, V, iterations=3)
    assert found.status is MinimumStatus.ITERATIONS_SPENT
    assert found.largest_move > 1e-5


def test_the_volume_of_a_box_and_its_change(bar):
    V, F = bar
    volume, way = EnclosedVolume(F, len(V)), np.random.default_rng(0).normal(size=V.shape)
    assert volume.value(V + 5.0) == pytest.approx(0.04)
    h = 1e-6
    difference = (volume.value(V + h * way) - volume.value(V - h * way)) / (2 * h)
    assert np.vdot(volume.gradient(V), way) == pytest.approx(difference, rel=1e-7)
    assert volume.value(volume.reached(V, V, 0.05)) == pytest.approx(0.05, rel=1e-13)


def test_the_energy_falls_from_each_iteration_to_the_next_at_the_goal(bar):
    V, F = bar
    held, places = ends(V, 90)
    told = []
    solver = LocalGlobal(SpokesAndRims(V, F), Hold(held, nothing(V)))
    solver.minimum(places, V, tolerance=1e-7, report=lambda number, energy, move: told.append(energy))
    assert len(told) > 20
    assert np.all(np.diff(told) <= 1e-12 * told[0])


@pytest.mark.parametrize("hold_volume", [False, True])
def test_a_bar_that_is_shaken_comes_back_to_the_same_energy(bar, hold_volume):
    V, F = bar
    held, places = ends(V, 90)
    energy = SpokesAndRims(V, F)
    volume = EnclosedVolume(F, len(V)).value(V) if hold_volume else None
    solver = LocalGlobal(energy, Hold(held, nothing(V)))
    found = solver.minimum(places, V, stages=3, tolerance=1e-7, iterations=2000, volume=volume)
    shaken = found.positions + np.random.default_rng(0).normal(scale=3e-3, size=V.shape)
    again = solver.minimum(places, shaken, tolerance=1e-7, iterations=2000, volume=volume)
    assert again.iterations > 10
    assert again.energy == pytest.approx(found.energy, rel=1e-6)


def test_volume_and_area_are_held_together(bar):
    """Where the gradient is a combination of those of both; bent by a third of a turn, a bar would lose both."""
    V, F = bar
    held, places = ends(V, 60)
    energy, volume, area = SpokesAndRims(V, F), EnclosedVolume(F, len(V)), SurfaceArea(F, len(V))
    solver = LocalGlobal(energy, Hold(held, nothing(V)))
    free = solver.minimum(places, V, stages=2, tolerance=1e-9)
    wanted = volume.value(V), area.value(V)
    found = solver.minimum(places, V, stages=2, tolerance=1e-9, iterations=2000, volume=wanted[0], area=wanted[1])
    assert abs(area.value(free.positions) / wanted[1] - 1) > 1e-3
    assert (volume.value(found.positions), area.value(found.positions)) == pytest.approx(wanted, rel=1e-12)
    assert found.status is MinimumStatus.CONVERGED
    assert found.volume_gap < 1e-12
    free_ones = ~held
    slopes = energy.gradient(found.positions)[free_ones].ravel()
    ways = np.stack([one.gradient(found.positions)[free_ones].ravel() for one in (volume, area)], axis=1)
    left = slopes - ways @ np.linalg.lstsq(ways, slopes, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-4 * np.linalg.norm(slopes)


def test_the_area_of_a_box_and_its_change(bar):
    V, F = bar
    area, way, h = SurfaceArea(F, len(V)), np.random.default_rng(0).normal(size=V.shape), 1e-6
    assert area.value(V + 5.0) == pytest.approx(4 * 0.2 * 1.0 + 2 * 0.2**2)
    difference = (area.value(V + h * way) - area.value(V - h * way)) / (2 * h)
    assert np.vdot(area.gradient(V), way) == pytest.approx(difference, rel=1e-6)
