"""The training loop: its schedule, its end, and what it keeps."""

import math

import pytest
import torch
from torch import nn

from implicit.fitting.training import Checkpoint, FitStatus, Schedule, TrainingRun


class Line:
    """A linear layer and a number that learn y = 2 x + 1 and 3; from the step `until` on the loss is NaN."""

    def __init__(self, until=None):
        self.net, self.number = nn.Linear(1, 1), torch.zeros((), requires_grad=True)
        with torch.no_grad():
            self.net.weight.fill_(0.5)
            self.net.bias.fill_(0.0)
        self.until, self.calls = until, 0

    def modules(self):
        return {"line": self.net}

    def others(self):
        return [self.number]

    def loss(self, generator):
        self.calls += 1
        x = torch.rand(16, 1, generator=generator)
        loss = (self.net(x) - 2 * x - 1).square().mean() + (self.number - 3).square()
        return loss * math.nan if self.until is not None and self.calls > self.until else loss

    def reported(self, loss):
        return float(loss)


def run_of(learner, schedule, **options):
    return TrainingRun(learner, torch.Generator().manual_seed(0), schedule, **options)


def test_the_rate_rises_over_fifty_steps_and_falls_along_a_cosine():
    schedule = Schedule(1000, 1.0, 10.0)
    assert schedule.rates(0, 0.0) == pytest.approx((1 / 50, 10 / 50))
    assert schedule.rates(500, 0.5) == pytest.approx((0.5, 5.0))
    assert schedule.rates(999, 0.75)[0] == pytest.approx(0.5 - 0.5**1.5)
    assert schedule.rates(1000, 1.0)[0] == pytest.approx(1e-3)


def test_the_time_counts_where_it_is_ahead_of_the_steps():
    schedule = Schedule(100, 1.0, seconds=10.0)
    assert schedule.done(10, 9.0) == 0.9
    assert schedule.done(95, 9.0) == 0.95
    assert Schedule(100, 1.0).done(10, 1e9) == 0.1


@pytest.mark.parametrize("rotate", [True, False])
def test_a_line_and_a_number_are_learned(rotate):
    learner = Line()
    run = run_of(learner, Schedule(600, 0.1, 0.1), rotate=rotate)
    assert run.train() is FitStatus.DONE
    assert float(learner.net.weight.detach()) == pytest.approx(2, abs=1e-2)
    assert float(learner.net.bias.detach()) == pytest.approx(1, abs=1e-2)
    assert float(learner.number.detach()) == pytest.approx(3, abs=1e-2)
    assert [row.step for row in run.history] == list(range(6, 601, 6))


def test_after_a_loss_that_is_not_finite_all_is_as_it_last_was():
    learner, before = Line(until=40), Line()
    run = run_of(learner, Schedule(100, 0.1, 0.1))
    assert run.train() is FitStatus.DIVERGED
    assert run.history[-1].step == 40
    same = run_of(before, Schedule(100, 0.1, 0.1))

    def stop(step, steps, loss):
        if step == 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        same.train(stop)
    assert torch.equal(learner.net.weight, before.net.weight)
    assert torch.equal(learner.number, before.number)


def test_a_training_that_is_out_of_time_takes_no_step(tmp_path):
    learner = Line()
    kept = Checkpoint(tmp_path / "state.safetensors", "test-1", "line")
    run = run_of(learner, Schedule(100, 0.1, 0.1, seconds=1.0), checkpoint=kept, start=-1e9)
    assert run.train() is FitStatus.OUT_OF_TIME
    assert (run.step, learner.calls) == (0, 0)
    assert kept.read()[1] == 0


def test_a_checkpoint_tells_what_it_belongs_to(tmp_path):
    path = tmp_path / "state.safetensors"
    run_of(Line(), Schedule(4, 0.1, 0.1), checkpoint=Checkpoint(path, "test-1", "line")).train()
    other = Checkpoint(path, "test-1", "curve", training="fit")
    with pytest.raises(ValueError, match=r"belongs to another fit: line, wanted curve\. Remove it"):
        run_of(Line(), Schedule(4, 0.1, 0.1), checkpoint=other)
