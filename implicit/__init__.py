"""Edit neural fields f(x; theta) directly: geometric, rigid, smoothing, under constraints, with no mesh in between.

The method is boundary sensitivity [Berzins, Ibing, Kobbelt: Neural Implicit Shape Editing using Boundary
Sensitivity, ICLR 2023, arXiv:2304.12951].
"""

from implicit.checkpoints import load_checkpoint
from implicit.evolve import Edit, EditStatus
from implicit.extraction import SurfaceError, extract_mesh, project_to_surface
from implicit.field import Field, Units, decoder_field, load_field, save_field
from implicit.fit import FitStatus, Training, fit_field
from implicit.functionals import Area, Functional, Integral, SurfaceIntegral, Volume, VolumeIntegral, integrate
from implicit.geometric import geometric_edit
from implicit.models import Siren
from implicit.modes import SurfaceModes, mirror_symmetry, surface_modes
from implicit.regions import Along, Ball, Box, HalfSpace, Handle, NearPoints, Region, RigidMotion
from implicit.rigid import rigid_edit
from implicit.sampling import sample_surface
from implicit.semantic import CodePrior, prescribe, semantic_edit
from implicit.sensitivity import adjoint, basis, normal_displacement
from implicit.smoothing import smooth
from implicit.surface import SurfaceSample, surface_quadrature

__all__ = [
    "Along",
    "Area",
    "Ball",
    "Box",
    "CodePrior",
    "Edit",
    "EditStatus",
    "Field",
    "FitStatus",
    "Functional",
    "HalfSpace",
    "Handle",
    "Integral",
    "NearPoints",
    "Region",
    "RigidMotion",
    "Siren",
    "SurfaceError",
    "SurfaceIntegral",
    "SurfaceModes",
    "SurfaceSample",
    "Training",
    "Units",
    "Volume",
    "VolumeIntegral",
    "adjoint",
    "basis",
    "decoder_field",
    "extract_mesh",
    "fit_field",
    "geometric_edit",
    "integrate",
    "load_checkpoint",
    "load_field",
    "mirror_symmetry",
    "normal_displacement",
    "prescribe",
    "project_to_surface",
    "rigid_edit",
    "sample_surface",
    "save_field",
    "semantic_edit",
    "smooth",
    "surface_modes",
    "surface_quadrature",
]
