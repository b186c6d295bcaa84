"""Files are written to the side and renamed, so that an interrupted write loses nothing."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path


def replace_file(path: str | PathLike[str], content: bytes) -> None:
    """Put the content at the path in one move; until then an older file there stays whole."""
    target = Path(path)
    side = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with open(side, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(side, target)
    finally:
        side.unlink(missing_ok=True)
