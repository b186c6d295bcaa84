"""Families of parametric shapes, models trained on them that come with the package, and the training itself.

Chairs have parameters for the seat, the four legs and the back; airplanes for the fuselage, the wings, the tailplane
and the fin; lamps for the foot, the pole and the shade.
"""

from __future__ import annotations

from importlib import resources

from implicit.families.airplanes import AIRPLANES
from implicit.families.chairs import CHAIRS
from implicit.families.family import Family
from implicit.families.lamps import LAMPS
from implicit.families.model import FAMILIES, FamilyModel, load_model, save_model
from implicit.families.samples import Samples, draw_samples
from implicit.families.train import reconstruct, reconstruction_scores, train_family

__all__ = [
    "AIRPLANES",
    "BUNDLED",
    "CHAIRS",
    "FAMILIES",
    "LAMPS",
    "Family",
    "FamilyModel",
    "Samples",
    "bundled",
    "draw_samples",
    "load_model",
    "reconstruct",
    "reconstruction_scores",
    "save_model",
    "train_family",
]

BUNDLED = (
    "deepsdf-chairs",
    "deepsdf-airplanes",
    "deepsdf-lamps",
    "dualsdf-chairs",
    "dualsdf-airplanes",
    "imnet-chairs",
)


def bundled(name: str) -> FamilyModel:
    """Return a model of the package, one of BUNDLED; its report says how it was made and how well it does."""
    if name not in BUNDLED:
        raise ValueError(f"There is no bundled model {name!r}; there are {', '.join(BUNDLED)}. Choose one of them.")
    with resources.as_file(resources.files("implicit") / "data" / f"{name}.safetensors") as path:
        return load_model(path)
