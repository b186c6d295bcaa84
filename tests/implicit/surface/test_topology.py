"""Pieces and Euler numbers of shapes that have known ones."""

import math

import numpy as np
import pytest

from implicit import shapes
from implicit.surface.topology import mesh_topology, surface_topology


@pytest.mark.parametrize(
    ("field", "euler"),
    [(shapes.sphere(radius=0.5), 2), (shapes.torus(), 0), (shapes.bracket(), 2 - 2 * 3)],
    ids=["sphere", "torus", "bracket"],
)
def test_the_euler_number_counts_handles(field, euler):
    """chi = 2 - 2 g on one closed piece."""
    found = surface_topology(field, 64)
    assert (found.components, found.euler) == (1, euler)


def test_two_balls_apart_are_two_pieces_with_their_areas():
    balls = shapes.smooth_union(
        shapes.sphere(radius=0.3, center=(-0.45, 0, 0)), shapes.sphere(radius=0.15, center=(0.6, 0, 0)), blend=0.01
    )
    found = surface_topology(balls, 64)
    assert (found.components, found.euler) == (2, 4)
    np.testing.assert_allclose(found.areas, [4 * math.pi * r * r for r in (0.3, 0.15)], rtol=0.02)


def test_a_curve_has_its_length_and_no_euler_number():
    found = surface_topology(shapes.circle(radius=0.5), 64)
    assert (found.components, found.euler) == (1, 0)
    assert found.areas[0] == pytest.approx(math.pi, rel=2e-3)


def test_a_tetrahedron_is_counted_by_hand():
    """Four vertices, six edges, four faces."""
    V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    found = mesh_topology(V, F)
    assert (found.components, found.euler) == (1, 2)
    assert found.areas[0] == pytest.approx(1.5 + math.sqrt(3) / 2)
