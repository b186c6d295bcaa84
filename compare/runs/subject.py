"""The shape of a case, made ready: a field in float64 and one common mesh on its surface.

Both editors are judged on this mesh: the neural edit carries its vertices along, the mesh methods move them. It is
the field's own surface, remeshed to even triangles and projected back to f = 0, so neither side starts with an error.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from compare.cases.case import BUNDLED, FIELD_SUFFIX, MESH_SUFFIXES, Case, NameOfFile
from compare.cases.subject import Subject
from compare.errors import InputError, Progress, begin, naming
from compare.files import plain, replace_file
from compare.fitting.mending import Mending, read_mended
from compare.runs.rows import SubjectRow

if TYPE_CHECKING:
    from implicit import Field


# A void of a fit is spurious below this share of the volume round it, and too small for the common mesh below so many
# of its triangles.
SPURIOUS = 1e-3
LEAST_TRIANGLES_OF_A_CAVITY = 40

# Cells along the bounds show a surface whole if twice as many change its volume by no more than this over their square,
# a part of it: 5 % of 32, 0.5 % of 96. That of flat triangles falls so, and is 1 to 2 % of 32 for the bundled shapes.
# More cells than the last show nothing that our networks could hold.
LOST_TO_CELLS = 50.0
MOST_CELLS = 384

SUBJECTS = "subjects"  # the folder of a run's subjects and mended meshes

# What the refusals of meshref advise, as the options of this package.
AS_OPTIONS = {
    "Raise hole_limit to close it, or pass closed=False to leave it open.": (
        "Raise --hole-limit to close it (in a case, hole_limit of its fit)."
    ),
    "Pass bodies='largest' or bodies='keep'.": (
        "Take the largest with --bodies largest (in a case, bodies of its fit), or save one in a file of its own."
    ),
    "or pass bodies='largest' if there are others.": (
        "or take the largest part with --bodies largest if there are others."
    ),
    ", or pass closed=False and a lower hole_limit to leave it open": "",
}


def check_shape(
    shape: str,
    module: str | None = None,
    mending: Mending | None = None,
    *,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Refuse a shape that cannot be used, before any work; return what will be mended, in sentences.

    Args:
        shape: As for Case.
        module: As for Case; its code is run.
        mending: How a mesh is made solid; by default one body, holes up to a diagonal of its box.
        folder: A run folder; its mended mesh is taken from there if it is there already.
        progress: Called as progress(step, steps, what) while a mesh is mended.

    Raises:
        InputError: There is no such shape or file, or the mesh is beyond mending.
    """
    suffix = require_file(shape)
    if suffix is None:
        return []
    if suffix == FIELD_SUFFIX:
        import implicit

        try:
            loaded = implicit.load_field(shape, module=module)
        except (ValueError, TypeError, OSError) as error:
            raise InputError(f"{shape}: {error}") from error
        if loaded.dimension != 3:
            raise InputError(f"{shape} holds a field in {loaded.dimension} dimensions, but a comparison needs 3.")
        return []
    there = None if folder is None or not folder.is_dir() else folder
    return load_mesh(shape, mending, folder=there, progress=progress)[2]


def modules_of(shapes: Sequence[str], module: str | None) -> dict[str, str | None]:
    """Return for each shape what builds its network: the module where its file needs one, else None.

    Nothing is run.

    Args:
        shapes: As for Case.
        module: What the user names for all of them.

    Raises:
        InputError: A shape is no shape, or a module is named that none of them needs.
    """
    from implicit.models.field_file import builder_of

    needed: dict[str, str | None] = dict.fromkeys(shapes)
    if module is None:
        return needed
    for shape in shapes:
        if require_file(shape) == FIELD_SUFFIX:
            try:
                needed[shape] = module if builder_of(shape) is not None else None
            except (ValueError, OSError) as error:
                raise InputError(f"{shape}: {error}") from error
    if not any(needed.values()):
        raise InputError(
            f"The module {module} is named, but none of {', '.join(shapes)} is a field whose file needs one. Leave it "
            "out."
        )
    return needed


def saving_options(case: Case) -> dict[str, Any]:
    """Return the options of save_field that keep what builds the network of a case's shape."""
    from implicit.models.field_file import builder_of

    if case.module is None:
        return {}
    built = builder_of(case.shape)
    return {"builder": str(case.module), "arguments": {} if built is None else built[1]}


