"""Networks, the registry that saves them by name, files of fields, and published checkpoints."""

from __future__ import annotations

from implicit.models.deepsdf import DeepSdf
from implicit.models.dualsdf import DualSdf
from implicit.models.imnet import ImNet, ImNetEncoder
from implicit.models.mlp import Mlp
from implicit.models.registry import build, register
from implicit.models.sdf_network import SdfNetwork
from implicit.models.siren import Siren

__all__ = ["DeepSdf", "DualSdf", "ImNet", "ImNetEncoder", "Mlp", "SdfNetwork", "Siren", "build", "register"]
