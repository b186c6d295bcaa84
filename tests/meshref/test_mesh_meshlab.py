"""MeshLab's filters, late imported."""

import subprocess
import sys

import numpy as np
import pytest

from meshref import (
    MeshError,
    box,
    check_mesh,
    decimate,
    hausdorff,
    hausdorff_distance,
    icosphere,
    isotropic_remesh,
    laplacian_smooth,
    surface_distance,
    taubin_smooth,
    volume,
)

pytest.importorskip("pymeshlab", reason="pymeshlab is not installed")


def test_importing_the_package_imports_neither_pymeshlab_nor_torch():
    code = "import meshref, sys; sys.exit(bool({'pymeshlab', 'torch', 'implicit', 'compare'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_laplacian_smoothing_shrinks_and_taubin_does_not(rng):
    V, F = icosphere(3)
    rough = V * (1 + 0.02 * rng.standard_normal((len(V), 1)))
    shrunk, kept = laplacian_smooth(rough, F, steps=10), taubin_smooth(rough, F, steps=10)
    assert volume(shrunk, F) < 0.97 * volume(rough, F)
    assert volume(kept, F) == pytest.approx(volume(rough, F), rel=0.01)
    for smooth in (shrunk, kept):
        radius = np.linalg.norm(smooth, axis=1)
        assert radius.std() < 0.01


def test_remeshing_reaches_the_edge_length():
    V, F = icosphere(2)
    V2, F2 = isotropic_remesh(V, F, 0.15)
    check_mesh(V2, F2, closed=True)
    edges = np.linalg.norm(V2[F2] - V2[np.roll(F2, -1, axis=1)], axis=2)
    assert edges.mean() == pytest.approx(0.15, rel=0.2)
    assert volume(V2, F2) == pytest.approx(volume(V, F), rel=0.02)


def test_decimating_keeps_what_is_flat_and_the_number_of_faces_that_is_asked_for():
    """A cube of 192 faces is as good with 12; a sphere of fewer faces has its chords within."""
    V, F = decimate(*box(subdivisions=2), faces=12)
    check_mesh(V, F, closed=True)
    assert len(F) == 12
    assert volume(V, F) == pytest.approx(1, abs=1e-6)
    V, F = icosphere(3)
    V2, F2 = decimate(V, F, faces=200)
    check_mesh(V2, F2, closed=True)
    assert len(F2) == 200
    assert volume(V2, F2) == pytest.approx(volume(V, F), rel=0.05)


def test_distances_agree_with_ours_both_ways():
    V, F = box(subdivisions=2)
    bump = V.copy()
    bump[np.flatnonzero((V == [0.5, 0.5, 1.0]).all(axis=1)), 2] = 1.7
    theirs = hausdorff_distance(*box(), bump, F)
    assert theirs.max_2_to_1 == pytest.approx(0.7, rel=1e-5)
    assert theirs.max_1_to_2 < 0.6
    assert theirs.hausdorff == pytest.approx(hausdorff(*box(), bump, F), rel=1e-5)


def test_mean_distances_of_two_ellipsoids_agree_with_ours():
    """Theirs and ours are means over their own random points, so they agree to the noise of some ten thousand."""
    V, F = icosphere(4)
    one, two = V * [1.0, 1.2, 0.8], V * [1.1, 1.0, 0.9] + np.array([0.1, 0.0, 0.0])
    theirs, ours = hausdorff_distance(one, F, two, F), surface_distance(one, F, two, F, n=20_000)
    assert theirs.mean_1_to_2 == pytest.approx(ours.mean_1_to_2, rel=0.03)
    assert theirs.mean_2_to_1 == pytest.approx(ours.mean_2_to_1, rel=0.03)
    assert theirs.hausdorff == pytest.approx(ours.hausdorff, rel=0.02)


def test_bad_requests_are_refused():
    V, F = icosphere(1)
    with pytest.raises(MeshError, match="edge_length must be a positive length"):
        isotropic_remesh(V, F, 0.0)
    with pytest.raises(MeshError, match="steps must be a whole number"):
        laplacian_smooth(V, F, steps=0)
    with pytest.raises(MeshError, match="grow below -shrink"):
        taubin_smooth(V, F, shrink=0.5, grow=0.5)
    with pytest.raises(MeshError, match="must be finite"):
        laplacian_smooth(np.full_like(V, np.nan), F)
    meshlab = sys.modules["meshref.meshlab"]
    with pytest.raises(MeshError, match="MeshLab's no_such_filter failed"):
        meshlab._filtered(V, F, "no_such_filter")