def require_file(shape: str) -> str | None:
    """Return the ending of the file that holds a shape, None for a bundled one; refuse what is neither."""
    path = Path(shape)
    if shape in BUNDLED:
        return None
    suffix = path.suffix.lower()
    if suffix not in (*MESH_SUFFIXES, FIELD_SUFFIX):
        close = difflib.get_close_matches(shape, BUNDLED, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise InputError(
            f"A shape is one of {', '.join(BUNDLED)}, or a file ending in {', '.join(MESH_SUFFIXES)} or "
            f"{FIELD_SUFFIX}, but got {shape!r}.{hint}"
        )
    if not path.is_file():
        raise InputError(f"There is no file {shape}. Check the path; bundled shapes are {', '.join(BUNDLED)}.")
    if path.stat().st_size == 0:
        raise InputError(f"The file {shape} is empty. Write it again.")
    return suffix


def load_mesh(
    path: str, mending: Mending | None = None, *, folder: Path | None = None, progress: Progress | None = None
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"], list[str]]:
    """Return the closed, outward mesh in a file, and what was mended, in sentences.

    Args:
        path: The file.
        mending: How it is made solid; by default one body, holes up to a diagonal of its box.
        folder: A run folder; the mended mesh is kept there under its `subjects/`, for other processes.
        progress: Called as progress(step, steps, what) when each part of the mending begins.

    Raises:
        InputError: It cannot be read or mended, or holds several bodies that are refused.
    """
    import meshref

    try:
        kept = None if folder is None else folder / SUBJECTS
        V, F, report = read_mended(path, mending or Mending(), folder=kept, progress=naming(progress, Path(path).stem))
    except meshref.MeshError as error:
        sentence = str(error)
        for library, here in AS_OPTIONS.items():
            sentence = sentence.replace(library, here)
        raise InputError(sentence if path in sentence else f"{path}: {sentence}") from error
    return V, F, [f"{path}: {step.rstrip('.')}." for step in report.steps]


def mending_of(fit: Mapping[str, Any]) -> Mending:
    """Return how the mesh of a case is made solid: two of the options of its fit."""
    return Mending(**{name: fit[name] for name in ("bodies", "hole_limit") if name in fit})


def mending_of_settings(settings: Mapping[str, Any]) -> Mending:
    """Return the same from settings by their dotted names, as a study has them."""
    return mending_of({name.removeprefix("fit."): value for name, value in settings.items() if name.startswith("fit.")})


def keep_mended(cases: Iterable[Case], folder: Path) -> None:
    """Mend the meshes of cases that have no subject yet, and keep them in a run folder, for processes that need them.

    A mesh that cannot be mended is left to its cases, whose records say why.
    """
    seen = set()
    for case in cases:
        options = case.parameters.get("fit", {})
        if Path(case.shape).suffix.lower() not in MESH_SUFFIXES or (case.shape, repr(options)) in seen:
            continue
        seen.add((case.shape, repr(options)))
        with suppress(InputError, OSError):
            if not _files_of(case, folder).complete:
                load_mesh(case.shape, mending_of(options), folder=folder)


def prepare_subject(case: Case, *, folder: Path | None = None, progress: Progress | None = None) -> Subject:
    """Return the subject of a case; with a folder, kept there and read back when another case has the same.

    Args:
        case: Of it, the shape, the settings of the fit, the number of vertices, the resolution and the seed count.
        folder: A run folder; the subject is kept under its `subjects/`.
        progress: Called as progress(step, steps, what) after each step of a fit.

    Raises:
        InputError: The shape cannot be used.
    """
    import torch

    import implicit
    from implicit.shapes import bundled

    if not isinstance(case, Case):
        raise TypeError(f"case must be a Case(shape, operation, ...), but is {case!r}.")
    require_file(case.shape)
    if isinstance(case.module, NameOfFile):
        raise InputError(
            f"The case was read from a file, which says that {case.module} builds the network of {case.shape}. No code "
            "is run because a file names it. If you trust that code, name it: dataclasses.replace(case, "
            f"module={str(case.module)!r}), or --module on the command line."
        )
    files = None if folder is None else _files_of(case, folder)
    if files is not None and files.complete:
        return files.read()
    progress = naming(progress, case.name)
    start = perf_counter()
    notes: list[str] = []
    fit: dict[str, Any] | None = None
    if case.shape in BUNDLED:
        source = bundled(case.shape)
    elif Path(case.shape).suffix.lower() == FIELD_SUFFIX:
        source = implicit.load_field(case.shape, module=case.module)
    else:
        source, fit, notes = _fit(case, folder, progress)
    edited = source.to(torch.float64)
    fitted = perf_counter()
    begin(progress, "the common mesh")
    resolution = sufficient_resolution(edited, case.resolution)
    V, F, remarks = common_mesh(edited, case.vertices, resolution)
    N = edited.normal(torch.from_numpy(V)).numpy()
    seconds = {"field": fitted - start, "common mesh": perf_counter() - fitted}
    subject = Subject(edited, V, F, N, (*notes, *remarks), fit, seconds, resolution)
    if files is None:
        return subject
    files.write(subject)
    return files.read()  # what every other case of it will read


@dataclass(frozen=True)
class _Files:
    """A subject in a run folder, in the field's coordinates; the .json is written last and says that it is whole."""

    stem: Path
    case: Case

    @property
    def complete(self) -> bool:
        return self.stem.with_suffix(".json").is_file()

    def write(self, subject: Subject) -> None:
        import implicit
        import meshref

        self.stem.parent.mkdir(parents=True, exist_ok=True)
        implicit.save_field(subject.field, self.stem.with_suffix(".safetensors"), **saving_options(self.case))
        meshref.write_mesh(self.stem.with_suffix(".ply"), subject.V, subject.F)
        row = {"notes": subject.notes, "fit": plain(subject.fit), "seconds": subject.seconds}
        row["resolution"] = subject.resolution
        replace_file(self.stem.with_suffix(".json"), json.dumps(row).encode())

    def read(self) -> Subject:
        return _read(self.stem, self.case.module, self.stem.with_suffix(".json").stat().st_mtime_ns)


@lru_cache(maxsize=1)
def _read(stem: Path, module: str | None, _: int) -> Subject:
    """Return a subject that was kept; the next case of the same gets the same, with what was measured of it."""
    import torch

    import implicit
    import meshref

    row = json.loads(stem.with_suffix(".json").read_text())
    field = implicit.load_field(stem.with_suffix(".safetensors"), module=module).to(torch.float64)
    V, F = meshref.read_mesh(stem.with_suffix(".ply"))
    N = field.normal(torch.from_numpy(V)).numpy()
    return Subject(field, V, F, N, tuple(row["notes"]), row["fit"], row["seconds"], row.get("resolution", 0))


def _files_of(case: Case, folder: Path) -> _Files:
    return _Files(folder / SUBJECTS / f"{case.name}-{case.subject_key}", case)


def sufficient_resolution(field: Field, resolution: int) -> int:
    """Return how many cells along the bounds show a field's surface whole: so many, or up to eight times as many.

    A plate thinner than a cell has holes, or is gone. It is whole where twice the cells change neither its pieces and
    handles nor, by more than LOST_TO_CELLS says, its volume.
    """
    import implicit
    from implicit.surface.topology import mesh_topology

    coarse = None
    for factor in (1, 2, 4, 8):
        try:
            fine = implicit.extract_mesh(field, factor * resolution)
        except implicit.SurfaceError:
            if factor * resolution >= MOST_CELLS or factor == 8:
                raise
            continue  # a plate between the nodes of the grid is not seen at all
        if coarse is not None:
            same = mesh_topology(*coarse).same_type(mesh_topology(*fine))
            cells = factor * resolution // 2
            if same and abs(1 - _enclosed(*coarse) / _enclosed(*fine)) <= LOST_TO_CELLS / cells**2:
                return cells
        if factor * resolution >= MOST_CELLS:
            break
        coarse = fine
    return factor * resolution


def common_mesh(
    field: Field, vertices: int, resolution: int
) -> tuple[Float[ndarray, "n 3"], Int[ndarray, "m 3"], list[str]]:
    """Return the field's surface as even triangles with about that number of vertices, all on f = 0.

    Returns:
        The largest body of the surface with its cavities, and sentences on what else there is.
    """
    import torch

    import implicit
    import meshref

    V, F, remarks = _body(*implicit.extract_mesh(field, resolution), vertices)
    V, F = meshref.isotropic_remesh(V, F, _side(V, F, vertices))
    V = implicit.project_to_surface(field, torch.from_numpy(V)).numpy()
    return *meshref.check_mesh(V, F, closed=True), remarks


def _side(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], vertices: int) -> float:
    """Return the side of equilateral triangles of which the surface takes twice as many as it shall have vertices."""
    import meshref

    return float((2 * meshref.area(V, F) / (3**0.5 * vertices)) ** 0.5)


def _body(
    V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"], vertices: int
) -> tuple[Float[ndarray, "k 3"], Int[ndarray, "l 3"], list[str]]:
    """Return the largest body of a field's surface with the cavities that are worth the name, and what was left out."""
    import meshref

    parts = meshref.component_count(V, F)
    if parts == 1:
        return V, F, []
    V, F, report = meshref.mend_mesh(V, F, bodies="largest")
    remarks = []
    others = parts - report.bodies - report.cavities
    if others:
        crumbs = "one other piece, which is" if others == 1 else f"{others} other pieces, which are"
        remarks.append(f"The surface of the field has {crumbs} not compared.")
    part = meshref.components(V, F)
    of_face = part[F[:, 0]]
    surfaces = [F[of_face == k] for k in range(part.max() + 1)]
    volumes = [_enclosed(V, faces) for faces in surfaces]
    outer = max(volumes)
    smallest = LEAST_TRIANGLES_OF_A_CAVITY * 3**0.5 / 4 * _side(V, F, vertices) ** 2
    spurious = [
        k
        for k, volume in enumerate(volumes)
        if volume < 0 and (-volume < SPURIOUS * outer or _area(V, surfaces[k]) < smallest)
    ]
    if spurious:
        share = -sum(volumes[k] for k in spurious) / outer
        voids = "a void" if len(spurious) == 1 else f"{len(spurious)} voids"
        remarks.append(
            f"The surface of the field has {voids} of {100 * share:.2g} % of its volume inside, which is too small to "
            "be compared."
        )
        keep = ~np.isin(of_face, spurious)
        used = np.unique(F[keep])
        V, F = V[used], np.searchsorted(used, F[keep])
    return V, F, remarks


def _enclosed(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"]) -> float:
    A, B, C = (V - V[F[0, 0]])[F].transpose(1, 0, 2)
    return float((A * np.cross(B, C)).sum() / 6)


def _area(V: Float[ndarray, "n 3"], F: Int[ndarray, "m 3"]) -> float:
    return float(np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1).sum() / 2)


def _fit(case: Case, folder: Path | None, progress: Progress | None) -> tuple[Field, dict[str, Any], list[str]]:
    from compare.fitting.fit import fit_mesh

    options = case.parameters.get("fit", {})
    mending = mending_of(options)
    if mending.bodies == "keep":
        raise InputError(
            "A comparison needs one body, but the case keeps several. Take bodies='largest' or 'refuse' for its fit."
        )
    V, F, notes = load_mesh(case.shape, mending, folder=folder, progress=progress)

    def tell(step: int, steps: int, _: Any) -> None:
        if progress is not None:
            progress(step, steps, "fitting a field")

    fitted, report = fit_mesh(V, F, seed=case.seed, progress=tell, **{**options, **asdict(mending)})
    return fitted, report.to_dict(), [*notes, f"The fit of a field to {case.name}: {report.verdict}"]


def describe(subject: Subject, error_means: str) -> SubjectRow:
    """Return the subject in numbers, in the user's units.

    Args:
        subject: What was edited.
        error_means: The error of a vertex in words, as the operation has it.
    """
    import meshref

    V, F, scale = subject.V, subject.F, subject.scale
    return SubjectRow(
        vertices=len(V),
        faces=len(F),
        parameters=subject.field.theta.numel(),
        scale=scale,
        offset=tuple(subject.field.units.offset),
        sides=tuple(((V.max(axis=0) - V.min(axis=0)) * scale).tolist()),
        volume=meshref.volume(V, F) * scale**3,
        area=meshref.area(V, F) * scale**2,
        genus=meshref.genus(V, F),
        bodies=meshref.component_count(V, F),
        fit=subject.fit,
        error_means=error_means,
    )
