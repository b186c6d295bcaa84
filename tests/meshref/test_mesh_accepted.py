"""Meshes of other libraries are taken as arrays are, checked alike; .glb is written and comes back."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import meshref

V, F = meshref.icosphere(1)


def vtk_like(faces):
    """What pyvista.PolyData has: points, and faces with the number of corners before each."""
    return SimpleNamespace(points=V, faces=np.column_stack([np.full(len(faces), len(faces[0])), faces]).ravel())


@pytest.mark.parametrize(
    "form",
    [
        lambda path: (V, F),
        lambda path: [V.tolist(), F.tolist()],
        lambda path: trimesh.Trimesh(V, F, process=False),
        lambda path: vtk_like(F),
        lambda path: path,
        str,
    ],
    ids=["arrays", "lists", "trimesh", "pyvista", "path", "name"],
)
def test_a_mesh_is_the_same_in_any_form(form, tmp_path):
    path = tmp_path / "a.ply"
    meshref.write_mesh(path, V, F)
    found, faces = meshref.as_mesh(form(path))
    np.testing.assert_array_equal(found, V)
    np.testing.assert_array_equal(faces, F)
    assert meshref.volume(found, faces) == meshref.volume(V, F)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (3, "but is a int"),
        (None, "but is a NoneType"),
        (vtk_like([[0, 1, 2, 3]]), "must have triangles alone"),
        (trimesh.Trimesh(np.full((3, 3), np.nan), [[0, 1, 2]], process=False), "finite"),
        ((V, F + len(V)), "must index"),
    ],
)
def test_what_is_no_mesh_is_refused(mesh, message):
    with pytest.raises(meshref.MeshError, match=message):
        meshref.as_mesh(mesh)


def test_a_glb_comes_back_in_single_precision_with_its_colours(tmp_path):
    colours = (V - V.min()) / np.ptp(V)
    meshref.write_mesh(tmp_path / "a.glb", V, F, colours=colours)
    found, faces = meshref.read_mesh(tmp_path / "a.glb")
    assert len(found) == len(V)
    assert meshref.volume(found, faces) == pytest.approx(meshref.volume(V, F), rel=1e-6)
    seen = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    np.testing.assert_allclose(seen.vertices, V, atol=1e-6)
    np.testing.assert_allclose(seen.visual.vertex_colors[:, :3] / 255, colours, atol=1 / 255)


def test_colours_that_are_none_or_of_another_format_are_refused(tmp_path):
    for colours, name, message in (
        (V, "a.glb", "numbers from 0 to 1"),
        (np.ones(len(V)), "a.glb", "numbers from 0 to 1"),
        (np.ones_like(V), "a.ply", "need a file ending in .glb"),
    ):
        with pytest.raises(meshref.MeshError, match=message):
            meshref.write_mesh(tmp_path / name, V, F, colours=colours)
    assert list(tmp_path.iterdir()) == []
