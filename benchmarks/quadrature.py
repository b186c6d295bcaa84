"""Integrals over a surface and inside it, against closed forms, and points drawn on it."""

import math

import implicit
from benchmarks.common import evaluations, sizes, spot
from implicit import shapes

RADII = 0.7, 0.25
AREA = 4 * math.pi**2 * RADII[0] * RADII[1]
VOLUME = 2 * math.pi**2 * RADII[0] * RADII[1] ** 2


class Quadrature:
    """Area and volume of a torus."""

    params = sizes([24, 48, 96])
    param_names = ("resolution",)

    def setup(self, resolution):
        self.field = shapes.torus(*RADII)
        self.sample = implicit.surface_quadrature(self.field, resolution)

    def time_quadrature(self, resolution):
        implicit.surface_quadrature(self.field, resolution)

    def time_volume(self, resolution):
        implicit.Volume().value(self.field, self.sample)

    def track_area_error(self, resolution):
        return abs(float(self.sample.weights.sum()) / AREA - 1)

    def track_volume_error(self, resolution):
        return abs(implicit.Volume().value(self.field, self.sample) / VOLUME - 1)

    def track_evaluations(self, resolution):
        with evaluations() as counts:
            implicit.surface_quadrature(self.field, resolution)
        return sum(counts)

    track_area_error.unit = "relative error"
    track_volume_error.unit = "relative error"
    track_evaluations.unit = "points"


class Samples:
    """Points on a network's surface by each method."""

    params = sizes(["stratified", "uniform", "farthest", "rejection"], [1000, 10000])
    param_names = ("method", "points")

    def setup(self, method, points):
        if method in ("farthest", "rejection") and points > 1000:
            raise NotImplementedError("quadratic in the points")
        self.field = spot()

    def time_sample(self, method, points):
        implicit.sample_surface(self.field, points, method)

    def track_area_error(self, method, points):
        """Difference between the sum of the weights and the area."""
        area = float(implicit.surface_quadrature(self.field, 96).weights.sum())
        return abs(float(implicit.sample_surface(self.field, points, method).weights.sum()) / area - 1)

    track_area_error.unit = "relative error"
