"""Fans, loops and orientation, on shapes where they can be counted."""

import numpy as np

from meshref import cylinder, icosphere, torus
from meshref.topology import boundary_loops, corner_fans, edge_table, flips_to_agree, vertex_components


def test_closed_meshes_have_two_faces_an_edge_and_one_fan_a_vertex():
    for V, F in (icosphere(2), torus(9, 7), cylinder(8, 3)):
        table = edge_table(F, len(V))
        assert (table.faces == 2).all()
        assert 2 * len(table.edges) == 3 * len(F)
        assert corner_fans(F, table)[0] == len(V)
        assert boundary_loops(F, table) == []


def test_fans_do_not_depend_on_orientation(rng):
    V, F = icosphere(2)
    turned = np.where(rng.random((len(F), 1)) < 0.5, F, F[:, ::-1])
    assert corner_fans(turned, edge_table(turned, len(V)))[0] == len(V)


def test_a_pipe_has_two_loops_of_its_length():
    V, F = cylinder(11, 4)
    pipe = F[(len(V) - 2 > F).all(axis=1)]  # the caps are fans round the last two vertices
    loops = boundary_loops(pipe, edge_table(pipe, len(V)))
    assert sorted(len(loop) for loop in loops) == [11, 11]
    assert all(len(np.unique(V[loop, 2])) == 1 for loop in loops)


def test_random_turns_are_undone(rng):
    V, F = torus(12, 9)
    turned = np.where(rng.random((len(F), 1)) < 0.3, F[:, [0, 2, 1]], F)
    flip, one_sided = flips_to_agree(turned, edge_table(turned, len(V)))
    assert one_sided is None
    np.testing.assert_array_equal(np.where(flip[:, None], turned[:, [0, 2, 1]], turned), F)


def test_a_moebius_strip_is_one_sided():
    n = 12
    i = np.arange(n)
    a, b = 2 * i, 2 * i + 1
    c, d = np.where(i == n - 1, 1, 2 * i + 2), np.where(i == n - 1, 0, 2 * i + 3)
    F = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    assert flips_to_agree(F, edge_table(F, 2 * n))[1] is not None


def test_parts_are_counted():
    V, F = icosphere(1)
    count, part = vertex_components(np.concatenate([F, F + len(V)]), 2 * len(V))
    assert count == 2
    np.testing.assert_array_equal(part, np.repeat([0, 1], len(V)))
