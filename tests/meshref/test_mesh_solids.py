"""Parts that overlap, touch, or lie in one another, against closed forms and winding numbers at random points."""

import itertools

import igl
import numpy as np
import pytest
from nasty_solids import figure_of_eight

from meshref import MeshError, area, box, check_mesh, genus, icosphere, mend_mesh, volume
from meshref.measures import face_areas
from meshref.solids import hidden_faces


def joined(*meshes):
    """Return one mesh of several."""
    count = np.cumsum([0, *(len(V) for V, _ in meshes)])
    return np.concatenate([V for V, _ in meshes]), np.concatenate([F + n for (_, F), n in zip(meshes, count)])


def inwards(mesh):
    return mesh[0], mesh[1][:, ::-1]


def moved(mesh, scale, offset):
    return mesh[0] * scale + np.asarray(offset), mesh[1]


def mended(V, F, **options):
    V, F, report = mend_mesh(V, F, **options)
    return *check_mesh(V, F, closed=True), report


BALL = icosphere(3)
PIMPLE = moved(BALL, 0.2, (0.55, 0.6, 0.45))


@pytest.fixture(scope="module")
def excess():
    """Volume of the small ball outside the large one, by winding numbers at random points, and its standard error."""
    rng = np.random.default_rng(5)
    lower, upper = PIMPLE[0].min(axis=0), PIMPLE[0].max(axis=0)
    points = rng.uniform(lower, upper, (100_000, 3))
    outside = (igl.fast_winding_number(*PIMPLE, points) > 0.5) & (igl.fast_winding_number(*BALL, points) < 0.5)
    whole = np.prod(upper - lower)
    return whole * outside.mean(), whole * outside.std() / len(points) ** 0.5


@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_a_ball_that_sticks_out_of_another_is_united_with_it(mirror, swap, turned, excess):
    """Whichever comes first, wherever its vertices start, and however its faces look."""
    small = inwards(PIMPLE) if turned else PIMPLE
    V, F = joined(small, BALL) if swap else joined(BALL, small)
    V, F, report = mended(mirror * V, F)
    assert (report.bodies, report.cavities, report.united_parts) == (1, 0, 2)
    wanted, error = excess
    assert volume(V, F) - volume(*BALL) == pytest.approx(wanted, abs=4 * error)
    assert 4 * error < 0.5 * wanted < wanted + 4 * error < volume(*PIMPLE)
    assert any(
        step.startswith(f"united 2 parts that overlap or touch: volume {volume(*BALL) + volume(*PIMPLE):.6g} before")
        for step in report.steps
    )


@pytest.mark.parametrize(
    ("lower", "upper", "inside", "outside"),
    [
        ((0.5, 0.5, 0.5), (1.5, 1.5, 1.5), 1.875, 10.5),
        ((0.25, 0.25, 0.5), (0.75, 0.75, 2), 1.25, 8),  # a tower
        ((0.5, 0.25, 1), (1.5, 1.25, 2), 2, 12 - 2 * 0.5 * 0.75),  # stands on the other, overhanging
        ((0, 0, 1), (1, 1, 2), 2, 10),  # stands on the other, edge on edge
        ((0.25, 0.25, 1), (0.75, 0.75, 1.5), 1.125, 7),  # face in face
        ((-1, 0.25, 0.25), (2, 0.75, 0.75), 1.5, 10),  # through it
    ],
)
def test_boxes_that_overlap_or_touch_have_the_volume_and_area_of_their_union(lower, upper, inside, outside):
    for V, F in (joined(box(), box(lower, upper)), joined(box(lower, upper), inwards(box()))):
        V, F, report = mended(V, F)
        assert (report.bodies, report.cavities) == (1, 0)
        assert volume(V, F) == pytest.approx(inside, rel=1e-13)
        assert area(V, F) == pytest.approx(outside, rel=1e-13)
        assert genus(V, F) == 0


@pytest.mark.parametrize("subdivisions", [1, 2])
@pytest.mark.parametrize(
    ("shift", "bodies", "outside"),
    [((0.5, 0.5, 0.5), 1, 10.5), ((0.5, 0, 0), 1, 8), ((1, 0, 0), 1, 10), ((1, 1, 0), 2, 12), ((0.5, 0.5, 1), 1, 11.5)],
)
def test_boxes_that_cross_along_their_edges_are_united(subdivisions, shift, bodies, outside):
    """Edges of both lie on the curve of crossing, so that no face passes through another."""
    V, F = box(subdivisions=subdivisions)
    V, F, report = mended(*joined((V, F), (V + np.array(shift), F)))
    assert (report.bodies, report.cavities) == (bodies, 0)
    assert volume(V, F) == pytest.approx(2 - np.prod(1 - np.array(shift, dtype=float)), rel=1e-13)
    assert area(V, F) == pytest.approx(outside, rel=1e-13)


