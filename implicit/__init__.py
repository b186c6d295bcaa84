"""Edit neural fields f(x; theta) directly: geometric, rigid, smoothing, under constraints, with no mesh in between.

The method is boundary sensitivity [Berzins, Ibing, Kobbelt: Neural Implicit Shape Editing using Boundary
Sensitivity, ICLR 2023, arXiv:2304.12951].
"""

from implicit.basis_function import BasisFunction, basis_function, one_weight_per_layer
from implicit.checkpoints import load_checkpoint
from implicit.decoder import decoder_field
from implicit.edit import Edit, EditStatus
from implicit.expressibility import Expressibility, Verdict, expressibility
from implicit.extraction import extract_mesh, project_to_surface
from implicit.field import Field, SurfaceError, Units
from implicit.field_file import load_field, save_field
from implicit.fit import FitStatus, Training, fit_field
from implicit.flows import Bending, MeanCurvature, Offset
from implicit.functionals import Area, Functional, Integral, SurfaceIntegral, Volume, VolumeIntegral, integrate
from implicit.geometric import geometric_edit
from implicit.guard import Holding
from implicit.models import Siren
from implicit.modes import SurfaceModes, mirror_symmetry, surface_modes
from implicit.regions import Along, Ball, Box, HalfSpace, Handle, NearPoints, Region, RigidMotion
from implicit.rigid import rigid_edit
from implicit.sampling import sample_surface, transport
from implicit.semantic import CodePrior, prescribe, semantic_edit
from implicit.sensitivity import adjoint, basis, normal_displacement
from implicit.slide import ConstantNormals, NearIsometric
from implicit.smoothing import Until, explicit_step_limit, smooth
from implicit.soundness import Soundness, field_soundness
from implicit.surface import SurfaceSample, surface_quadrature
from implicit.tangential_network import LearnedFeatures, TrainedStep, trained_rigid_step
from implicit.topology import Topology, mesh_topology, surface_topology

__all__ = [
    "Along",
    "Area",
    "Ball",
    "BasisFunction",
    "Bending",
    "Box",
    "CodePrior",
    "ConstantNormals",
    "Edit",
    "EditStatus",
    "Expressibility",
    "Field",
    "FitStatus",
    "Functional",
    "HalfSpace",
    "Handle",
    "Holding",
    "Integral",
    "LearnedFeatures",
    "MeanCurvature",
    "NearIsometric",
    "NearPoints",
    "Offset",
    "Region",
    "RigidMotion",
    "Siren",
    "Soundness",
    "SurfaceError",
    "SurfaceIntegral",
    "SurfaceModes",
    "SurfaceSample",
    "Topology",
    "TrainedStep",
    "Training",
    "Units",
    "Until",
    "Verdict",
    "Volume",
    "VolumeIntegral",
    "adjoint",
    "basis",
    "basis_function",
    "decoder_field",
    "explicit_step_limit",
    "expressibility",
    "extract_mesh",
    "field_soundness",
    "fit_field",
    "geometric_edit",
    "integrate",
    "load_checkpoint",
    "load_field",
    "mirror_symmetry",
    "normal_displacement",
    "prescribe",
    "mesh_topology",
    "one_weight_per_layer",
    "project_to_surface",
    "rigid_edit",
    "sample_surface",
    "save_field",
    "semantic_edit",
    "smooth",
    "surface_modes",
    "surface_quadrature",
    "surface_topology",
    "trained_rigid_step",
    "transport",
]
