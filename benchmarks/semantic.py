"""A semantic step at the published sizes beside one pass of the network, and how edits of the bundled models end."""

import time

import torch

import implicit
from benchmarks.common import is_quick, sizes
from implicit import families
from implicit.models import DeepSdf, DualSdf, ImNet
from implicit.surface.projection import newton_to_surface

MODELS = {"imnet": ImNet, "dualsdf": DualSdf, "deepsdf": DeepSdf}
POINTS = 100


class Step:
    """100 points on a level set of a network of published size, its weights random, its slope made one."""

    params = sizes(list(MODELS))
    param_names = ("architecture",)
    timeout = 300

    def setup(self, architecture):
        torch.manual_seed(0)
        self.decoder = MODELS[architecture]().eval().requires_grad_(False)
        self.code = 0.5 * torch.randn(self.decoder.latent)
        start = torch.rand(4000, 3) - 0.5
        # The last layer is shifted and scaled so that the surface passes among the points with a slope of one.
        head = self.decoder.deepsdf_net.net2[-1] if architecture == "dualsdf" else list(self.decoder.children())[-1]
        level, middle = self.decoder.level, self.decoder(start, self.code).median()
        if architecture == "imnet":
            linear = middle / 0.01 if middle < 0 else middle
        else:
            linear = torch.atanh(middle)
        head.bias += level - linear
        slope = self._field(level).gradient(start).norm(dim=1).median()
        head.weight /= slope
        head.bias.sub_(level).div_(slope).add_(level)
        self.field = self._field(level)
        placed, arrived = newton_to_surface(self.field, start, reach=0.5)
        self.points = placed[arrived][:POINTS]
        self.displacements = 0.01 * self.field.normal(self.points)

    def _field(self, level):
        return implicit.decoder_field(self.decoder, self.code, level=level, bounds=((-1, -1, -1), (1, 1, 1)))

    def one_pass(self):
        """Forward and backward to the points and the code of each."""
        points = self.points.detach().requires_grad_()
        codes = self.code.repeat(POINTS, 1).requires_grad_()
        return torch.autograd.grad(self.decoder(points, codes).sum(), (points, codes))

    def steps(self, count):
        # A stride so short that no edit is through before the last step.
        return implicit.semantic_edit(
            self.field, self.points, self.displacements, steps=count, stride=1e-4, tolerance=1e-3, damping=0.1
        )

    def time_pass(self, architecture):
        self.one_pass()

    def time_ten_steps(self, architecture):
        self.steps(10)

    def track_step(self, architecture):
        """A step without the start and the end of its edit, by the clock of the process."""
        return 1000 * self._step_seconds()

    def track_step_over_pass(self, architecture):
        return self._step_seconds() / median_seconds(self.one_pass)

    def _step_seconds(self):
        few, many = (median_seconds(lambda n=n: self.steps(n)) for n in (5, 25))
        return (many - few) / 20

    track_step.unit = "ms"
    track_step_over_pass.unit = "passes"


def median_seconds(call):
    seconds = []
    for _ in range(1 if is_quick() else 7):
        start = time.process_time()
        call()
        seconds.append(time.process_time() - start)
    return sorted(seconds)[len(seconds) // 2]


class Edits:
    """The top of a bundled chair's leg pushed up; accuracy beside time."""

    params = sizes(["deepsdf-chairs", "dualsdf-chairs", "imnet-chairs"])
    param_names = ("model",)
    timeout = 300

    def setup(self, name):
        model = families.bundled(name)
        self.field = model.field(model.latents[0])
        feet = implicit.HalfSpace((0, -0.45 * model.scale, 0), (0, -1, 0))
        handle = implicit.Handle(feet, (0.0, 0.1 * model.scale, 0.0))
        self.points, self.displacements = implicit.prescribe(self.field, handle)

    def edit(self):
        return implicit.semantic_edit(self.field, self.points, self.displacements)

    def time_edit(self, name):
        self.edit()

    def track_steps(self, name):
        return len(self.edit().history)

    def track_error(self, name):
        error = self.edit().error_field()
        return float(error[torch.isfinite(error)].square().mean().sqrt())

    track_steps.unit = "steps"
    track_error.unit = "of the largest displacement"
