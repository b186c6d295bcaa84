"""Smoothing of a bundled field: seconds of its steps, and how well what is held is held."""

import implicit
from benchmarks.common import evaluations, sizes, spot


class Smoothing:
    """A few steps by each method, with and without the volume held."""

    params = sizes(["implicit", "explicit"], ["free", "held"])
    param_names = ("method", "volume")
    timeout = 300

    def setup(self, method, volume):
        self.field = spot()
        self.constraints = (implicit.Volume(),) if volume == "held" else ()

    def smoothed(self, method, steps=3):
        return implicit.smooth(self.field, steps=steps, method=method, constraints=self.constraints)

    def time_smooth(self, method, volume):
        self.smoothed(method)

    def track_volume_change(self, method, volume):
        edit = self.smoothed(method)
        before, after = (implicit.integrate(f, implicit.Volume(), 128).value for f in (self.field, edit.field))
        return abs(after / before - 1)

    def track_evaluations(self, method, volume):
        with evaluations() as counts:
            self.smoothed(method)
        return sum(counts)

    def track_most_pieces(self, method, volume):
        return max(row["components"] for row in self.smoothed(method, steps=10).history)

    track_volume_change.unit = "relative"
    track_evaluations.unit = "points"
    track_most_pieces.unit = "pieces"
