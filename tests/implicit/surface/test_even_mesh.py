"""Even meshes: on the surface, closed, of its type, and as dense in every direction."""

import numpy as np
import pytest
import torch

from implicit import mesh_topology, shapes, surface_topology
from implicit.surface import even_mesh as module
from implicit.surface.even_mesh import even_mesh
from implicit.surface.extraction import marched_surface


def sides(V, F):
    """Return the lengths of the sides of the triangles."""
    x = V.numpy()[F.numpy()]
    return np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2)


def shares(V, F):
    """Return the area of each vertex."""
    x = V.numpy()[F.numpy()]
    areas = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
    return np.bincount(F.numpy().ravel(), np.repeat(areas, 3)) / 3


@pytest.mark.parametrize("field", [shapes.torus(0.5, 0.2), shapes.sphere(0.6)], ids=["torus", "sphere"])
def test_it_lies_on_the_surface_and_has_its_type(field):
    V, F = even_mesh(field, 700)
    assert 0.9 * 700 < len(V) <= 700
    assert float(field.value(V).abs().max()) < 1e-9
    assert mesh_topology(V.numpy(), F.numpy()).same_type(surface_topology(field))
    x = V.numpy()[F.numpy()]
    assert np.einsum("ni,ni->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6 > 0


def test_it_is_as_dense_where_the_surface_stands_aslant_in_the_lattice():
    """Marching makes 1.6 times as many vertices to an area of a sphere about a diagonal as about an axis."""

    def along_over_aslant(V, F):
        area, way = shares(V, F), torch.nn.functional.normalize(V, dim=1).abs().numpy()
        return area[way.max(axis=1) > 0.95].mean() / area[way.min(axis=1) > 0.5].mean()

    sphere = shapes.sphere(0.6)
    V, F = even_mesh(sphere, 2500)
    assert along_over_aslant(V, F) == pytest.approx(1, abs=0.1)
    assert along_over_aslant(*marched_surface(sphere, 32)) > 1.4

    def spread(V, F):
        return np.percentile(sides(V, F), 99) / np.percentile(sides(V, F), 1)

    assert spread(V, F) < 0.5 * spread(*marched_surface(sphere, 32))


def test_two_sheets_nearer_than_the_spacing_stay_apart():
    """A disk of thickness 0.04 with vertices 0.08 apart."""
    field = shapes.ellipsoid((0.6, 0.6, 0.02))
    V, F = even_mesh(field, 500)
    assert mesh_topology(V.numpy(), F.numpy()).same_type(surface_topology(field, 128))


def test_where_clusters_make_no_mesh_the_marched_one_is_relaxed(monkeypatch):
    monkeypatch.setattr(module, "_clustered", lambda *_: None)
    field = shapes.torus(0.5, 0.2)
    V, F = even_mesh(field, 1600)
    assert float(field.value(V).abs().max()) < 1e-9
    assert mesh_topology(V.numpy(), F.numpy()).euler == 0
    assert sides(V, F).min() > 0.25 * sides(V, F).mean()
