"""The history of a session: what was done to the field, edit by edit, as plain data and in a folder.

    DIR/session.json            shape, edits with their handles and settings, and how many of them stand
    DIR/fields/000.safetensors  the field at the start, 001 after the first edit, and so on
    DIR/handles/001.toml        the handles of the first edit, as `implicit-vs-mesh run --handles` takes them

A field that cannot be described, because a function of the user's own makes it, is kept by its parameters alone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field as default, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from compare.cases.handles import HandleSpec
from compare.cases.handles_file import handles_text
from compare.editor.source import Opening, Source
from compare.editor.tools import Settings, Tool
from compare.errors import InputError
from compare.files import plain, replace_file

if TYPE_CHECKING:
    from implicit import Field

FORMAT = "implicit-vs-mesh-session-1"
FILE = "session.json"


@dataclass(frozen=True)
class Entry:
    """An edit that was made.

    Attributes:
        number: From 1 on.
        name: What the user calls it.
        tool: Which edit.
        handles: What went where, in the field's coordinates.
        settings: Of the edit.
        status: Sentence that says how it ended.
        notes: What else is to be said, a sentence each.
        done: Whether all of it was done.
        judged: Whether pieces and handles of the surface were counted on fine cells.
        seconds: Wall time of the edit.
        numbers: Measured before and after, in the user's units: volume, area, pieces; error of the target; and of
            generated shapes the distance of the code from those of training.
        theta: Hash of the parameters after it, by which a replay is known for the same.
    """

    number: int
    name: str
    tool: Tool
    handles: tuple[HandleSpec, ...]
    settings: Settings
    status: str
    notes: tuple[str, ...] = ()
    done: bool = True
    judged: bool = False
    seconds: float = 0.0
    numbers: Mapping[str, Any] = default(default_factory=dict)
    theta: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        row: dict[str, Any] = {name: getattr(self, name) for name in self.__dataclass_fields__}
        row["handles"] = [asdict(handle) for handle in self.handles]
        row["settings"] = self.settings.to_dict()
        result: dict[str, Any] = plain(row)
        return result

    @classmethod
    def from_dict(cls, row: Mapping[str, Any]) -> Entry:
        """Return the entry that `to_dict` wrote."""
        handles = tuple(HandleSpec(**handle) for handle in row["handles"])
        settings = Settings.from_dict(row["settings"])
        return cls(**{**row, "handles": handles, "settings": settings, "notes": tuple(row["notes"])})


def digest(field: Field) -> str:
    """Return the hash of a field's parameters, 16 hexadecimal digits."""
    return hashlib.sha256(field.theta.detach().cpu().contiguous().view(torch.uint8).numpy().tobytes()).hexdigest()[:16]


class Folder:
    """The folder of a session.

    Args:
        path: Where; it is made where there is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def holds_session(self) -> bool:
        """Return whether a session was saved there."""
        return (self.path / FILE).is_file()

    def field_path(self, number: int) -> Path:
        """Return the path of the field after so many edits."""
        return self.path / "fields" / f"{number:03d}.safetensors"

    def write_field(self, number: int, field: Field, source: Source) -> None:
        """Write the field after so many edits, with its handles beside it."""
        import implicit
        from implicit.models.field_file import builder_of

        path = self.field_path(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        options: dict[str, Any] = {}
        if source.opening.module is not None:
            built = builder_of(source.shape)
            options = {"builder": source.opening.module, "arguments": {} if built is None else built[1]}
        try:
            implicit.save_field(field, path, **options)
        except (TypeError, ValueError):  # nothing says how its module is made
            from safetensors.torch import save

            replace_file(path, save({"theta": field.theta.detach().cpu().clone()}, metadata={"session": FORMAT}))

    def write_handles(self, entry: Entry) -> None:
        """Write the handles of an edit, where it has some."""
        if entry.handles:
            path = self.path / "handles" / f"{entry.number:03d}.toml"
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, handles_text(entry.handles, "field").encode())

    def write(self, source: Source, entries: Sequence[Entry], position: int) -> None:
        """Write what was done, in one step, once the fields are there."""
        self.path.mkdir(parents=True, exist_ok=True)
        row = {
            "format": FORMAT,
            "shape": source.shape,
            "kind": source.kind,
            "opening": plain(asdict(source.opening)),
            "notes": list(source.notes),
            "position": position,
            "edits": [entry.to_dict() for entry in entries],
        }
        replace_file(self.path / FILE, json.dumps(row, indent=1).encode())

    def read(self) -> dict[str, Any]:
        """Return what `write` wrote.

        Raises:
            InputError: There is no session, or it cannot be read.
        """
        try:
            row = json.loads((self.path / FILE).read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{self.path} holds no session: {error.strerror}. Name the folder of one.") from (error)
        except ValueError as error:
            raise InputError(f"{self.path / FILE} is cut short: {error}. Take the last field instead.") from error
        if not isinstance(row, dict) or row.get("format") != FORMAT:
            raise InputError(f"{self.path / FILE} is no session of this version; its format must be {FORMAT!r}.")
        try:
            row["edits"] = [Entry.from_dict(edit) for edit in row["edits"]]
            row["opening"] = Opening(**row["opening"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.path / FILE} makes no sense: {error}") from error
        if row["position"] not in range(len(row["edits"]) + 1):
            raise InputError(f"{self.path / FILE} stands at edit {row['position']!r} of {len(row['edits'])}.")
        return row

    def read_theta_of(self, number: int, start: Field) -> torch.Tensor:
        """Return the parameters of the field after so many edits.

        Args:
            number: How many edits.
            start: Field at the start, whose layout says how parameters are laid out in one vector.

        Raises:
            InputError: They cannot be read, or fit another field.
        """
        from implicit.models.checkpoints import read_tensors

        path = self.field_path(number)
        try:
            tensors = read_tensors(path)
        except (OSError, ValueError) as error:
            raise InputError(f"The field after edit {number} cannot be read: {error}") from error
        if "theta" in tensors and not self.is_described(number):
            theta: torch.Tensor = tensors["theta"]
        else:
            missing = [block.name for block in start.layout if block.name not in tensors]
            if missing:
                raise InputError(f"{path} has no parameter {missing[0]}, which the field at the start has.")
            theta = torch.cat([tensors[block.name].flatten() for block in start.layout])
        if theta.shape != start.theta.shape:
            raise InputError(f"{path} holds {len(theta)} parameters, but the field at the start {len(start.theta)}.")
        return theta.to(start.theta)

    def is_described(self, number: int) -> bool:
        """Return whether the field's file says how its module is made."""
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(str(self.field_path(number)), framework="pt") as file:
                return "field" in (file.metadata() or {})
        except (OSError, SafetensorError) as error:
            raise InputError(f"{self.field_path(number)} cannot be read: {error}") from error


def renamed(entry: Entry, name: str) -> Entry:
    """Return the entry under another name.

    Raises:
        InputError: The name is empty.
    """
    if not isinstance(name, str) or not name.strip():
        raise InputError("A name of an edit must have a letter. Type one.")
    return replace(entry, name=name.strip())
