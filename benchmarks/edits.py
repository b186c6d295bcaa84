"""The edits of a bundled field, small, with what each must keep."""

import torch

import implicit
from implicit import shapes


class Edits:
    """One edit each at modest size; accuracy beside time."""

    timeout = 300

    def setup(self):
        torch.set_num_threads(1)
        self.field = shapes.bundled("spot").to(torch.float64)
        self.bump = implicit.Handle(implicit.HalfSpace((0, 0.35, 0), (0, 1, 0), falloff=0.3), (0.0, 0.16, 0.0))
        self.feet = implicit.Handle(implicit.HalfSpace((0, -0.6, 0), (0, -1, 0)), (0.0, 0.0, 0.0))
        self.head = implicit.Handle(implicit.HalfSpace((0, 0.5, 0), (0, 1, 0)), (0.1, 0.0, 0.0))

    def geometric(self):
        return implicit.geometric_edit(self.field, self.bump, parts=8, points=2000)

    def smoothed(self):
        return implicit.smooth(self.field, steps=3, constraints=(implicit.Volume(),), points=1000)

    def rigid(self):
        return implicit.rigid_edit(self.field, [self.feet, self.head], points=800)

    def time_geometric(self):
        self.geometric()

    def time_smooth(self):
        self.smoothed()

    def time_rigid(self):
        self.rigid()

    def track_geometric_error(self):
        return float(self.geometric().error_field().square().mean().sqrt())

    def track_volume_drift(self):
        before, after = (
            implicit.Volume().value(f, implicit.surface_quadrature(f, 96)) for f in (self.field, self.smoothed().field)
        )
        return abs(after / before - 1)

    def track_handle_error(self):
        error = self.rigid().error_field()
        return float(error[torch.isfinite(error)].square().mean().sqrt())

    track_geometric_error.unit = "of the largest displacement"
    track_volume_drift.unit = "relative"
    track_handle_error.unit = "of the largest displacement"
