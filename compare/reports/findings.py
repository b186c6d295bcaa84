"""Findings in sentences: for each case what was asked, who came how near, at which cost, and what to mind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from compare.operations.operation import operation_of
from compare.reports.views import motion_of
from compare.reports.words import asked, length
from compare.runs.columns import SIDES, column_of, duration, number, percentage, text
from compare.runs.records import Record
from compare.runs.rows import SideRow

SAME = 0.005  # ratios this near to one are called the same


@dataclass(frozen=True)
class Finding:
    """One case in sentences."""

    asked: str
    came: str  # how near each method came
    cost: str
    mind: tuple[str, ...]  # what a reader must know before the numbers are used


def finding(record: Record) -> Finding:
    """Return what a record says, in sentences.

    Args:
        record: One with a side at least.
    """
    of_operation: dict[str, Callable[[Record], str]] = {"geometric": _geometric, "smooth": _smooth, "rigid": _rigid}
    came = of_operation.get(record.case.operation, _other)(record) if _complete(record) else _one_side(record)
    return Finding(asked(record), came, _cost(record), (*_cautions(record), *_notes(record)))


def range_of(records: Sequence[Record]) -> str:
    """Return what cases of the same shape and edit have in common, a sentence: the range of their headline and time."""
    headline = operation_of(records[0].case.operation).headline
    column = column_of(headline.column)
    assert column is not None  # or the operation names a number that no table has
    rows = [record.sides["implicit"] for record in records if "implicit" in record.sides]
    values = sorted(value for row in rows if (value := number(row, column)) is not None)
    said = f"{len(records)} settings"
    if values:
        said += (
            f"; the field's {column.label or column.title} from {text(values[0], column)} to {text(values[-1], column)}"
        )
    seconds = sorted(row["seconds"] for row in rows if row.get("seconds") is not None)
    if seconds:
        said += f", the time {_between(duration(seconds[0]), duration(seconds[-1]))} s"
    return f"{said}."


def _between(low: str, high: str) -> str:
    return low if low == high else f"from {low} to {high}"


def _complete(record: Record) -> bool:
    return {"implicit", "mesh"} <= set(record.sides) and not record.failed


def _geometric(record: Record) -> str:
    field = record.sides["implicit"]
    others = [
        f"the {SIDES.get(name, name)} deformation, which finds its own falloff, by {_missed(row)}"
        for name, row in record.sides.items()
        if name not in ("implicit", "mesh")
    ]
    along = field.get("error_relative")
    along_normal = "" if along is None else f" ({_share(along)} along the normals)"
    return _sentence(
        f"The field misses the wanted surface by {_missed(field)} of the motion{along_normal}",
        "the mesh by nothing, for its vertices are put where they are wanted",
        *others,
    )


def _smooth(record: Record) -> str:
    field, mesh = record.sides["implicit"], record.sides["mesh"]
    motion, apart = motion_of(record), field.get("error_rms")
    held = [_share(abs(row["volume_drift"])) for row in (field, mesh)]
    said = [
        f"The field holds its volume to {held[0]}, the mesh to {held[1]}",
        f"their areas change by {_share(field['area_drift'])} and {_share(mesh['area_drift'])}",
    ]
    if motion and apart is not None:
        share = percentage(apart / motion)
        said.append(f"along the normals the two end {length(apart)} apart (rms), {share} of the largest motion")
    return _sentence(*said)


def _rigid(record: Record) -> str:
    field = record.sides["implicit"]
    said = f"The field leaves its handles {_missed(field)} of the motion short of their places."
    words = {"killing_energy": "Killing energy", "arap_energy": "ARAP energy"}
    compared = [
        f"its {words[energy]} is {_times(field[energy] / record.sides[row][energy])} of {name}"
        for row, name, energy in (
            ("mesh, equal error", "the mesh's least squares", "killing_energy"),
            ("mesh, ARAP, equal error", "ARAP", "arap_energy"),
        )
        if row in record.sides and record.sides[row].get(energy)
    ]
    if compared:
        return f"{said} Beside meshes that miss as much, {' and '.join(compared)}."
    if record.sides["mesh"].get("killing_energy"):
        ratio = field["killing_energy"] / record.sides["mesh"]["killing_energy"]
        return f"{said} Its Killing energy is {_times(ratio)} of the mesh's least squares, whose handles are exact."
    return said


def _other(record: Record) -> str:
    headline = operation_of(record.case.operation).headline
    column = column_of(headline.column)
    assert column is not None  # or the operation names a number that no table has
    said = (
        f"{SIDES.get(name, name)}: {headline.words.format(text(number(row, column), column))}"
        for name, row in record.sides.items()
        if number(row, column) is not None
    )
    return _sentence(*said) if record.sides else ""


def _one_side(record: Record) -> str:
    named = _joined(
        [SIDES.get(name, name) for name, row in record.sides.items() if row.get("killing_energy") is not None]
    )
    return f"Only {named} came to a result." if named else "No method came to a result."


def _cost(record: Record) -> str:
    times = [
        f"{SIDES.get(name, name)} {duration(row['seconds'])} s"
        for name, row in record.sides.items()
        if row.get("seconds") is not None
    ]
    return f"Time: {', '.join(times)}." if times else ""


def _cautions(record: Record) -> list[str]:
    """Return what follows from how the methods work."""
    if not _complete(record):
        return []
    if record.case.operation == "geometric":
        return ["That the mesh is exact is by construction, and no finding."]
    if record.case.operation == "smooth":
        said = []
        steps = record.sides["mesh"].get("details", {}).get("steps")
        own = record.sides["implicit"].get("details", {}).get("steps")
        if steps and own and steps != own:
            said.append(f"The mesh took {steps} steps, until their length did not matter; the field takes {own}.")
        if "mesh, conformalised" in record.sides:
            said.append("The conformalised flow is another equation, and its row is to be read by itself.")
        return said
    if record.case.operation == "rigid" and "mesh, equal error" in record.sides:
        return [
            "A mesh places its handles exactly, which a field cannot: energies are to be compared where both miss "
            'alike, in the rows "as far off".'
        ]
    return []


def _notes(record: Record) -> list[str]:
    """Return the record's own notes, without the names of the case before each."""
    before = f"{record.case.name}, {record.case.operation}, "
    shorter = (note.removeprefix(before).removeprefix(before.removesuffix(", ") + ": ") for note in record.notes)
    return [note[:1].upper() + note[1:] for note in shorter]


def _missed(row: SideRow) -> str:
    value = row.get("handle_error_relative")
    return "an unknown part" if value is None else _share(value)


def _share(value: float) -> str:
    column = column_of("handle_error_relative")
    assert column is not None
    return text(abs(value), column).replace("<", "less than ") if value >= 0 or abs(value) < 1e-9 else _signed(value)


def _signed(value: float) -> str:
    column = column_of("handle_error_relative")
    assert column is not None
    shown = text(abs(value), column)
    return shown.replace("<", "less than ") if shown.startswith("<") else f"\u2212{shown}"


def _times(ratio: float) -> str:
    return (
        "the same as that"
        if abs(ratio - 1) < SAME
        else f"{ratio:.2f} times that"
        if ratio < 10
        else f"{ratio:.3g} times that"
    )


def _sentence(*parts: str) -> str:
    return f"{'; '.join(part for part in parts if part)}."


def _joined(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""
