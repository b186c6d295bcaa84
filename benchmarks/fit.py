"""Error of a fit against the seconds that it took, for each method of training."""

import math

import torch

import implicit
from benchmarks.common import sizes
from implicit import shapes


class Fit:
    """The bracket, a shape with edges and three holes, in the paper's network."""

    params = sizes(["soap", "adam"], [1, 4, 16])
    param_names = ("method", "seconds")
    timeout = 120

    def setup(self, method, seconds):
        shape = shapes.bracket()
        generator = torch.Generator().manual_seed(0)
        surface = implicit.sample_surface(shape, 40_000).points
        near = [surface + s * torch.randn(surface.shape, generator=generator).to(surface) for s in (0.005, 0.02, 0.06)]
        fill = 2.2 * torch.rand(20_000, 3, generator=generator).to(surface) - 1.1
        self.points = torch.cat([surface, *near, fill])
        value, gradient = shape.value_and_gradient(self.points)
        length = gradient.norm(dim=1)
        # The shape is no exact distance; to first order, its value over its slope is.
        self.samples = self.points, value / length, gradient / length[:, None]
        self.shape, self.surface = shape, surface.float()

    def fitted(self, method, seconds):
        return implicit.fit_field(*self.samples, method=method, seconds=seconds, steps=100_000)[0]

    def track_surface_error(self, method, seconds):
        """Root mean square distance from the surface, over the diagonal of its box."""
        field = self.fitted(method, seconds)
        value, gradient = field.value_and_gradient(self.surface)
        diagonal = float((self.surface.amax(0) - self.surface.amin(0)).norm())
        return math.sqrt(float((value / gradient.norm(dim=1)).square().mean())) / diagonal

    track_surface_error.unit = "of the diagonal"
