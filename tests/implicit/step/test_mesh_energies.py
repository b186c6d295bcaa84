"""Energies on a mesh against closed forms, on balls and tori."""

import math

import numpy as np
import pytest
import torch

from implicit import extract_mesh, shapes
from implicit.sensitivity.weak_curvature import WeakSurface
from implicit.step.deformation import DeformationSpace
from implicit.step.energies import total_energy
from implicit.step.mesh_energies import MeshNormalMotion
from implicit.step.mesh_killing import MeshKilling, vertex_displacement_rows
from implicit.step.tangential_basis import CosineFeatures


def surface_of(field, resolution):
    return WeakSurface(*extract_mesh(field, resolution))


def test_the_motion_of_a_growing_ball_meets_its_target_and_has_no_slope():
    """u = 1 everywhere: sum M (1 - 0.25)^2 = 0.75^2 area, and a Dirichlet energy of zero."""
    field = shapes.sphere(0.5)
    surface = surface_of(field, 16)
    nothing = np.zeros(len(surface.vertices))
    target = MeshNormalMotion(surface, nothing + 0.25, surface.masses, np.full(len(surface.faces), 3.0))
    grown = torch.eye(len(field.theta), dtype=torch.float64)[0]
    cosine = (surface.normals * surface.vertices).sum(axis=1) / 0.5
    exact = surface.masses @ (1 / cosine - 0.25) ** 2
    slopes = MeshNormalMotion(surface, nothing, nothing, np.full(len(surface.faces), 3.0))
    space = DeformationSpace(field)
    assert total_energy([target], space, grown) == pytest.approx(exact, rel=1e-2)
    assert total_energy([slopes], space, grown) < 1e-2 * exact


def test_the_dirichlet_energy_of_a_shifted_ball_tends_to_its_closed_form():
    """u = n . c is a first spherical harmonic: int |grad u|^2 = 2 / R^2 int u^2 = 8 pi / 3 |c|^2, to second order."""
    errors = []
    for resolution in (16, 32):
        surface = surface_of(shapes.sphere(0.5), resolution)
        u = surface.vertices @ np.array([2.0, 0.0, 0.0])
        G, weights = surface.gradient
        errors.append(abs(weights @ (G @ u) ** 2 / (8 * math.pi / 3) - 1))
    assert errors[1] < 1e-2
    assert errors[0] / errors[1] > 3


@pytest.mark.parametrize("bending", [0.0, 1.0])
def test_a_rigid_motion_costs_nothing(bending):
    surface = surface_of(shapes.torus(0.6, 0.25), 16)
    moved = np.cross([0.3, 0.2, -0.5], surface.vertices) + np.array([1.0, 2.0, 3.0])
    assert MeshKilling(surface, bending).energy(moved) < 1e-20


def test_the_membrane_energy_of_growing_a_ball_is_32_pi():
    """D = n on a unit ball: J = P, |P (J + J^T) P|^2 = 8 everywhere."""
    energies = []
    for resolution in (16, 32):
        surface = surface_of(shapes.sphere(0.5), resolution)
        energies.append(abs(MeshKilling(surface, 0.0).energy(surface.vertices / 0.5) / (32 * math.pi) - 1))
    assert energies[1] < 5e-3
    assert energies[0] / energies[1] > 3


def test_the_membrane_energy_of_stretching_a_ball_along_an_axis_has_its_closed_form():
    """D = (0, 0, z): P (J + J^T) P = 2 t t^T with t = P e_z, so int 4 (1 - n_z^2)^2 = 4 R^2 2 pi 16 / 15."""
    surface = surface_of(shapes.sphere(0.5), 32)
    stretched = surface.vertices * np.array([0.0, 0.0, 1.0])
    assert MeshKilling(surface, 0.0).energy(stretched) == pytest.approx(4 * 0.25 * 2 * math.pi * 16 / 15, rel=5e-3)


def test_bending_falls_with_the_square_of_the_cell():
    """Of the bending of a ball z -> z + x y, whose membrane part tends to a number: cells are what resists it."""
    parts = []
    for resolution in (16, 32):
        surface = surface_of(shapes.sphere(0.5), resolution)
        x, y, _ = surface.vertices.T
        moved = np.stack([0 * x, 0 * x, x * y], axis=1)
        parts.append(MeshKilling(surface, 1.0).energy(moved) - MeshKilling(surface, 0.0).energy(moved))
    assert parts[1] > 0
    assert parts[0] / parts[1] == pytest.approx(4, rel=0.25)


def test_the_rows_have_the_energy_of_the_displacement_they_stand_for():
    """E_K over parameters and tangential coefficients together, by its triangular factor."""
    field = shapes.ellipsoid((0.5, 0.4, 0.3))
    space = DeformationSpace(field, CosineFeatures(field, waves=5))
    surface = surface_of(field, 12)
    x = torch.randn(space.size, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    energy = MeshKilling(surface, 0.7)
    moved = (vertex_displacement_rows(space, surface) @ x).reshape(-1, 3).numpy()
    assert total_energy([energy], space, x) == pytest.approx(energy.energy(moved), rel=1e-8)


def test_vertices_of_the_mesh_move_as_the_space_says():
    """A growing radius and a shift by the tangential basis, where the normals of the mesh tend to those of a ball."""
    field = shapes.sphere(0.5)
    space = DeformationSpace(field, CosineFeatures(field, waves=1))
    x = torch.zeros(space.size, dtype=torch.float64)
    x[0], x[space.parameters] = 0.3, 1.0
    misses = []
    for resolution in (24, 48):
        surface = surface_of(field, resolution)
        moved = (vertex_displacement_rows(space, surface) @ x).reshape(-1, 3)
        misses.append(float((moved - space.displacement(torch.from_numpy(surface.vertices), x)).square().mean().sqrt()))
    assert misses[1] < 0.02
    assert misses[0] / misses[1] > 1.7