def test_a_cavity_that_touches_the_wall_in_an_edge_stays_a_cavity():
    """An edge of the inner box, of the same length, lies in the place of an edge within the side of the outer one."""
    outer_V, outer_F = box((0, 0, 0), (4, 4, 4), subdivisions=2)
    inner_V, inner_F = box((1, 1, 1), (2, 2, 2))
    inner_V[(inner_V == [1, 1, 1]).all(axis=1) | (inner_V == [2, 1, 1]).all(axis=1)] -= [
        0,
        0,
        1,
    ]  # two corners, drawn out
    V, F, report = mended(*joined((outer_V, outer_F), (inner_V, inner_F)))
    assert (report.bodies, report.cavities, report.united_parts) == (1, 1, 0)
    assert volume(V, F) == pytest.approx(64 - volume(inner_V, inner_F), rel=1e-13)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1e4])
def test_a_union_is_as_good_in_any_unit_and_place(scale, offset):
    far = scale * offset * np.array([1.0, -2, 0.5])
    V, F = joined(moved(box(), scale, far), moved(box((0.5, 0.5, 0.5), (1.5, 1.5, 1.5)), scale, far))
    V, F, _ = mended(V, F)
    assert volume(V, F) == pytest.approx(1.875 * scale**3, rel=1e-10)


def test_corners_that_stay_keep_their_coordinates_and_are_mapped():
    given, F = joined(moved(box(), 0.7, (1e3, 0.1, 0.3)), box((1000.5, 0.5, 0.5), (1001.3, 1.5, 1.5)))
    V, _, report = mended(given, F)
    stayed = report.vertex_map >= 0
    assert stayed.sum() == 14
    np.testing.assert_array_equal(V[report.vertex_map[stayed]], given[stayed])


HOLLOW = joined(box((0, 0, 0), (10, 10, 10)), inwards(box((1, 1, 1), (9, 9, 9))))


def test_a_rod_through_a_hollow_box_leaves_the_hollow():
    """Wall 488, and the rod: 12 long outside and inside, of which 2 are in the walls."""
    V, F, report = mended(*joined(HOLLOW, box((-1, 4, 4), (11, 5, 5))))
    assert volume(V, F) == pytest.approx(488 + 10, rel=1e-13)
    assert area(V, F) == pytest.approx(600 + 384 - 4 + 4 * 10 + 2, rel=1e-13)
    assert (report.bodies, report.cavities) == (1, 1)


def test_a_strut_between_the_walls_of_a_hollow_box_is_solid():
    V, F, report = mended(*joined(HOLLOW, box((0.5, 4, 4), (9.5, 5, 5))))
    assert volume(V, F) == pytest.approx(488 + 8, rel=1e-13)
    assert (report.bodies, report.cavities) == (1, 1)
    assert genus(V, F) == 1


def test_a_strut_among_walls_that_look_the_wrong_way_is_refused():
    """Inner wall and strut may as well be one hollow."""
    outer, inner, strut = box((0, 0, 0), (10, 10, 10)), box((1, 1, 1), (9, 9, 9)), box((0.5, 4, 4), (9.5, 5, 5))
    with pytest.raises(MeshError, match="what is filled and what is hollow cannot be told"):
        mend_mesh(*joined(outer, inwards(inner), inwards(strut)))


def test_shells_in_shells_are_bodies_and_cavities_in_turn():
    sizes = (1.0, 0.8, 0.6, 0.4, 0.2)
    for directions in ((1, 1, 1, 1, 1), (1, -1, 1, -1, 1), (-1, -1, 1, 1, -1)):
        shells = [moved(BALL if d > 0 else inwards(BALL), r, (0, 0, 0)) for r, d in zip(sizes, directions)]
        V, F, report = mended(*joined(*shells))
        assert (report.bodies, report.cavities) == (3, 2)
        wanted = volume(*BALL) * sum((-1) ** k * r**3 for k, r in enumerate(sizes))
        assert volume(V, F) == pytest.approx(wanted, rel=1e-12)


def test_a_hollow_ball_beside_balls_that_overlap_stays_hollow():
    hollow = joined(moved(BALL, 1, (5, 0, 0)), moved(BALL, 0.5, (5, 0, 0)))
    V, F, report = mended(*joined(BALL, hollow, PIMPLE))
    assert (report.bodies, report.cavities) == (2, 1)
    assert volume(V, F) == pytest.approx(volume(*mended(*joined(BALL, PIMPLE))[:2]) + 7 / 8 * volume(*BALL), rel=1e-13)


