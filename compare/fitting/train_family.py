"""Train a model of a family, write it, and score what was written: what `implicit-vs-mesh train-family` does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from compare.files import replace_file
from implicit import families
from implicit.families.train import VALIDATION_SEED, summary
from implicit.models.checkpoints import Architecture

DEFAULTS = {"shapes": 400, "latent": 16, "width": 128, "steps": 2500, "batch": 9600, "validation": 40, "seed": 0}


def train_and_save(
    family: str, architecture: Architecture, path: Path, *, dtype: torch.dtype = torch.float32, **options: Any
) -> dict[str, Any]:
    """Return the report of the training, which also stands in the file and beside it as .json.

    Args:
        dtype: Of the weights in the file; in float16 the scores are measured again.
        options: Of implicit.families.train_family.
    """
    model = families.train_family(family, architecture, **options)
    report = model.report | {"command": command_of(family, architecture, path.name, dtype, options)}
    path.parent.mkdir(parents=True, exist_ok=True)
    if dtype != torch.float32:
        families.save_model(model, path, dtype=dtype)
        count = report["validation"]["shapes"]
        scores = families.reconstruction_scores(families.load_model(path), model.family.draw(count, VALIDATION_SEED))
        report["validation"] = summary(scores)
    families.save_model(replace(model, report=report), path, dtype=dtype)
    replace_file(path.with_suffix(".json"), (json.dumps(report, indent=1) + "\n").encode())
    return report


def command_of(family: str, architecture: str, file: str, dtype: torch.dtype, options: dict[str, Any]) -> str:
    """Return the command line that makes this model."""
    words = ["implicit-vs-mesh", "train-family", architecture, family, "-o", file]
    for name, default in DEFAULTS.items():
        if options.get(name, default) != default:
            words += [f"--{name}", str(options[name])]
    return " ".join([*words, *(["--half"] if dtype == torch.float16 else [])])
