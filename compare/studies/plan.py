"""The cases of a study: every shape, operation and combination of the grid, with the handles that all share.

Handles are found on the shape itself, not on the common mesh of a case, so that they are the same at every setting.
"""

from __future__ import annotations

import difflib
import inspect
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

import implicit
import meshref
from compare.cases.case import BUNDLED, FIELD_SUFFIX, MESH_SUFFIXES, Case
from compare.cases.default_cases import QUICK_FIT, QUICK_SIZE, default_cases
from compare.cases.settings import OF_A_CASE, parts_of, with_settings
from compare.errors import InputError
from compare.fitting.fit import fit_mesh, place_in_cube
from compare.fitting.mending import Mending
from compare.operations.operation import operation_of
from compare.runs.subject import load_mesh, mending_of_settings
from compare.studies.study import Study, settings_at
from implicit.renamed import former_names
from implicit.shapes import bundled

POINTS = 20_000  # on a shape, among which handles are found
CELLS = 64  # along a field's bounds, for these
CELLS_TO_FIT = 128  # and for the mesh of a bundled shape, to which networks are fitted

# What compare hands to the editors itself, beside what takes more than plain data.
OURS = {"track", "progress", "seed", "constraints", "checkpoint", "units", "module", "start", "time"}

FITS: tuple[Callable[..., Any], ...] = (fit_mesh, implicit.fit_field)  # what stands behind fit.NAME


def plan(study: Study, inputs: Path, modules: Mapping[str, str | None] | None = None) -> list[Case]:
    """Return all cases of a study, in the order of shapes, operations and grid.

    Args:
        study: Whose shapes have been checked.
        inputs: The folder where a bundled shape is written as a mesh, if the study fits networks.
        modules: Of each shape that needs one, the module as for Case; its code is run.

    Raises:
        InputError: An option is not one that the editor of an operation takes.
    """
    check_options(study)
    cases = []
    mending = mending_of_settings(study.settings)
    for name in study.shapes:
        shape = _as_mesh(name, inputs) if _fits(study) and name in BUNDLED else name
        module = None if modules is None else modules.get(shape)
        V, N, bounds = outline(shape, module, mending)
        fit = QUICK_FIT if study.quick and Path(shape).suffix.lower() in MESH_SUFFIXES else {}
        settings: dict[str, Any] = {**(QUICK_SIZE if study.quick else {}), "module": module, "bounds": bounds}
        for base in default_cases(shape, V, N, operations=study.operations, quick=study.quick, fit=fit, **settings):
            if study.handles and base.handles:
                base = replace(base, handles=study.handles, coordinates=study.coordinates)
            for point in combinations(study):
                cases.append(with_settings(base, {**study.settings, **point}))
    return cases


def combinations(study: Study) -> Iterator[dict[str, Any]]:
    """Yield the settings at each point of the grid; the last axis changes fastest."""
    axes = [[settings_at(axis, value) for value in values] for axis, values in study.grid.items()]
    for point in itertools.product(*axes):
        yield {name: value for part in point for name, value in part.items()}


def outline(
    shape: str, module: str | None = None, mending: Mending | None = None
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3"], Float[ndarray, "2 3"]]:
    """Return points spread evenly over a shape, in its field's coordinates, outward normals there, and its bounds."""
    return placed_outline(shape, module, mending)[:3]


def placed_outline(
    shape: str, module: str | None = None, mending: Mending | None = None
) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3"], Float[ndarray, "2 3"], implicit.Units]:
    """Return what `outline` does, and the units of the field.

    Raises:
        InputError: The mesh cannot be read or mended, or the field has no surface within its bounds.
    """
    if Path(shape).suffix.lower() in MESH_SUFFIXES:
        V, F, _ = load_mesh(shape, mending)
        V, units = place_in_cube(V)
        bounds = np.array([[-1.0] * 3, [1.0] * 3])  # of every field that is fitted to a mesh
    else:
        field = _field(shape, module)
        try:
            V, F = implicit.extract_mesh(field, CELLS)
        except ValueError as error:
            raise InputError(f"{shape}: {error}") from error
        bounds, units = field.bounds.cpu().numpy(), field.units
    sample = meshref.sample_mesh(V, F, POINTS)
    return sample.points, sample.normals, bounds, units


def check_options(study: Study) -> None:
    """Refuse what no editor takes, and what would do nothing.

    Raises:
        InputError: A setting is not an option of the editors of the study's operations; the message lists them.
    """
    for name in [*study.settings, *study.varied]:
        idle = [operation for operation in study.operations if not _takes(name, operation)]
        if idle and (name in study.varied or len(idle) == len(study.operations)):
            part, _, option = name.removeprefix(f"{idle[0]}.").rpartition(".")
            options = sorted(options_of(part, idle[0]))
            close = difflib.get_close_matches(option, options, n=1)
            hint = f" Did you mean {name.removesuffix(option)}{close[0]}?" if close else ""
            raise InputError(
                f"The setting {name} does nothing in a {idle[0]} edit, which takes "
                f"{', '.join(f'{part}.{known}' if part else known for known in options) or 'none there'}.{hint}"
            )
    fields = [shape for shape in study.shapes if Path(shape).suffix.lower() == FIELD_SUFFIX]
    if _fits(study) and fields:
        raise InputError(f"The study sets how networks are fitted, but {fields[0]} is one already. Name its mesh.")


def _takes(name: str, operation: str) -> bool:
    parts = parts_of(name, operation)
    return parts is not None and parts[-1] in options_of(".".join(parts[:-1]), operation)


def options_of(part: str, operation: str) -> set[str]:
    """Return the options of the functions that stand behind a part of the settings, as far as they are plain data."""
    chosen = operation_of(operation)
    if part == "fit":
        functions = FITS
    elif part in ("implicit", "mesh"):
        functions = chosen.option_sources()[part]
    else:
        return {*OF_A_CASE, *chosen.settings}
    names = {
        name
        for function in functions
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name not in OURS
    }
    names |= {old for function in functions for old in former_names(function)}  # of files of before
    return names if part == "fit" else names - set(chosen.settings)  # those stand at the top


def _fits(study: Study) -> bool:
    return any(name.split(".")[0] == "fit" for name in [*study.settings, *study.varied])


def _field(shape: str, module: str | None = None) -> implicit.Field:
    return (bundled(shape) if shape in BUNDLED else implicit.load_field(shape, module=module)).to(torch.float64)


def _as_mesh(name: str, inputs: Path) -> str:
    """Write the surface of a bundled shape to a file, for networks of other sizes to be fitted to."""
    path = inputs.absolute() / f"{name}.ply"
    path.parent.mkdir(parents=True, exist_ok=True)
    V, F = implicit.extract_mesh(_field(name), CELLS_TO_FIT)
    meshref.write_mesh(path, V, F)
    return str(path)
