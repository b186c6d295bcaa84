"""The figures of rigid editing, quickly: their pictures, and what they find."""

from math import pi

import numpy as np
import pytest
import torch

from compare import Case, prepare_subject
from compare.paper import Request, draw_parts
from compare.paper.rigid_bends import arap_along_the_path, turning_handles
from compare.runs.operations import target_motion
from implicit import save_field, shapes


@pytest.mark.nightly
def test_the_rigid_figure_finds_the_energies_of_all_three_sides(tmp_path):
    findings = draw_parts(Request(tmp_path, quick=True), ["rigid"])
    assert (tmp_path / "rigid.png").stat().st_size > 10_000

    def of(what):
        """The finding of each side that begins so."""
        sides = ("neural field", "mesh, Killing", "mesh, ARAP")
        return {s: next(f for f in findings if f.what.startswith(f"cactus, {s}: {what}")) for s in sides}

    energies = {side: finding.ours for side, finding in of("spokes and rims energy").items()}
    assert min(energies, key=energies.get) == "mesh, Killing"  # which minimises just this
    arap = {side: finding.ours for side, finding in of("ARAP energy").items()}
    assert min(arap, key=arap.get) == "mesh, ARAP"
    assert of("rms distance of the handles")["mesh, Killing"].ours == 0
    assert [finding.paper for finding in of("unweighted energy").values()] == [6.0, 11.0, None]


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    path = tmp_path_factory.mktemp("rod") / "rod.safetensors"
    save_field(shapes.rounded_box((0.15, 0.7, 0.2), 0.1), path)
    return str(path), prepare_subject(Case(str(path), "smooth", vertices=600, resolution=32))


@pytest.mark.parametrize(("what", "axis"), [("twist", 1), ("bend", 2)])
def test_one_end_stays_and_the_other_turns_by_the_angle(rod, what, axis):
    shape, subject = rod
    case = Case(shape, "rigid", turning_handles(subject, what, 60.0))
    target = target_motion(case, subject)
    assert not target.displacement[target.handle == 1].any()
    before = subject.V[target.handle == 2]
    after = before + target.displacement[target.handle == 2]
    rotation = torch.linalg.matrix_exp(_cross(axis, pi / 3)).numpy()
    turned = (before - before.mean(axis=0)) @ rotation.T
    np.testing.assert_allclose(after - after.mean(axis=0), turned, atol=1e-4)


def test_arap_along_a_path_arrives_where_the_handles_are_sent(rod):
    shape, subject = rod
    case = Case(shape, "rigid", turning_handles(subject, "twist", 90.0))
    target = target_motion(case, subject)
    result = arap_along_the_path(subject, case, 3)
    assert result.converged
    moved = result.V
    np.testing.assert_allclose((moved - subject.V)[target.at], target.displacement[target.at], atol=1e-9)


def _cross(axis, angle):
    matrix = torch.zeros(3, 3, dtype=torch.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, i], matrix[i, j] = angle, -angle
    return matrix
