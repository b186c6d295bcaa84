"""Files are written to the side and moved into place, so that an interruption leaves the old one whole."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any


def replace_file(path: Path, content: bytes) -> None:
    """Write a file to the side and move it there in one step, so that nobody sees half of it, even after a power cut.

    Raises:
        OSError: It cannot be written.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder and cannot be written as a file. Name a file in it.")
    side = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(side, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(side, path)
    except OSError as error:
        raise unwritten(path, error.strerror) from error
    finally:
        with suppress(OSError):
            side.unlink()


def unwritten(path: Path, why: str | None) -> OSError:
    """Return what to raise where a file could not be written."""
    return OSError(
        f"{path} cannot be written: {why}. Name a folder that is there and may be written to, on a disk with room; "
        "what stood there before is untouched."
    )


def plain(value: Any) -> Any:
    """Return the value in the words of JSON: arrays become lists, numbers that JSON cannot say become None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, bool | str | int) or value is None:
        return value
    if hasattr(value, "tolist"):  # numpy and torch, scalars and arrays
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    raise TypeError(f"A record holds numbers, words, lists and dicts, but got a {type(value).__name__}: {value!r}.")
