"""A study: the same edits over a grid of settings, as plain data, from a TOML file or one that comes along by name.

    shapes = ["spot"]                       # as for Case; paths are relative to the file
    operations = ["rigid"]
    [settings]                              # of every case
    vertices = 2000
    [grid]                                  # every combination of these is a case
    implicit.points = [250, 500, 1000]
    [[charts]]
    x = "implicit.points"
    y = "killing_energy"

A setting is named by its place in a case: vertices, resolution, seed; steps and step_size of smoothing; implicit.NAME
and mesh.NAME for the options of the editors, fit.NAME for those of the fit of a field. An operation's name before it
(rigid.implicit.points) keeps it from the others. A list of tables in the grid sweeps several settings together.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field as default
from importlib import resources
from pathlib import Path
from typing import Any

from compare.cases.case import COORDINATES, FIELD_SUFFIX, MESH_SUFFIXES
from compare.cases.handles import HandleSpec
from compare.cases.labels import flat
from compare.cases.registry import OPERATIONS, own_settings
from compare.cases.settings import OF_A_CASE, OF_A_PART
from compare.errors import InputError
from compare.files import plain
from compare.runs.columns import columns

KEYS = ("title", "shapes", "operations", "coordinates", "handles", "settings", "grid", "charts", "keep_meshes", "quick")


@dataclass(frozen=True)
class Chart:
    """One panel: y over x, a curve for each shape, operation and method.

    Args:
        x: A setting of the grid, or a measured number.
        y: A measured number, a name of compare.runs.columns.columns().
        against_last: Whether to show |y - y_last| / |y_last| instead, with y_last where the grid's setting is last:
            how far from converged y is.
    """

    x: str
    y: str
    against_last: bool = False


@dataclass(frozen=True, repr=False)
class Study:
    """A grid of settings to vary, over which shapes, and the curves drawn of it.

    Args:
        name: For the folder and the title of the chart.
        title: What it shows, a sentence.
        shapes: As for Case.
        operations: Of each shape.
        grid: Of each axis its values. An axis is a setting, or any other name with a table of settings for each value.
        settings: Those that every case has.
        handles: For all shapes; by default those of default_cases are found on each.
        charts: What is drawn, a panel each.
        keep_meshes: Whether the edited shapes are kept, and a report in 3D made of them.
        quick: Whether what is not set here is that of `run --quick`.
        coordinates: Of the handles: "field", or "user", those of the shapes' files.
    """

    name: str
    title: str
    shapes: tuple[str, ...]
    operations: tuple[str, ...]
    grid: Mapping[str, tuple[Any, ...]]
    settings: Mapping[str, Any] = default(default_factory=dict)
    handles: tuple[HandleSpec, ...] = ()
    charts: tuple[Chart, ...] = ()
    keep_meshes: bool = True
    quick: bool = False
    coordinates: str = "field"

    def __repr__(self) -> str:
        """Return what is varied over what, in one line."""
        axes = "; ".join(f"{axis} in {list(values)!r:.80}" for axis, values in self.grid.items())
        return (
            f"Study({self.name}: {', '.join(self.operations)} of {', '.join(self.shapes)}{f'; {axes}' if axes else ''})"
        )

    @property
    def varied(self) -> list[str]:
        """Names of the settings that the grid changes, in its order."""
        names = [name for axis, values in self.grid.items() for value in values for name in settings_at(axis, value)]
        return list(dict.fromkeys(names))

    def axis_of(self, setting: str) -> str:
        """Return the axis of the grid that changes a setting."""
        return next(axis for axis, values in self.grid.items() if setting in settings_at(axis, values[0]))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return plain(asdict(self))

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Study:
        """Return the study that `to_dict` wrote."""
        return cls(
            **{
                **row,
                "shapes": tuple(row["shapes"]),
                "operations": tuple(row["operations"]),
                "grid": {axis: tuple(values) for axis, values in row["grid"].items()},
                "handles": tuple(HandleSpec(**handle) for handle in row["handles"]),
                "charts": tuple(Chart(**chart) for chart in row["charts"]),
            }
        )


def built_in() -> dict[str, Study]:
    """Return the studies that come along, by name."""
    files = sorted((resources.files("compare.studies") / "builtin").iterdir(), key=lambda file: file.name)
    return {
        file.name.removesuffix(".toml"): parse_study(file.read_text(encoding="utf-8"), file.name, Path())
        for file in files
        if file.name.endswith(".toml")
    }


def find_study(name: str, *, quick: bool = False, shapes: Collection[str] = ()) -> Study:
    """Return a built-in study by name, or one in a TOML file.

    Args:
        name: Of it, or a path.
        quick: Whether to take what its table `quick` says.
        shapes: In place of its own, relative to the current folder.

    Raises:
        InputError: There is no such study, or it makes no sense; the message says where.
    """
    path = Path(name)
    if path.suffix == ".toml":
        if not path.is_file():
            raise InputError(f"There is no file {name}. Check the path; built-in studies are {', '.join(built_in())}.")
        try:
            text, base = path.read_text(encoding="utf-8"), path.absolute().parent
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{name} cannot be read as text: {error}.") from error
    else:
        file = resources.files("compare.studies") / "builtin" / f"{name}.toml"
        if not file.is_file():
            hint = _did_you_mean(name, built_in())
            raise InputError(
                f"A study is one of {', '.join(built_in())}, or a file ending in .toml, but got {name!r}.{hint}"
            )
        text, base = file.read_text(encoding="utf-8"), Path()
    return parse_study(text, name, base, quick=quick, shapes=shapes)


def parse_study(text: str, name: str, base: Path, *, quick: bool = False, shapes: Collection[str] = ()) -> Study:
    """Return the study that a TOML text states.

    Args:
        text: See the top of this file, or docs/studies.md.
        name: The file's, for messages.
        base: What relative paths of shapes are relative to.
        quick, shapes: As for find_study.

    Raises:
        InputError: A key is unknown, or a value is not what it should be.
    """
    try:
        given = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name} is no TOML: {error}.") from error
    _require_known(given, KEYS, name)
    changes = _table(given.pop("quick", {}), "quick", name)
    _require_known(changes, [key for key in KEYS if key not in ("title", "quick")], f"[quick] of {name}")
    if quick:
        given = _merged(given, changes)
    own = [_located(shape, base) for shape in _strings(given, "shapes", name)]
    operations = _strings(given, "operations", name)
    for operation in operations:
        if operation not in OPERATIONS:
            hint = _did_you_mean(operation, OPERATIONS)
            raise InputError(f"An operation in {name} is one of {', '.join(OPERATIONS)}, but is {operation!r}.{hint}")
    grid = flat(_table(given.get("grid", {}), "grid", name))
    for axis, values in grid.items():
        if not isinstance(values, list) or not values:
            raise InputError(f"{axis} in [grid] of {name} must be a list of values, but is {values!r}.")
        if any(isinstance(value, dict) for value in values):
            tables = [flat(value) for value in values if isinstance(value, dict)]
            if len(tables) < len(values) or any(set(table) != set(tables[0]) for table in tables):
                raise InputError(f"The tables of {axis} in [grid] of {name} must all set the same settings.")
            grid[axis] = tables
        if any(value in values[:k] for k, value in enumerate(values)):
            raise InputError(f"{axis} in [grid] of {name} names a value twice: {values}.")
    study = Study(
        name=Path(name).stem,
        title=str(given.get("title", "")),
        shapes=tuple(_located(shape, Path()) for shape in shapes) or tuple(own),
        operations=tuple(operation for operation in OPERATIONS if operation in operations),
        grid={axis: tuple(values) for axis, values in grid.items()},
        settings=flat(_table(given.get("settings", {}), "settings", name)),
        handles=tuple(_handle(row, name) for row in _rows(given, "handles", name)),
        charts=tuple(_chart(row, name) for row in _rows(given, "charts", name)),
        keep_meshes=bool(given.get("keep_meshes", True)),
        quick=quick,
        coordinates=str(given.get("coordinates", "field")),
    )
    _check(study, name)
    return study


def _check(study: Study, name: str) -> None:
    """Refuse what can be told without a shape or an editor; options of editors are checked by compare.studies.plan."""
    if twice := [shape for shape in study.shapes if study.shapes.count(shape) > 1]:
        raise InputError(f"{twice[0]} is named twice in {name}. Name each shape once.")
    if study.handles and not any(OPERATIONS[operation].takes_handles for operation in study.operations):
        raise InputError(f"{name} gives handles, but {' and '.join(study.operations)} takes none.")
    if study.coordinates not in COORDINATES:
        raise InputError(f'coordinates in {name} must be "field" or "user", but is {study.coordinates!r}.')
    for setting in [*study.settings, *study.varied]:
        _require_setting(setting, study.operations, name)
    for setting, value in _values(study):
        if not isinstance(value, str | int | float | list) or (isinstance(value, float) and not math.isfinite(value)):
            raise InputError(f"{setting} in {name} must be a word, a finite number or a list, but is {value}.")
    places = [*study.settings, *(s for axis, values in study.grid.items() for s in settings_at(axis, values[0]))]
    if twice := [setting for setting in places if places.count(setting) > 1]:
        raise InputError(f"{twice[0]} is set in two places of {name}. Keep one.")
    _check_charts(study, name)


def _check_charts(study: Study, name: str) -> None:
    measured = [column.name for column in columns()]
    for chart in study.charts:
        if chart.against_last and not study.grid:
            raise InputError(f"A chart in {name} is against the last of the grid, but there is no [grid].")
        for axis, allowed in (("x", [*study.varied, *measured]), ("y", measured)):
            value = getattr(chart, axis)
            if value not in allowed:
                hint = _did_you_mean(value, allowed)
                raise InputError(f"{axis} of a chart in {name} is one of {', '.join(allowed)}, but is {value!r}.{hint}")


def _values(study: Study) -> Iterator[tuple[str, Any]]:
    """Yield every setting with every value that it takes."""
    yield from study.settings.items()
    for axis, values in study.grid.items():
        for value in values:
            yield from settings_at(axis, value).items()


def _require_setting(setting: str, operations: Iterable[str], name: str) -> None:
    parts = setting.split(".")
    if parts[0] in OPERATIONS:
        if parts[0] not in operations:
            raise InputError(f"The setting {setting} in {name} is for an operation that it does not name.")
        parts = parts[1:]
    at_the_top = (*OF_A_CASE, *own_settings())
    known = (*at_the_top, *OF_A_PART)
    if not parts or parts[0] not in known or (len(parts) == 2) != (parts[0] in OF_A_PART):
        hint = _did_you_mean(parts[0] if parts else "", known)
        raise InputError(
            f"There is no setting {setting} as in {name}; there are {', '.join(at_the_top)}, "
            f"{', '.join(part + '.NAME' for part in OF_A_PART)}.{hint}"
        )


def settings_at(axis: str, value: Any) -> Mapping[str, Any]:
    """Return what one value of an axis sets."""
    return value if isinstance(value, Mapping) else {axis: value}


def _merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(table)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


def _located(shape: str, base: Path) -> str:
    """Return the shape, as an absolute path if it is a file."""
    is_file = Path(shape).suffix.lower() in (*MESH_SUFFIXES, FIELD_SUFFIX)
    return str((base / shape).absolute()) if is_file else shape


# What may stand in the file


def _strings(given: Mapping[str, Any], key: str, name: str) -> list[str]:
    value = given.get(key)
    if not isinstance(value, list) or not value or not all(isinstance(word, str) for word in value):
        raise InputError(f"{name} must have {key}, a list of names, but has {value!r}.")
    return value


def _table(value: Any, key: str, name: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{key} in {name} must be a table, [{key}], but is {value!r}.")
    return value


def _rows(given: Mapping[str, Any], key: str, name: str) -> list[dict[str, Any]]:
    rows = given.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{key} in {name} must be tables, [[{key}]], but is {rows!r}.")
    return rows


def _handle(row: Mapping[str, Any], name: str) -> HandleSpec:
    _require_known(row, ("region", "motion"), f"a handle in {name}", needed=True)
    try:
        return HandleSpec(**row)
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"A handle in {name} makes no sense: {error}") from error


def _chart(row: Mapping[str, Any], name: str) -> Chart:
    _require_known(row, ("x", "y", "against_last"), f"a chart in {name}")
    if not {"x", "y"} <= set(row):
        raise InputError(f"A chart in {name} needs x and y, but has {', '.join(row) or 'nothing'}.")
    return Chart(**row)


def _require_known(given: Mapping[str, Any], known: Collection[str], where: str, *, needed: bool = False) -> None:
    for key in given:
        if key not in known:
            raise InputError(
                f"There is no key {key} in {where}; it takes {', '.join(known)}.{_did_you_mean(key, known)}"
            )
    if needed and (missing := [key for key in known if key not in given]):
        raise InputError(f"{missing[0]} is missing in {where}. It takes {', '.join(known)}.")


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" Did you mean {close[0]}?" if close else ""