def test_the_largest_body_is_chosen_after_parts_are_united():
    chain = [moved(BALL, 0.6, (k, 0, 0)) for k in range(3)]
    alone = moved(BALL, 0.8, (9, 0, 0))
    V, _, report = mended(*joined(alone, *chain), bodies="largest")
    assert V[:, 0].max() == pytest.approx(2.6, abs=0.01)
    assert report.bodies == 1


def test_overlapping_parts_are_one_body_for_those_who_refuse_several():
    assert mended(*joined(BALL, PIMPLE), bodies="refuse")[2].bodies == 1


def test_a_small_part_that_cannot_be_closed_is_dropped_with_the_largest_kept():
    open_V, open_F = box((3, 3, 3), (3.5, 3.5, 3.5), subdivisions=2)
    open_F = open_F[~(open_V[open_F][:, :, 2] == 3.5).all(axis=1)]
    used = np.unique(open_F)
    V, F = joined(BALL, (open_V[used], np.searchsorted(used, open_F)))
    with pytest.raises(MeshError, match="longer than the limit"):
        mend_mesh(V, F, hole_limit=0.1)
    V, F, report = mended(V, F, bodies="largest", hole_limit=0.1)
    assert volume(V, F) == pytest.approx(volume(*BALL), rel=1e-13)
    assert "dropped 1 smaller part that cannot be closed" in report.steps


def test_walls_within_a_part_that_passes_through_itself_are_found_and_said():
    """Where its two strands cross at right angles: a face is hidden if its middle is nearer to the other strand."""
    V, F = figure_of_eight()
    if volume(V, F) < 0:
        F = F[:, ::-1]
    V, F, report = mended(V, F)
    hidden = hidden_faces(V, F)
    assert report.self_intersections > 0
    step = next(step for step in report.steps if "pass through each other" in step)
    assert "% of the surface lies within the solid, and the volume counts it twice" in step
    assert report.hidden_area == pytest.approx(face_areas(V, F)[hidden].sum() / area(V, F))
    middles = V[F].mean(axis=1)
    # Near the middle the strands are straight, along (1, 1) and (1, -1), and a hidden face lies in the other one.
    across = middles[:, :2] @ (np.array([[1, 1], [1, -1]]) / 2**0.5)
    nearest = np.hypot(across, middles[:, 2:]).min(axis=1)
    near = np.linalg.norm(middles, axis=1) < 0.25
    assert 0.01 < hidden.mean() < 0.1
    assert near[hidden].all()
    assert nearest[hidden].max() < 0.12
    assert hidden[near & (nearest < 0.1)].all()


def test_a_mesh_that_crosses_nowhere_hides_nothing():
    for V, F in (BALL, HOLLOW, box((0, 0, 0), (1, 1, 0.01))):
        assert not hidden_faces(V, F).any()


def test_a_part_that_passes_through_itself_along_its_edges_is_said():
    """Two boxes of unit squares that cross along their edges, and are one part by a tube between far sides."""
    first_V, first_F = box((0, 0, 0), (2, 2, 2), subdivisions=1)
    second_V, second_F = box((1, 1, 1), (3, 3, 3), subdivisions=1)
    V, F = joined((first_V, first_F), (second_V, second_F))
    # A face of the first at x = 0 and one of the second at x = 3 are joined by a long way round.
    left = np.flatnonzero((V[F][:, :, 0] == 0).all(axis=1))[0]
    right = np.flatnonzero((V[F][:, :, 0] == 3).all(axis=1))[0]
    a, b = F[left], F[right][[0, 2, 1]]
    way = np.concatenate([V[a] - [2, 0, 0], V[a] - [2, 9, 0], V[b] + [2, -9, 0], V[b] + [2, 0, 0]])
    rings = [a, *(len(V) + np.arange(12).reshape(4, 3)), b]
    tube = [
        face
        for one, next_one in itertools.pairwise(rings)
        for k in range(3)
        for face in ((one[k], one[(k + 1) % 3], next_one[(k + 1) % 3]), (one[k], next_one[(k + 1) % 3], next_one[k]))
    ]
    faces = np.concatenate([np.delete(F, [left, right], axis=0), tube])
    V, F, report = mended(np.concatenate([V, way]), faces)
    assert report.bodies == 1
    assert 0.02 < report.hidden_area < 0.1
    assert any("lies within the solid" in step for step in report.steps)
