"""Geometric edits: a bump on a bundled field, whole and in parts."""

import torch

import implicit
from benchmarks.common import DEVICES, evaluations, leave_out_if_slow, sizes, spot


class Geometric:
    """The head raised by a tenth of the box, the rest fixed."""

    params = sizes([1, 4, 16], [1000, 4000], ["float32", "float64"], DEVICES)
    param_names = ("parts", "points", "dtype", "device")
    timeout = 300

    def setup(self, parts, points, dtype, device):
        self.field = spot(dtype, device)
        self.bump = implicit.Handle(implicit.HalfSpace((0, 0.35, 0), (0, 1, 0), falloff=0.3), (0.0, 0.16, 0.0))

    def edit(self, parts, points, constraints=()):
        return implicit.geometric_edit(self.field, self.bump, steps=parts, points=points, constraints=constraints)

    def time_edit(self, parts, points, dtype, device):
        self.edit(parts, points)

    def peakmem_setup(self, parts, points, dtype, device):
        """Imports and setup alone: the baseline to subtract."""

    def peakmem_edit(self, parts, points, dtype, device):
        self.edit(parts, points)

    def track_error(self, parts, points, dtype, device):
        error = self.edit(parts, points).error_field()
        return float(error[torch.isfinite(error)].square().mean().sqrt())

    def track_evaluations(self, parts, points, dtype, device):
        with evaluations() as counts:
            self.edit(parts, points)
        return sum(counts)

    track_error.unit = "root mean square, of the largest displacement"
    track_evaluations.unit = "points"


class Held:
    """The same bump while the volume is held."""

    timeout = 300

    def setup(self):
        leave_out_if_slow()
        self.field = spot("float64")
        self.bump = implicit.Handle(implicit.HalfSpace((0, 0.35, 0), (0, 1, 0), falloff=0.3), (0.0, 0.05, 0.0))

    def edit(self):
        return implicit.geometric_edit(
            self.field, self.bump, rest="free", steps=3, points=1000, constraints=(implicit.Volume(),)
        )

    def time_edit(self):
        self.edit()

    def track_volume_drift(self):
        edited = self.edit().field
        before, after = (implicit.integrate(f, implicit.Volume(), 96).value for f in (self.field, edited))
        return abs(after / before - 1)

    def track_constraint_residual(self):
        return self.edit().history[-1]["constraint_gap"]

    track_volume_drift.unit = "relative"
    track_constraint_residual.unit = "relative"
