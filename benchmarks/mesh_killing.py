"""The mesh's Killing least squares: assembly, factorisation and solve."""

import numpy as np

import meshref
from benchmarks.common import VERTICES, pull, sizes, spot_meshes


class Killing:
    """The head of the cow pulled aside, its feet held."""

    params = sizes(VERTICES, ["spokes-and-rims", "membrane"], ["hard", "soft"])
    param_names = ("vertices", "form", "method")
    timeout = 600

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, vertices, form, method):
        self.V, self.F = meshes[vertices]
        self.handles, self.displacement = pull(self.V)

    def solve(self, form, method):
        return meshref.killing(self.V, self.F, self.handles, self.displacement, form=form, method=method)

    def time_killing(self, meshes, vertices, form, method):
        self.solve(form, method)

    def peakmem_setup(self, meshes, vertices, form, method):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_killing(self, meshes, vertices, form, method):
        self.solve(form, method)

    def track_residual(self, meshes, vertices, form, method):
        return self.solve(form, method).residual

    def track_handle_error(self, meshes, vertices, form, method):
        return self.solve(form, method).handle_error / float(np.abs(self.displacement).max())

    def track_energy(self, meshes, vertices, form, method):
        return meshref.killing_energy(self.V, self.F, self.solve(form, method).displacement)

    track_residual.unit = "relative"
    track_handle_error.unit = "of the largest displacement"
    track_energy.unit = "membrane, squared length"


class Again:
    """Further displacements of the same handles, the factor at hand."""

    params = sizes(VERTICES)
    param_names = ("vertices",)

    def setup_cache(self):
        return spot_meshes()

    def setup(self, meshes, vertices):
        V, F = meshes[vertices]
        handles, self.displacement = pull(V)
        self.solver = meshref.KillingSolver(V, F, handles)

    def time_solve(self, meshes, vertices):
        self.solver.solve(self.displacement)
