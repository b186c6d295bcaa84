"""The request for a figure of the paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field as default
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compare.cases.case import content_of
from compare.cases.default_cases import case_of_subject
from compare.errors import InputError
from compare.runs.subject import Subject, check_shape, prepare_subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tell = Callable[[int, int, str], None]

# The paper's own shapes, and two of the rigid editing that it is compared with, by the names they are known by.
MESHES = ("bunny.off", "cactus.off", "rocker-arm.obj", "bar.off", "armadillo.obj")


@dataclass(frozen=True)
class Request:
    """A folder for the pictures, and how they are to be made."""

    folder: Path
    meshes: Path | None = None  # a folder with some of MESHES
    quick: bool = False  # coarser and with fewer steps: to see that it works, not for figures
    seed: int = 0
    tell: Tell = default(default=lambda step, steps, what: None, repr=False)  # of the steps within a part

    @property
    def settings(self) -> dict[str, Any]:
        """Return what decides the numbers, as plain data; of the meshes, their content."""
        meshes = {Path(path).name: content_of(path) for path in self.shapes(*MESHES)}
        return {"quick": self.quick, "seed": self.seed, "meshes": meshes}

    def check(self) -> list[str]:
        """Refuse a mesh that cannot be used, before any work; return what will be mended, in sentences.

        Raises:
            InputError: A mesh is beyond mending, or the folder holds none of MESHES.
        """
        paths = self.shapes(*MESHES)
        if self.meshes is not None and not paths:
            raise InputError(
                f"The folder {self.meshes} holds none of {', '.join(MESHES)}. Name the one that does, or leave "
                "--meshes out."
            )
        return [sentence for path in paths for sentence in check_shape(path)]

    def shapes(self, *files: str, bundled: Sequence[str] = ()) -> list[str]:
        """Return the bundled shapes, and those of the files that are in the folder of meshes, as names of shapes."""
        found = (
            [] if self.meshes is None else [str(self.meshes / name) for name in files if (self.meshes / name).is_file()]
        )
        return [*bundled, *found]

    def subject(self, shape: str, *, vertices: int | None = None, activation: str | None = None) -> Subject:
        """Return a shape as a field and a mesh; a fit is kept in the folder and read back the next time."""
        fit: dict[str, Any] = {"steps": 600} if self.quick else {}
        if activation is not None:
            fit["activation"] = activation
        settings: dict[str, Any] = {"vertices": 1200, "resolution": 48} if self.quick else {}
        if vertices is not None:
            settings["vertices"] = vertices
        case = case_of_subject(shape, fit, seed=self.seed, **settings)
        try:
            return prepare_subject(case, folder=self.folder, progress=self.tell)
        except (ValueError, OSError) as error:
            raise InputError(f"{shape}: {error}") from error

    def save(self, figure: Figure, name: str) -> list[Path]:
        """Write a figure as PNG and PDF."""
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / f"{name}{suffix}" for suffix in (".png", ".pdf")]
        for path in paths:
            figure.savefig(path, dpi=150)
        return paths
