"""Mesh counterparts of the neural edits: deformation, smoothing, measures and metrics, arrays in and arrays out.

V (n, 3) float64 are vertices, F (m, 3) int64 faces, counterclockwise seen from outside; kappa = div n is the sum of the
principal curvatures; distances are negative inside; Laplacians are positive semidefinite.
"""

# ruff: isort: skip_file
# Deform and smooth
from meshref.killing import (
    KillingResult,
    KillingSolver,
    KillingStatus,
    killing,
    killing_energy,
    killing_energy_density,
)
from meshref.arap import ArapResult, ArapSolver, ArapStatus, ArapStep, arap, arap_energy
from meshref.biharmonic import BiharmonicResult, BiharmonicStatus, biharmonic
from meshref.flow import (
    ConvergedFlow,
    FlowResult,
    FlowStatus,
    FlowStep,
    converged_curvature_flow,
    explicit_step_limit,
    mean_curvature_flow,
)

# Measure
from meshref.measures import (
    area,
    centroid,
    component_count,
    components,
    euler_number,
    face_normals,
    genus,
    second_moment,
    sphericity,
    vertex_areas,
    vertex_normals,
    volume,
)
from meshref.curvature import cotangent_laplacian, mass_matrix, mean_curvature
from meshref.distance import SignedDistance, SignedDistanceQuery, signed_distance
from meshref.metrics import (
    MeshSample,
    SurfaceDistance,
    chamfer,
    handle_error,
    hausdorff,
    iou,
    normal_consistency,
    sample_mesh,
    surface_distance,
)

# Take in and hand out
from meshref.check import MeshError, check_mesh
from meshref.mend import MendReport, mend_mesh
from meshref.accepted import as_mesh
from meshref.files import read_mesh, write_mesh
from meshref.factor import NotPositiveDefiniteError

# Shapes with known answers, and MeshLab as a second opinion
from meshref.primitives import box, cylinder, icosphere, torus
from meshref.meshlab import (
    MeshlabDistance,
    decimate,
    hausdorff_distance,
    isotropic_remesh,
    laplacian_smooth,
    taubin_smooth,
)

__all__ = [
    "killing", "KillingResult", "KillingSolver", "KillingStatus", "killing_energy", "killing_energy_density",
    "arap", "ArapResult", "ArapSolver", "ArapStatus", "ArapStep", "arap_energy",
    "biharmonic", "BiharmonicResult", "BiharmonicStatus",
    "mean_curvature_flow", "FlowResult", "FlowStatus", "FlowStep", "explicit_step_limit",
    "converged_curvature_flow", "ConvergedFlow",
    "volume", "area", "centroid", "second_moment", "sphericity", "euler_number", "genus", "components",
    "component_count", "face_normals", "vertex_normals", "vertex_areas",
    "mean_curvature", "cotangent_laplacian", "mass_matrix",
    "signed_distance", "SignedDistance", "SignedDistanceQuery",
    "surface_distance", "SurfaceDistance", "chamfer", "hausdorff", "normal_consistency", "iou", "handle_error",
    "sample_mesh", "MeshSample",
    "check_mesh", "MeshError", "NotPositiveDefiniteError", "mend_mesh", "MendReport",
    "read_mesh", "write_mesh", "as_mesh",
    "icosphere", "torus", "box", "cylinder",
    "laplacian_smooth", "taubin_smooth", "isotropic_remesh", "decimate", "hausdorff_distance", "MeshlabDistance",
]  # fmt: skip
