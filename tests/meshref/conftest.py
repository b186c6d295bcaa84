"""Meshes that the tests share."""

from pathlib import Path

import numpy as np
import pytest

from meshref import read_mesh

REAL_MESHES = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "meshes"


@pytest.fixture
def real_mesh():
    """A function from the name of a real mesh file to its vertices and faces; skips where the files are not there."""
    if not REAL_MESHES.is_dir():
        pytest.skip(f"the real meshes are not there: no directory {REAL_MESHES}")
    return lambda name: read_mesh(REAL_MESHES / name)


@pytest.fixture
def rng():
    return np.random.default_rng(0)
