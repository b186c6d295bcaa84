"""What an operation states of a step, and the least squares of it, on a ball."""

import pytest
import torch

from implicit import sample_surface, shapes
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import NormalTarget
from implicit.step.problem import StepProblem, assemble, newton_projection, predicted_displacement


@pytest.fixture
def ball():
    return shapes.sphere(0.5, parameters=["radius"])


@pytest.fixture
def sample(ball):
    return sample_surface(ball, 40, resolution=16)


def test_the_minimiser_is_the_mean_of_what_the_points_ask(ball, sample):
    """Of a ball that can only grow: the weighted mean of the targets."""
    target = torch.linspace(0.0, 0.1, 40, dtype=torch.float64)
    system = assemble(StepProblem(DeformationSpace(ball), [NormalTarget(sample.points, target, sample.weights)]))
    mean = float(sample.weights @ target / sample.weights.sum())
    assert float(system.solve(0.0).x) == pytest.approx(mean, rel=1e-9)


@pytest.mark.parametrize("count", [40, 25], ids=["all-points", "the-first"])
def test_tangential_motion_adds_to_that_of_the_space(ball, sample, count):
    """A ball that grows by 0.02 and turns: n 0.02 + omega x p, of the first points only where that is of these."""
    omega = torch.tensor([0.1, 0.2, -0.3], dtype=torch.float64)
    turn = torch.linalg.cross(omega.expand(40, 3), sample.points)
    problem = StepProblem(DeformationSpace(ball), [], tangential_motion=turn[:count])
    predicted = predicted_displacement(problem, torch.tensor([0.02], dtype=torch.float64), sample.points)
    wanted = 0.02 * sample.normals
    wanted[:count] += turn[:count]
    torch.testing.assert_close(predicted, wanted, atol=1e-12, rtol=0)


def test_points_are_projected_no_farther_than_the_reach(ball, sample):
    out = 1.2 * sample.points
    near, far = newton_projection(ball, out, 0.11), newton_projection(ball, out, 0.09)
    torch.testing.assert_close(near.points, sample.points, atol=1e-11, rtol=0)
    assert bool(near.arrived.all())
    assert not bool(far.arrived.any())


@pytest.mark.parametrize("option", ["correction_weights", "tangential_motion"])
def test_what_is_of_tracked_points_takes_no_probe(ball, sample, option):
    value = {"correction_weights": sample.weights, "tangential_motion": sample.normals}[option]
    with pytest.raises(ValueError, match="take no probe"):
        StepProblem(DeformationSpace(ball), [], probe=sample.points, **{option: value})


def test_an_energy_without_products_is_refused_where_the_rows_would_not_fit(ball, sample, monkeypatch):
    class Bare:
        def rows(self, space):
            return iter(())

    monkeypatch.setattr("implicit.step.problem.DENSE_LIMIT", 0)
    with pytest.raises(ValueError, match="Bare energy"):
        assemble(StepProblem(DeformationSpace(ball), [Bare()]))
