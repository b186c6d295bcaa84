"""Edit neural fields f(x; theta) directly: geometric, rigid, smoothing, under constraints, with no mesh in between.

The method is boundary sensitivity [Berzins, Ibing, Kobbelt: Neural Implicit Shape Editing using Boundary
Sensitivity, ICLR 2023, arXiv:2304.12951].
"""
# The groups follow the paper: its edits, what they ask and hold, how the surface moves, the surface, the function.
# ruff: noqa: I001

# Geometric and semantic editing [sections 4.1 and 4.2]
from implicit.edits.geometric import geometric_edit
from implicit.edits.expressibility import Expressibility, Verdict, expressibility
from implicit.edits.semantic import prescribe, semantic_edit
from implicit.edits.code_prior import CodePrior

# Rigid editing [section 4.3]
from implicit.edits.rigid import rigid_edit
from implicit.edits.trained_rigid_step import LearnedFeatures, TrainedStep, trained_rigid_step
from implicit.edits.tangential_motion import ConstantNormals, NearIsometric

# Smoothing and other flows [section 4.4]
from implicit.edits.smoothing import Until, explicit_step_limit, smooth
from implicit.edits.converged_smoothing import ConvergedSmoothing, converged_smooth
from implicit.edits.flows import Bending, MeanCurvature, Offset

# What an edit asks for, what it holds, and what it gives back
from implicit.edits.handles import Along, Handle, RigidMotion, Scaling
from implicit.edits.regions import Ball, Box, HalfSpace, NearPoints, PickedVertices, Region
from implicit.evolve.constraints import Holding
from implicit.evolve.edit import Edit, EditStatus

# Boundary sensitivity [eq. 3], its basis functions, and shape functionals [eq. 7]
from implicit.sensitivity.boundary_sensitivity import adjoint, basis, normal_displacement
from implicit.sensitivity.basis_function import BasisFunction, basis_function, one_weight_per_layer
from implicit.sensitivity.surface_modes import SurfaceModes, mirror_symmetry, surface_modes
from implicit.sensitivity.shape_functionals import (
    Area,
    Functional,
    Integral,
    SurfaceIntegral,
    Volume,
    VolumeIntegral,
    integrate,
)

# The surface f = 0: mesh, samples, quadrature, pieces
from implicit.surface.extraction import extract_mesh
from implicit.surface.projection import project_to_surface
from implicit.surface.quadrature import SurfaceSample, surface_quadrature
from implicit.surface.sampling import sample_surface, transport
from implicit.surface.soundness import Soundness, field_soundness
from implicit.surface.topology import Topology, mesh_topology, surface_topology

# The function f(x; theta): fields, networks, files, fits
from implicit.field.field import Field, SurfaceError, Units
from implicit.field.decoder import decoder_field
from implicit.models.field_file import load_field, save_field
from implicit.models.checkpoints import load_checkpoint, load_network
from implicit.models.siren import Siren
from implicit.fitting.fit import FitStatus, Training, fit_field
from implicit.fitting.follow import Following, follow_surface
from implicit import families, models, shapes

__all__ = [
    "geometric_edit", "expressibility", "Expressibility", "Verdict",
    "semantic_edit", "prescribe", "CodePrior",
    "rigid_edit", "trained_rigid_step", "TrainedStep", "LearnedFeatures", "ConstantNormals", "NearIsometric",
    "smooth", "converged_smooth", "ConvergedSmoothing", "Until", "explicit_step_limit",
    "MeanCurvature", "Bending", "Offset",
    "Handle", "Along", "RigidMotion", "Scaling", "Ball", "Box", "HalfSpace", "NearPoints", "PickedVertices", "Region",
    "Holding", "Edit", "EditStatus",
    "basis", "normal_displacement", "adjoint", "basis_function", "BasisFunction", "one_weight_per_layer",
    "surface_modes", "SurfaceModes", "mirror_symmetry",
    "Volume", "Area", "VolumeIntegral", "SurfaceIntegral", "Integral", "Functional", "integrate",
    "extract_mesh", "project_to_surface", "surface_quadrature", "SurfaceSample", "sample_surface", "transport",
    "field_soundness", "Soundness", "surface_topology", "mesh_topology", "Topology",
    "Field", "Units", "SurfaceError", "decoder_field", "save_field", "load_field", "load_checkpoint", "load_network",
    "Siren", "fit_field", "Training", "FitStatus", "follow_surface", "Following",
    "shapes", "models", "families",
]  # fmt: skip
