"""The estimated error of an integral against the true one: of closed forms, and of much finer quadratures."""

import statistics

import pytest
import torch

from implicit import Area, Volume, VolumeIntegral, integrate, shapes, smooth
from implicit.evolve.constraints import ConstraintSet, Holding
from implicit.sensitivity.shape_functionals import next_finer, with_errors
from implicit.surface.quadrature import meshed_quadrature
from implicit.surface.refined_quadrature import refined_quadrature

BALL = shapes.sphere(0.3, (0.0, 0.0, -0.5))


def random_union(seed):
    """Return two to four balls, capsules, boxes and ellipsoids, anywhere, with a smooth union."""
    generator = torch.Generator().manual_seed(seed)

    def between(low, high, count=1):
        drawn = low + (high - low) * torch.rand(count, generator=generator, dtype=torch.float64)
        return drawn.tolist() if count > 1 else float(drawn)

    parts = []
    for _ in range(int(torch.randint(2, 5, (1,), generator=generator))):
        center = between(-0.35, 0.35, 3)
        kind = int(torch.randint(0, 4, (1,), generator=generator))
        if kind == 0:
            parts.append(shapes.sphere(between(0.1, 0.4), center))
        elif kind == 1:
            parts.append(shapes.capsule(center, between(-0.6, 0.6, 3), between(0.03, 0.2)))
        elif kind == 2:
            parts.append(shapes.rounded_box(between(0.1, 0.4, 3), between(0.02, 0.08), center))
        else:
            parts.append(shapes.ellipsoid(between(0.08, 0.45, 3), center))
    return shapes.smooth_union(*parts, blend=between(0.02, 0.15))


def with_fin(z):
    """Return a ball beside a sheet 0.02 thick (a hundredth of the box), and their exact volume and area."""
    fin = shapes.rounded_box((0.5, 0.4, 0.01), 0.005, (0.0, 0.0, z))
    return shapes.smooth_union(BALL, fin, blend=1e-3), exact(BALL, fin)


def two_sheets():
    """Return two rounded boxes 0.02 apart, and their exact volume and area."""
    boxes = [shapes.rounded_box((0.5, 0.4, 0.1), 0.05, (0.0, 0.0, 0.0143 + side * 0.11)) for side in (1, -1)]
    return shapes.smooth_union(*boxes, blend=1e-4), exact(*boxes)


def with_spike():
    """Return a ball beside a needle 0.024 thick between the lines of most grids, and their volume."""
    needle = shapes.ellipsoid((0.012, 0.012, 0.3), (0.011, 0.013, 0.3))
    ball = shapes.sphere(0.3, (0.0, 0.0, -0.5))
    volume = shapes.exact_volume(needle) + shapes.exact_volume(ball)
    return shapes.smooth_union(ball, needle, blend=1e-3), (volume,)


def exact(*bodies):
    return sum(map(shapes.exact_volume, bodies)), sum(map(shapes.exact_area, bodies))


def unrefined(field, functional, resolution):
    """Return an integral over cells of one size, with its estimate."""
    meshed = meshed_quadrature(field, resolution)
    known = {resolution: (functional.value(field, meshed.sample),)}
    return with_errors(field, (functional,), meshed, resolution, known)[0]


def ratios_of_error(seeds, resolution, finer):
    """Return estimate over true error of volume and area, of random shapes; the truth is of so many finer cells."""
    both = (Volume(), Area())
    ratios = [[], []]
    for seed in seeds:
        field = random_union(seed)
        meshed, truth = (refined_quadrature(field, cells) for cells in (resolution, finer))
        known = {resolution: tuple(f.value(field, meshed.sample) for f in both)}
        for k, found in enumerate(with_errors(field, both, meshed, resolution, known)):
            ratios[k].append(found.error / abs(found.value - both[k].value(field, truth.sample)))
    return ratios


@pytest.mark.parametrize("count", [5, pytest.param(200, marks=pytest.mark.nightly)])
def test_the_estimate_is_above_the_error_on_95_of_100_shapes_and_within_30_times_in_the_median(count):
    for ratios in ratios_of_error(range(count), 24, 56):
        assert sum(ratio >= 1 for ratio in ratios) >= 0.95 * len(ratios)
        assert statistics.median(ratios) < 30


