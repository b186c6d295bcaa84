"""The same answers on a graphics card as on the processor; skipped where there is none."""

import pytest
import torch

from implicit import (
    Along,
    Ball,
    Handle,
    Volume,
    extract_mesh,
    geometric_edit,
    integrate,
    rigid_edit,
    sample_surface,
    shapes,
    smooth,
)
from implicit.sensitivity.boundary_sensitivity import basis
from tests.implicit.architectures import ARCHITECTURES, OPERATIONS, Subject, rows_of
from tests.implicit.test_architectures import coarse_draws, subject, wrong_in  # noqa: F401

pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
    pytest.mark.filterwarnings("ignore:The module cannot be vectorised"),
]
BUMP = Handle(Ball((0.0, 0.5, 0.3), 0.25, falloff=0.3), Along(0.03))


@pytest.fixture
def pair():
    """Spot on both, in float64."""
    field = shapes.bundled("spot").to(torch.float64)
    return field, field.to(device="cuda")


def test_sensitivities_agree(pair):
    here, there = pair
    points = sample_surface(here, 500).points
    torch.testing.assert_close(basis(there, points.cuda()).cpu(), basis(here, points), rtol=1e-8, atol=1e-10)


def test_integrals_and_meshes_agree(pair):
    here, there = pair
    assert integrate(there, Volume(), 48).value == pytest.approx(integrate(here, Volume(), 48).value, rel=1e-8)
    V, F = extract_mesh(there, 48)
    W, G = extract_mesh(here, 48)
    assert F.shape == G.shape
    assert abs(V - W).max() < 1e-5  # marching cubes places them on edges in single precision
    for field, vertices in ((here, V), (there, W)):
        assert float(field.value(torch.from_numpy(vertices).to(field.theta)).abs().max()) < 1e-9


@pytest.mark.parametrize("points", [1500, 3000], ids=["dual", "primal"])
def test_geometric_edits_agree(pair, points):
    edits = []
    for field in pair:
        sample = sample_surface(pair[0], points).to(device=field.device)
        edits.append(geometric_edit(field, BUMP, steps=2, points=sample))
    assert edits[1].field.theta.is_cuda
    torch.testing.assert_close(edits[1].displacement.cpu(), edits[0].displacement, rtol=0, atol=1e-4 * 0.03)


def test_smoothing_under_a_constraint_agrees(pair):
    values = [smooth(field, steps=2, points=800, constraints=[Volume()]).history[-1]["volume"] for field in pair]
    assert values[1] == pytest.approx(values[0], rel=1e-6)


def test_rigid_edits_agree(pair):
    held = Handle(Ball((0.0, -0.7, 0.0), 0.3), (0.0, 0.0, 0.0))
    pulled = Handle(Ball((0.0, -0.2, 0.75), 0.3), (0.0, 0.1, 0.0))
    moved = []
    for field in pair:
        sample = sample_surface(pair[0], 400).to(device=field.device)
        moved.append(rigid_edit(field, [held, pulled], method="linear", points=sample).displacement.cpu())
    torch.testing.assert_close(moved[1], moved[0], rtol=0, atol=1e-4 * 0.1)


def test_far_pulls_agree(pair):
    """By finite rotations: the mesh, its energy and the field that follows, all of them sums in another order."""
    held = Handle(Ball((0.0, -0.7, 0.0), 0.3), (0.0, 0.0, 0.0))
    pulled = Handle(Ball((0.0, -0.2, 0.75), 0.3), (0.0, 0.25, 0.0))
    here, there = (rigid_edit(field, [held, pulled], method="finite") for field in pair)
    assert there.status is here.status
    assert there.field.theta.is_cuda
    points = extract_mesh(here.field, 32)[0]
    off = there.field.value(torch.from_numpy(points).to(there.field.theta)).abs()
    assert float(off.max()) < 0.01


@pytest.mark.parametrize("name", ARCHITECTURES)
@pytest.mark.parametrize("operation", OPERATIONS)
def test_each_architecture_goes_through_each_operation_there(name, operation):
    here = subject(name)
    there = Subject(here.architecture, here.field.to(device="cuda"), here.sizes)
    found = OPERATIONS[operation](there)
    if "weight norm" in name and operation == "basis" and found["motion"] < 0.01:
        found["motion"] = 0.0  # torch's kernel takes norms in single precision, which differences of 1e-5 magnify
    assert wrong_in(ARCHITECTURES[name], operation, found) == []


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_the_rows_of_each_are_found_as_the_table_says_there(name):
    field = subject(name).field.to(device="cuda")
    assert rows_of(field, sample_surface(field, 50, resolution=10).points) == ARCHITECTURES[name].rows
