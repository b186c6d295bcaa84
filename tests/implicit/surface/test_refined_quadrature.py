"""Quadratures with cells refined, against closed forms: the order at their seams, and what a grid does not see."""

import math

import numpy as np
import pytest
import torch

from implicit import Area, Volume, shapes
from implicit.surface import refined_quadrature as module
from implicit.surface.extraction import placed_on_grid
from implicit.surface.quadrature import meshed_quadrature
from implicit.surface.refined_quadrature import refined_quadrature
from implicit.surface.refinement import RefinedGrid, as_corners_tell

SPHERE = shapes.sphere(0.6, (0.013, 0.027, -0.041))


def with_random_cells(monkeypatch, share):
    """Have a share of all cells of a grid taken for unresolved."""

    def some(field, curved, meshed, most):
        return np.argwhere(np.random.default_rng(0).random(meshed.grid.cells) < share)

    monkeypatch.setattr(module, "_unresolved", some)


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_the_fourth_order_is_kept_at_seams_of_cells_refined_at_random(monkeypatch, share):
    with_random_cells(monkeypatch, share)
    errors = []
    for cells in (12, 36):
        found = refined_quadrature(SPHERE, cells)
        assert found.refined > 0
        exact = {Volume(): 4 / 3 * math.pi * 0.6**3, Area(): 4 * math.pi * 0.6**2}
        errors.append([abs(what.value(SPHERE, found.sample) / value - 1) for what, value in exact.items()])
    for before, after in zip(*errors, strict=True):
        assert math.log(before / after) / math.log(3) > 3.5
    assert max(errors[1]) < 1e-7


def test_a_refined_surface_is_closed(monkeypatch):
    with_random_cells(monkeypatch, 0.1)
    sample = refined_quadrature(shapes.torus(0.6, 0.25), 24).sample
    assert float((sample.weights @ sample.normals).norm()) < 1e-6


def test_a_surface_that_its_cells_resolve_is_left_as_it_is():
    found, plain = refined_quadrature(SPHERE, 32), meshed_quadrature(SPHERE, 32)
    assert found.refined == 0
    assert torch.equal(found.sample.points, plain.sample.points)


@pytest.mark.parametrize(
    ("boxes", "cells"),
    [([(0.0, 0.01)], 64), ([(0.1, 0.09), (-0.1, 0.09)], 64)],
    ids=["a fin of a hundredth of the box", "two sheets 0.02 apart"],
)
def test_thin_parts_that_pass_between_all_nodes_are_measured(boxes, cells):
    bodies = [shapes.rounded_box((0.5, 0.4, half), 0.005, (0.0, 0.0, z + 0.0156)) for z, half in boxes]
    bodies.append(shapes.sphere(0.25, (0.0, 0.0, -0.6)))
    field, volume = shapes.smooth_union(*bodies, blend=1e-4), sum(map(shapes.exact_volume, bodies))
    plain = Volume().value(field, meshed_quadrature(field, cells).sample)
    assert abs(plain / volume - 1) > 0.01
    assert Volume().value(field, refined_quadrature(field, cells).sample) == pytest.approx(volume, rel=1e-4)


def test_a_needle_between_the_lines_of_a_grid_is_measured():
    bodies = shapes.ellipsoid((0.012, 0.012, 0.3), (0.011, 0.013, 0.3)), shapes.sphere(0.3, (0.0, 0.0, -0.5))
    field, volume = shapes.smooth_union(*bodies, blend=1e-3), sum(map(shapes.exact_volume, bodies))
    assert abs(Volume().value(field, meshed_quadrature(field, 48).sample) / volume - 1) > 1e-3
    assert Volume().value(field, refined_quadrature(field, 48).sample) == pytest.approx(volume, rel=2e-5)


def test_cells_beside_a_refined_one_are_refined_where_their_common_face_shows_them_more():
    sheet = shapes.rounded_box((0.5, 0.4, 0.01), 0.005, (0.0, 0.0, 0.0156))
    field = shapes.smooth_union(sheet, shapes.sphere(0.25, (0.0, 0.0, -0.6)), blend=1e-4)
    refined = RefinedGrid(field, placed_on_grid(field, 64))
    refined.refine(np.array([[32, 32, 32]]))
    x, y = np.flatnonzero(refined.flags[:, 32, 32]), np.flatnonzero(refined.flags[32, :, 32])
    # ROUNDS cells to each side at most; the sheet is 32 cells by 25 wide.
    assert len(x) > 28
    assert len(y) > 24
    assert refined.flags.sum(axis=2).max() == 1


def face(*rows):
    return np.array([[c == "-" for c in row] for row in rows])


def test_a_face_tells_no_more_than_its_corners_where_one_curve_joins_its_sides():
    plain = face("--+", "-++", "+++")
    none = face("+++", "+++", "+++")
    hanging = face("+-+", "+++", "+++")
    loop = np.pad(face("-"), 2)
    alternating = face("--+", "-++", "++-")
    assert as_corners_tell(np.stack([plain, none, hanging, alternating])).tolist() == [True, True, False, False]
    assert as_corners_tell(loop[None]).tolist() == [False]
    assert as_corners_tell(np.zeros((0, 5, 5), dtype=bool)).tolist() == []
