"""Mean-curvature flows of meshes, with and without the volume kept."""

import meshref
from benchmarks.common import VERTICES, sizes, spot_meshes

STEPS = 5


class Flow:
    """A few steps of the cow by each method."""

    params = sizes(["conformalised", "semi-implicit"], VERTICES, ["free", "rescale", "newton"])
    param_names = ("method", "vertices", "volume")
    timeout = 300

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, method, vertices, volume):
        self.V, self.F = meshes[vertices]
        self.size = 1e-4 * meshref.area(self.V, self.F)

    def flow(self, method, volume):
        return meshref.mean_curvature_flow(
            self.V,
            self.F,
            steps=STEPS,
            step_size=self.size,
            method=method,
            preserve_volume=None if volume == "free" else volume,
        )

    def time_flow(self, meshes, method, vertices, volume):
        self.flow(method, volume)

    def peakmem_setup(self, meshes, method, vertices, volume):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_flow(self, meshes, method, vertices, volume):
        self.flow(method, volume)

    def track_volume_change(self, meshes, method, vertices, volume):
        first, *_, last = self.flow(method, volume).history
        return abs(last.volume / first.volume - 1)

    def track_sphericity(self, meshes, method, vertices, volume):
        return self.flow(method, volume).history[-1].sphericity

    track_volume_change.unit = "relative"
    track_sphericity.unit = "of a sphere's"
