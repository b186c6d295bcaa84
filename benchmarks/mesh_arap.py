"""As-rigid-as-possible deformation of a mesh."""

import meshref
from benchmarks.common import VERTICES, pull, sizes, spot_meshes


class Arap:
    """The head of the cow pulled aside, its feet held."""

    params = sizes(VERTICES)
    param_names = ("vertices",)
    timeout = 600

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, vertices):
        self.V, self.F = meshes[vertices]
        self.handles, displacement = pull(self.V)
        self.targets = self.V[self.handles] + displacement

    def arap(self, **options):
        return meshref.arap(self.V, self.F, self.handles, self.targets, **options)

    def time_ten_iterations(self, meshes, vertices):
        self.arap(iterations=10, tolerance=1e-15)

    def time_to_the_end(self, meshes, vertices):
        self.arap()

    def peakmem_setup(self, meshes, vertices):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_ten_iterations(self, meshes, vertices):
        self.arap(iterations=10, tolerance=1e-15)

    def track_energy(self, meshes, vertices):
        """At the end, over that of the linear least squares from which it starts."""
        linear = meshref.killing(self.V, self.F, self.handles, self.targets - self.V[self.handles]).displacement
        return self.arap().energy / meshref.arap_energy(self.V, self.F, self.V + linear)

    def track_iterations(self, meshes, vertices):
        return self.arap().iterations

    track_energy.unit = "of the linear least squares'"
    track_iterations.unit = "iterations"
