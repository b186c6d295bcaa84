"""The trained step: the energy it trains on is that of the least squares, and training comes near its minimum."""

import pytest
import torch

from implicit import HalfSpace, Handle, rigid_edit, sample_surface, trained_rigid_step
from implicit.edits import trained_rigid_step as tangential_network
from implicit.edits.trained_rigid_step import (
    LearnedFeatures,
    StepEnergies,
    TrainingStatus,
    value_and_slope,
    vector_siren,
)
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import Killing, VectorTarget, total_energy
from implicit.step.tangential_basis import CosineFeatures

HANDLES = [
    Handle(HalfSpace((0, 0, -0.3), (0, 0, -1)), (0.0, 0, 0)),
    Handle(HalfSpace((0, 0, 0.3), (0, 0, 1)), (0, 0.03, 0.05)),
]


@pytest.fixture
def sample(wobbly):
    return sample_surface(wobbly, 200, "farthest", seed=1)


@pytest.mark.parametrize("parts", [(1.0, 1.0, 1.0), (0.1, 0.0, 1.0), (1.0, 0.0, 0.0)])
def test_the_energies_are_those_of_the_rows_of_the_least_squares(wobbly, sample, parts):
    """The same motion by two ways: turned rows of a linear basis, and J written out."""
    features = CosineFeatures(wobbly, waves=12)
    space = DeformationSpace(wobbly, features)
    x = torch.randn(space.size, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    d_theta, c = space.split(x)
    strain = Killing(sample.points, sample.weights, *parts)
    where = sample.points[:, 2] > 0.2
    target = torch.ones_like(sample.points[where])
    reach = VectorTarget(sample.points[where], target, 7 * sample.weights[where])
    T = features.values(sample.points) @ c.T
    dT = torch.einsum("njk,ik->nij", features.slopes(sample.points), c)
    E_K, E_C = StepEnergies.at(wobbly, strain, reach, where).values(d_theta, T, dT)
    assert float(E_K) == pytest.approx(total_energy([strain], space, x), rel=1e-10)
    assert float(E_C) == pytest.approx(total_energy([reach], space, x), rel=1e-10)


def test_slopes_of_the_network_match_differences(sample):
    network = vector_siren(8, 2, seed=0).to(torch.float64)
    torch.nn.init.normal_(network.layers[-1].weight, generator=torch.Generator().manual_seed(1))
    points, step = sample.points[:7], 1e-6
    values, slopes = value_and_slope(network, points)
    torch.testing.assert_close(values, network(points))
    for axis in range(3):
        way = step * torch.eye(3, dtype=torch.float64)[axis]
        measured = (network(points + way) - network(points - way)) / (2 * step)
        torch.testing.assert_close(slopes[:, :, axis], measured, rtol=1e-6, atol=1e-7)


def test_training_nears_the_least_squares_and_moves_the_handles(wobbly, sample):
    """The least squares is the minimum over a wide linear basis; the network starts at rest, a hundred times above."""
    features = CosineFeatures(wobbly, waves=100)
    step = trained_rigid_step(wobbly, HANDLES, points=sample, tangential=features, iterations=300)
    assert step.status is TrainingStatus.TRAINED
    assert len(step.losses) == 300
    assert step.losses[0] > 50 * step.energy
    assert step.energy == pytest.approx(step.losses[-1], rel=0.05)  # the last weights, in double
    assert step.strain < step.energy
    top = sample.points[:, 2] > 0.3
    moved = step.displacement(sample.points)[top]
    wanted = torch.tensor([0, 0.03, 0.05], dtype=torch.float64).expand_as(moved)
    assert float((moved - wanted).norm(dim=1).square().mean().sqrt()) < 0.1 * float(wanted[0].norm())


def test_a_tenth_of_the_motion_is_trained_as_well(wobbly, sample):
    """All is linear in the handles' motion, and what is trained does not depend on its size."""
    features = CosineFeatures(wobbly, waves=10)
    tenth = [HANDLES[0], Handle(HANDLES[1].region, (0.0, 0.003, 0.005))]
    whole, part = (
        trained_rigid_step(wobbly, handles, points=sample, tangential=features, iterations=20)
        for handles in (HANDLES, tenth)
    )
    assert part.energy == pytest.approx(whole.energy / 100, rel=1e-2)
    assert part.losses[-1] == pytest.approx(whole.losses[-1] / 100, rel=1e-2)


def test_anchors_alone_need_no_motion(wobbly, sample):
    handles = [Handle(HANDLES[0].region, (0.0, 0.0, 0.0))]
    step = trained_rigid_step(wobbly, handles, points=sample, tangential=CosineFeatures(wobbly, waves=5), iterations=2)
    assert step.energy < 1e-20
    assert float(step.displacement(sample.points).norm(dim=1).max()) < 1e-9


def test_one_seed_gives_one_step(wobbly, sample):
    features = CosineFeatures(wobbly, waves=10)
    steps = [
        trained_rigid_step(wobbly, HANDLES, points=sample, tangential=features, iterations=3, seed=s) for s in (4, 4, 5)
    ]
    assert torch.equal(steps[0].d_theta, steps[1].d_theta)
    assert not torch.equal(steps[0].network.layers[0].weight, steps[2].network.layers[0].weight)


def test_the_linear_energy_is_that_of_the_first_step_of_a_rigid_edit(wobbly, sample):
    """Of a motion so small that the edit keeps the damping it begins with."""
    features = CosineFeatures(wobbly, waves=30)
    handles = [HANDLES[0], Handle(HANDLES[1].region, (0.0, 0.0003, 0.0005))]
    step = trained_rigid_step(wobbly, handles, points=sample, tangential=features, iterations=1)
    edit = rigid_edit(wobbly, handles, points=sample, tangential=features, off_surface_strength=0.0)
    assert edit.history[0]["solves"] == 1
    assert edit.history[0]["objective"] == pytest.approx(step.linear_energy, rel=1e-6)
    first, second = repr(step).splitlines()
    assert first == f"TrainedStep: TRAINED, iterations 1, of {len(wobbly.theta)} parameters (float64, cpu)"
    assert second.startswith(f"  energy {step.energy:.4g}, of it strain {step.strain:.4g}, in ")


def test_the_least_squares_over_the_trained_features_is_at_least_as_good_as_the_training(wobbly, sample):
    handles = [HANDLES[0], Handle(HANDLES[1].region, (0.0, 0.0003, 0.0005))]
    features = CosineFeatures(wobbly, waves=5)
    step = trained_rigid_step(wobbly, handles, points=sample, tangential=features, iterations=60)
    edit = rigid_edit(wobbly, handles, points=sample, tangential=LearnedFeatures(step.network))
    assert edit.history[0]["objective"] < step.energy


def test_slopes_of_the_learned_features_match_differences(sample):
    features = LearnedFeatures(vector_siren(8, 2, seed=0).to(torch.float64))
    points, step = sample.points[:7], 1e-6
    assert features.values(points).shape == (7, features.count)
    for axis in range(3):
        way = step * torch.eye(3, dtype=torch.float64)[axis]
        measured = (features.values(points + way) - features.values(points - way)) / (2 * step)
        torch.testing.assert_close(features.slopes(points)[:, axis], measured, rtol=1e-6, atol=1e-7)


def test_a_training_that_blows_up_says_so_and_keeps_the_last_finite_weights(wobbly, sample, monkeypatch):
    """Adam's first step is as long as its rate: so long that the energy overflows, and the start is what is left."""
    monkeypatch.setattr(tangential_network, "NETWORK_RATE", 1e30)
    features = CosineFeatures(wobbly, waves=5)
    step = trained_rigid_step(wobbly, HANDLES, points=sample, tangential=features, iterations=5)
    assert step.status is TrainingStatus.NOT_FINITE
    assert len(step.losses) == 1
    assert step.energy == pytest.approx(step.losses[0], rel=1e-5)
    assert not step.d_theta.any()


def test_progress_is_told_of_every_iteration(wobbly, sample):
    told = []
    features = CosineFeatures(wobbly, waves=5)
    trained_rigid_step(
        wobbly, HANDLES, points=sample, tangential=features, iterations=3, progress=lambda *news: told.append(news[:2])
    )
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_a_training_without_iterations_is_refused(wobbly):
    with pytest.raises(ValueError, match="iterations must be at least 1"):
        trained_rigid_step(wobbly, HANDLES, iterations=0)
