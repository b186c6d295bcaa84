"""Networks, the registry that saves them by name, files of fields, and published checkpoints."""

from __future__ import annotations

from implicit.models.deepsdf import DeepSdf
from implicit.models.dense_grid import DenseGrid
from implicit.models.dualsdf import DualSdf
from implicit.models.hash_grid import HashGrid
from implicit.models.imnet import ImNet, ImNetEncoder
from implicit.models.mlp import Mlp
from implicit.models.registry import build, register
from implicit.models.sdf_network import SdfNetwork
from implicit.models.siren import Siren
from implicit.models.tri_plane import TriPlane

__all__ = [
    "DeepSdf",
    "DenseGrid",
    "DualSdf",
    "HashGrid",
    "ImNet",
    "ImNetEncoder",
    "Mlp",
    "SdfNetwork",
    "Siren",
    "TriPlane",
    "build",
    "register",
]
