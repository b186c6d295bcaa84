"""Pictures of fields, edits and meshes: what is drawn where, in which colour, and what is refused."""

import numpy as np
import pytest
import torch

import implicit
import meshref
from compare import draw, show
from compare.reports.figures import HELD, MOVED, SURFACE
from compare.reports.show_panels import limit_of, panels_of, vertex_colours
from implicit import Along, HalfSpace, Handle, shapes

BALL = shapes.sphere(0.5)


@pytest.fixture(scope="module")
def grown():
    """A ball grown by 0.1 where x > 0, held where x < -0.3; a sphere can only grow as a whole."""
    handles = [
        Handle(HalfSpace((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), Along(0.1)),
        Handle(HalfSpace((-0.3, 0.0, 0.0), (-1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
    ]
    return implicit.geometric_edit(BALL, handles, rest="free", steps=1, points=100, resolution=16)


def panels(*things, before=None, titles=None, colours="auto"):
    return panels_of(things, before=before, titles=titles, colours=colours, resolution=16)


def test_handles_have_their_colours_on_the_surface_before(grown):
    before, after = panels(grown, before=BALL)
    x = before.view.V[:, 0]
    np.testing.assert_array_equal(before.colours[x > 0.01], np.tile(MOVED, ((x > 0.01).sum(), 1)))
    np.testing.assert_array_equal(before.colours[x < -0.31], np.tile(HELD, ((x < -0.31).sum(), 1)))
    np.testing.assert_array_equal(
        before.colours[(x > -0.29) & (x < -0.01)], np.tile(SURFACE, (((x > -0.29) & (x < -0.01)).sum(), 1))
    )
    assert (before.title, after.title) == ("before", "after")


def test_the_edited_surface_has_the_error_of_the_nearest_point(grown):
    (after,) = panels(grown)
    error = grown.error_field().numpy()
    moved = (grown.points + grown.displacement).numpy()
    for vertex, value in list(zip(after.view.V, after.view.values, strict=True))[::97]:
        nearest = np.linalg.norm(moved - vertex, axis=1).argmin()
        np.testing.assert_equal(value, error[nearest])
    assert after.label.startswith("error")


def test_without_wishes_the_motion_along_the_normal_is_drawn():
    edit = implicit.smooth(BALL, steps=1, step_size=0.01, points=60, directions=None, resolution=16)
    (after,) = panels(edit)
    assert after.label == "motion along the normal, outward"
    assert after.view.values == pytest.approx(np.full(len(after.view.V), -0.01 * 2 / 0.5), rel=0.1)
    with pytest.raises(ValueError, match="has no error"):
        panels(edit, colours="error")


def test_numbers_of_a_mesh_stay_at_their_vertices_and_what_has_none_is_plain():
    V, F = meshref.icosphere(1)
    values = V[:, 2].copy()
    values[0] = np.nan
    (panel,) = panels((np.vstack([V, [[9.0, 9.0, 9.0]]]), F, np.append(values, 5.0)))
    np.testing.assert_array_equal(panel.view.values, values)  # the vertex of no face is gone
    limit = limit_of([panel])
    colours = vertex_colours(panel, limit)
    assert limit[0] == -limit[1]
    np.testing.assert_array_equal(colours[0], SURFACE)
    low, high = np.nanargmin(values), np.nanargmax(values)
    assert colours[low][2] > colours[low][0]  # blue below, red above
    assert colours[high][0] > colours[high][2]


def test_a_range_of_what_is_never_negative_begins_at_zero():
    V, F = meshref.icosphere(1)
    assert limit_of(panels((V, F, V[:, 2] ** 2)))[0] == 0.0
    assert limit_of(panels((V, F))) == (0.0, 1.0)


def test_a_figure_to_turn_holds_the_meshes_and_its_file_all_it_needs(grown, tmp_path):
    figure = show(grown, before=BALL, resolution=16, path=tmp_path / "edit.html")
    meshes = [trace for trace in figure.data if trace.type == "mesh3d"]
    V, F = implicit.extract_mesh(grown.field, 16)
    np.testing.assert_allclose(np.stack([meshes[1].x, meshes[1].y, meshes[1].z], axis=1), V, atol=1e-6)
    np.testing.assert_array_equal(np.stack([meshes[1].i, meshes[1].j, meshes[1].k], axis=1), F)
    text = (tmp_path / "edit.html").read_text(encoding="utf-8")
    assert "<script src" not in text
    assert "<link" not in text
    assert "plotly_relayout" in text
    assert figure._repr_html_()


def test_a_still_picture_is_written_with_a_title_a_panel(grown, tmp_path):
    figure = draw(BALL, grown, titles=["ball", "grown"], resolution=16, path=tmp_path / "still.png")
    assert [axes.get_title() for axes in figure.axes[:2]] == ["ball", "grown"]
    assert (tmp_path / "still.png").stat().st_size > 3000


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: draw(), "nothing to draw"),
        (lambda: draw("cow.obj"), "number 0 is a str"),
        (lambda: draw(shapes.circle()), "in the plane"),
        (lambda: draw(BALL, colours="red"), "colours must be one of"),
        (lambda: draw(BALL, titles=["a", "b"]), "titles must be 1 words"),
        (lambda: draw(BALL, before=shapes), "before must be the Field"),
        (lambda: draw((np.zeros((3, 3)), [[0, 1, 5]])), "F must index"),
        (lambda: draw((*meshref.icosphere(1), torch.zeros(3))), "a number for each of the 42 vertices"),
        (lambda: show(), "nothing to draw"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()
