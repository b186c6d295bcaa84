"""Reading a mesh, checking it, and what is measured of it."""

import tempfile
from pathlib import Path

import numpy as np

import meshref
from benchmarks.common import VERTICES, sizes, spot_meshes


class Input:
    """Files of each kind, and the check before every solve."""

    params = sizes(VERTICES, ["obj", "off", "ply", "stl"])
    param_names = ("vertices", "suffix")

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, vertices, suffix):
        self.V, self.F = meshes[vertices]
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / f"mesh.{suffix}"
        meshref.write_mesh(self.path, self.V, self.F)

    def teardown(self, meshes, vertices, suffix):
        self.folder.cleanup()

    def time_read(self, meshes, vertices, suffix):
        meshref.read_mesh(self.path)

    def track_read_error(self, meshes, vertices, suffix):
        """Volume of what was read against that of what was written: what the digits in the file cost."""
        return abs(meshref.volume(*meshref.mend_mesh(*meshref.read_mesh(self.path))[:2]) / self.volume() - 1)

    def volume(self):
        return meshref.volume(self.V, self.F)

    track_read_error.unit = "relative"


class Check:
    """The check of every public function that takes a mesh."""

    params = sizes(VERTICES)
    param_names = ("vertices",)

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, vertices):
        self.V, self.F = meshes[vertices]

    def time_check(self, meshes, vertices):
        meshref.check_mesh(self.V, self.F)

    def time_check_closed(self, meshes, vertices):
        meshref.check_mesh(self.V, self.F, closed=True)

    def time_area_as_a_floor(self, meshes, vertices):
        meshref.area(self.V, self.F)


class Unite:
    """Two boxes that overlap in an eighth, made one solid."""

    params = sizes([4, 6])
    param_names = ("subdivisions",)

    def setup(self, subdivisions):
        V, F = meshref.box(subdivisions=subdivisions)
        self.V, self.F = np.concatenate([V, V + 0.5]), np.concatenate([F, F + len(V)])

    def time_unite(self, subdivisions):
        meshref.mend_mesh(self.V, self.F)

    def track_volume_error(self, subdivisions):
        """Of 2 - 1/8."""
        return abs(meshref.volume(*meshref.mend_mesh(self.V, self.F)[:2]) / 1.875 - 1)

    track_volume_error.unit = "relative"