@pytest.mark.parametrize(
    "shape",
    [lambda: with_fin(0.2), lambda: with_fin(0.2143), pytest.param(two_sheets, marks=pytest.mark.nightly), with_spike],
    ids=["fin", "fin2", "sheets", "spike"],
)
def test_what_is_thinner_than_a_cell_is_measured_to_its_estimate(shape):
    field, measures = shape()
    for functional, measure, most in zip((Volume(), Area()), measures, (1e-4, 5e-3)):
        found = integrate(field, functional, 48)
        assert abs(found.value - measure) <= min(found.error, most * measure)
        assert found.error < 0.1 * measure


@pytest.mark.parametrize("shape", [lambda: with_fin(0.2), two_sheets], ids=["fin", "sheets"])
def test_what_cells_of_one_size_do_not_see_is_in_the_estimate(shape):
    field, measures = shape()
    for functional, measure in zip((Volume(), Area()), measures):
        found = unrefined(field, functional, 32)
        assert abs(found.value - measure) <= found.error <= 30 * abs(found.value - measure)


def test_nothing_is_unseen_on_a_surface_that_the_cells_resolve():
    assert integrate(shapes.torus(0.6, 0.2), Volume(), 24).unseen == 0.0


def test_a_density_counts_in_what_is_unseen():
    field, (volume, _) = two_sheets()
    one = unrefined(field, Volume(), 32)
    twice = unrefined(field, VolumeIntegral(lambda x: 2.0 + 0.0 * x[:, 0]), 32)
    assert one.unseen > 0.01 * volume
    assert twice.unseen == pytest.approx(2 * one.unseen)


def test_a_tolerance_is_met_on_finer_cells_or_the_estimate_says_that_it_is_not():
    torus = shapes.torus(0.6, 0.2)
    met = integrate(torus, Volume(), 16, tolerance=1e-6)
    assert met.error <= 1e-6 * met.value
    assert met.resolution in (24, 36, 54)
    missed = integrate(torus, Volume(), 16, tolerance=1e-12, finest=24)
    assert missed.resolution == 24
    assert missed.error > 1e-12 * missed.value


def test_several_are_measured_at_once_as_one_at_a_time():
    field, both = shapes.torus(0.5, 0.2), (Volume(), Area())
    assert integrate(field, both, 24) == tuple(integrate(field, one, 24) for one in both)
    with pytest.raises(TypeError, match=r"functional\[1\] must be a functional such as"):
        integrate(field, [Volume(), "area"], 24)


def test_finer_cells_are_half_as_many_again_up_to_the_finest():
    assert [
        next_finer(64, 256),
        next_finer(15, 256),
        next_finer(200, 256),
        next_finer(256, 256),
        next_finer(300, 256),
    ] == [
        96,
        23,
        256,
        256,
        300,
    ]


def test_what_is_held_is_refined_until_it_is_known_to_the_tolerance():
    torus = shapes.torus(0.6, 0.2)
    held = ConstraintSet.of(
        torus, (Volume(),), Holding(tolerance=1e-6, resolution=12, fine_resolution=16, finest_resolution=96)
    )
    assert held.fine > 16
    assert held.errors[0] <= 1e-6
    assert held.errors_of_steps[0] > held.errors[0]
    assert ConstraintSet.of(torus, (Volume(1.0),), Holding(resolution=12, fine_resolution=16)).errors == (0.0,)


def test_an_edit_says_by_how_much_it_does_not_know_what_it_holds():
    ball = shapes.sphere(0.5)
    options = {"steps": 1, "points": 100, "resolution": 12, "constraints": [Volume()]}
    coarse = smooth(ball, holding=Holding(tolerance=1e-9, resolution=12, fine_resolution=12), **options)
    assert any("known to" in note for note in coarse.notes)
    fine = smooth(ball, holding=Holding(tolerance=1e-4, resolution=12, fine_resolution=24), **options)
    assert not any("known to" in note for note in fine.notes)
    usual = smooth(ball, holding=Holding(resolution=12, fine_resolution=14, finest_resolution=14), **options)
    assert 1e-6 < usual.history[-1]["constraint_error"] < 4e-6
    assert any("known to" in note and "tolerance" in note for note in usual.notes)
    for edit in (coarse, fine, usual):
        true = abs(integrate(edit.field, Volume(), 64).value / shapes.exact_volume(ball) - 1)
        assert true <= edit.history[-1]["constraint_error"] + edit.history[-1]["constraint_gap"]
