"""Fields that are quick to edit, and sessions of them."""

from collections.abc import Callable
from pathlib import Path

import pytest

import implicit
import implicit.shapes
from compare.editor import EditSession, Opening, Settings
from compare.editor.source import Source

QUICK = Settings(points=150)
CELLS = 20


def source_of(field: implicit.Field, shape: str = "field") -> Source:
    return Source(shape, Opening(), field, "field")


@pytest.fixture
def sphere() -> EditSession:
    """A sphere whose centre and radius are its parameters: what it can do is known."""
    return EditSession(source_of(implicit.shapes.sphere(0.5)), settings=QUICK, drawn=CELLS)


@pytest.fixture
def bulb(shape_file: Path, tmp_path: Path) -> EditSession:
    """A capsule with a ball on its side, out of a file, kept in a folder."""
    return EditSession.open(str(shape_file), tmp_path / "session", settings=QUICK, drawn=CELLS)


@pytest.fixture
def in_user_units(tmp_path: Path) -> Callable[[], EditSession]:
    """A sphere in a file whose user counts in other units: 20 x + (100, 0, -50)."""

    def made() -> EditSession:
        field = implicit.shapes.sphere(0.5)
        field.units = implicit.Units(20.0, (100.0, 0.0, -50.0))
        path = tmp_path / "units.safetensors"
        implicit.save_field(field, path)
        return EditSession.open(str(path), settings=QUICK, drawn=CELLS)

    return made
