"""Large rigid motions of fields beside converged ARAP on the mesh: distance, energy, pieces, seconds.

`python -m benchmarks.large_rigid SCENE...` prints rows of the table of docs/rigid.md; scenes of meshes that are not
bundled need --meshes, the folder that has them, and fit a network first.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

import implicit
import meshref
from compare.cases.case import Case
from compare.cases.default_cases import default_cases
from compare.cases.handles import HandleSpec
from compare.cases.subject import Subject
from compare.paper.rigid_bends import BAR, STAGES, arap_way, turning_handles
from compare.runs.operations import target_motion
from compare.runs.subject import prepare_subject

CELLS = 128  # at which the edited surface is extracted and its pieces are counted


@dataclass(frozen=True, eq=False)
class Scene:
    """One large motion of a shape.

    Attributes:
        name: In words.
        case: Its handles.
        subject: The field and its common mesh.
        stages: Parts of ARAP's way.
    """

    name: str
    case: Case
    subject: Subject
    stages: int

    def handles(self) -> list[implicit.Handle]:
        return [spec.build() for spec in self.case.handles]

    def arap(self) -> meshref.ArapResult:
        """Return converged ARAP on the common mesh."""
        held = np.flatnonzero(target_motion(self.case, self.subject).at)
        *way, goal = arap_way(self.subject, self.case, self.stages)
        return meshref.arap(self.subject.V, self.subject.F, held, goal, way=way)

    def edit(self, **options: Any) -> tuple[implicit.Edit, float]:
        """Return the edit, with the common mesh tracked, and its processor seconds."""
        clock = time.process_time()
        found = implicit.rigid_edit(
            self.subject.field, self.handles(), track=torch.from_numpy(self.subject.V), **options
        )
        return found, time.process_time() - clock

    def row(self, edit: implicit.Edit, arap: meshref.ArapResult) -> dict[str, Any]:
        """Return how far an edit is from ARAP, over the longest side, its energy over ARAP's, and its pieces."""
        V, F = self.subject.V, self.subject.F
        box = float(np.ptp(V, axis=0).max())
        surface = implicit.extract_mesh(edit.field, CELLS)
        topology = meshref.mesh_topology(*surface) if hasattr(meshref, "mesh_topology") else None
        del topology
        target = target_motion(self.case, self.subject)
        moved = edit.tracked.double().cpu().numpy()
        missed = (moved - V - target.displacement)[target.at]
        parts = implicit.mesh_topology(*surface)
        return {
            "H": meshref.hausdorff(*surface, arap.V, F) / box,
            "rest": meshref.hausdorff(*implicit.extract_mesh(self.subject.field, CELLS), V, F) / box,
            "E": meshref.arap_energy(V, F, moved) / arap.energy,
            "pieces": parts.components,
            "Euler": parts.euler,
            "handles": float(np.sqrt((missed**2).sum(axis=1).mean())) / box,
            "volume": meshref.volume(*surface) / meshref.volume(V, F) - 1,
        }


def bend(folder: Path | None) -> Scene:
    subject = prepare_subject(Case("cactus", "smooth"))
    return Scene("cactus, 90 degrees", Case("cactus", "rigid", turning_handles(subject, "bend", 90.0)), subject, STAGES)


def pull(folder: Path | None) -> Scene:
    subject = prepare_subject(Case("spot", "smooth"))
    (case,) = default_cases("spot", subject.V, subject.N, operations=("rigid",))
    return Scene("spot, pull of 15 %", case, subject, 1)
