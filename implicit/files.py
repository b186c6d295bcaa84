"""Writing of files: to the side first and then renamed, so that an interrupted write loses nothing."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def as_path(path: str | PathLike[str]) -> Path:
    """Return the path of a file, or refuse what is none."""
    try:
        return Path(path)
    except TypeError as error:
        raise TypeError(f"path must be the name of a file, but is {path!r}.") from error


def replace_file(path: str | PathLike[str], content: bytes) -> None:
    """Put the content at the path in one move; until then an older file there stays whole.

    Raises:
        OSError: The file cannot be written.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder and cannot be written as a file. Name a file in it.")
    side = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with open(side, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(side, target)
    except OSError as error:
        raise OSError(
            f"{target} cannot be written: {error.strerror}. Name a file in a folder that is there and may be written "
            "to, on a disk with room; what stood there before is untouched."
        ) from error
    finally:
        with suppress(OSError):
            side.unlink()


def write_state(path: str | PathLike[str], tensors: Mapping[str, Tensor], header: Mapping[str, str]) -> None:
    """Write the state of a training as safetensors."""
    from safetensors.torch import save

    content = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    replace_file(path, save(content, metadata=dict(header)))


def read_state(path: str | PathLike[str]) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Return the header and the tensors that write_state wrote.

    Raises:
        ValueError: The file is missing, cut short or of another kind.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(fspath(path), framework="pt") as file:
            return file.metadata() or {}, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no dict
    except (SafetensorError, OSError) as error:
        raise ValueError(
            f"{fspath(path)} is not a whole checkpoint ({error}). Remove it to train from the start."
        ) from error
