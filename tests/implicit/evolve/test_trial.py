"""A step tried at growing damping, on a sphere whose radius is no linear function of its parameter."""

import math

import pytest
import torch
from torch import nn

from implicit import Field, sample_surface, shapes
from implicit.evolve.constraints import Penalty
from implicit.evolve.damping import AdaptiveDamping, LinearisationError
from implicit.evolve.edit import EditStatus
from implicit.evolve.trial import Attempt, StepRefused, Trial, normal_correction
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import DampingRule, Projection, StepProblem, assemble, newton_projection

R = 0.4


class ExponentialBall(nn.Module):
    """|x| - R exp(a), so that a change of a grows the radius by R (exp(da) - 1), to first order by R da."""

    def __init__(self):
        super().__init__()
        self.a = nn.Parameter(torch.zeros((), dtype=torch.float64))

    def forward(self, points):
        return points.norm(dim=1) - R * torch.exp(self.a)


def attempt(growth, rule=None, project=newton_projection):
    """The ball told to grow by a part of its radius."""
    field = Field(ExponentialBall())
    sample = sample_surface(field, 50, resolution=16)
    target = NormalTarget(sample.points, torch.full_like(sample.weights, growth * R), sample.weights)
    problem = StepProblem(DeformationSpace(field), [target], rule or DampingRule(), project=project)
    return Attempt(problem, assemble(problem), Penalty(1.0), None, sample.points, 16, 0.995)


def tries_by_hand(growth):
    """Of the relative damping p the step is da = growth / (1 + p): when is exp(da) - 1 - da within what is allowed?"""
    for k in range(16):
        p = 1e-7 * 10 ** (k / 2)
        da = growth / (1 + p)
        if math.exp(da) - 1 - da <= max(0.02 * da, min(growth - da, 0.2 * da)):
            return k + 1, p
    raise AssertionError("the ball never grows linearly enough")


@pytest.mark.parametrize("growth", [0.01, 0.05, 0.2, 0.5, 1.0])
def test_the_damping_grows_until_the_exponential_is_straight_enough(growth):
    trial, damping = attempt(growth).accepted(AdaptiveDamping())
    tries, p = tries_by_hand(growth)
    assert trial.solves == tries
    assert float(trial.x) == pytest.approx(growth / (1 + p), rel=1e-6)
    assert trial.error.missed == pytest.approx(R * (math.exp(float(trial.x)) - 1 - float(trial.x)), rel=1e-5)
    assert damping.current <= p * (1 + 1e-9)


def test_a_fixed_damping_is_tried_once():
    trial, _ = attempt(0.5, DampingRule(fixed=0.0)).accepted(AdaptiveDamping())
    assert trial.solves == 1
    assert float(trial.x) == pytest.approx(0.5)


def test_a_try_after_which_points_are_lost_is_tried_again():
    """They are said to be lost where the ball has grown by more than a hundredth."""

    def project(field, points, reach):
        there = newton_projection(field, points, reach)
        return Projection(there.points, there.arrived & (field.theta < 0.01))

    trial, _ = attempt(0.015, project=project).accepted(AdaptiveDamping())
    assert trial.solves > 1
    assert float(trial.x) < 0.01


def test_a_step_that_loses_the_surface_at_any_damping_is_refused():
    def project(field, points, reach):
        raise ValueError("no surface")

    with pytest.raises(StepRefused) as refused:
        attempt(0.1, project=project).accepted(AdaptiveDamping())
    assert refused.value.status is EditStatus.SURFACE_LOST


def test_a_step_towards_no_number_is_refused():
    with pytest.raises(StepRefused) as refused:
        attempt(float("nan")).accepted(AdaptiveDamping())
    assert refused.value.status is EditStatus.NOT_FINITE


def test_what_a_step_misses_of_a_translation_is_made_up_along_the_normals():
    """A step that was to move a ball by t and moved nothing: the correction moves its centre by t."""
    t = torch.tensor([0.05, -0.02, 0.03], dtype=torch.float64)
    field = shapes.sphere(0.5, parameters=["center"])
    sample = sample_surface(field, 100, resolution=16)
    problem = StepProblem(DeformationSpace(field), [], correction_weights=sample.weights)
    stays = Projection(sample.points, torch.ones(100, dtype=torch.bool))
    predicted = t.expand(100, 3)
    solution = assemble(
        StepProblem(problem.space, [NormalTarget(sample.points, sample.weights, sample.weights)])
    ).solve()
    trial = Trial(solution, torch.zeros_like(t), field, predicted, stays, 0.5, LinearisationError(0.0, 1.0), 1)
    torch.testing.assert_close(normal_correction(problem, trial, sample.points, sample.weights), t, atol=1e-9, rtol=0)
