"""Provenance of a record: what its numbers may depend on, so that they can be had again, or a difference explained."""

from __future__ import annotations

import os
import platform
import socket
import subprocess
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from compare.cases.case import Case, content_of

PACKAGES = ("implicit-vs-mesh", "torch", "numpy", "scipy", "libigl", "pymeshlab", "trimesh", "scikit-image")


def provenance(case: Case) -> dict[str, Any]:
    """Versions, machine, settings and input of what this process makes of a case.

    Returns:
        Plain data. "input" is the hash of the shape's file (the name of a bundled shape), with the commit of the git
        checkout that the file lies in, if any, and whether the file differs from that commit.
    """
    return {**surroundings(), "seed": case.seed, "input": input_of(case.shape)}


def surroundings() -> dict[str, Any]:
    """Return when and where this process runs, and with which versions."""
    import torch

    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "host": socket.gethostname(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": "cpu",
        "dtype": "float64",
    }


def input_of(shape: str) -> dict[str, Any]:
    """Return what a shape's name stood for: its content, and the git checkout that the file lies in."""
    try:
        content = content_of(shape)
    except OSError:  # the file has gone since; the record says what became of it
        return {"content": None, "git": None}
    path = Path(shape)
    return {"content": content, "git": _git_state(path) if path.is_file() else None}


def _git_state(path: Path) -> dict[str, Any] | None:
    """Return the commit that a file's checkout stands at, and whether the file is as committed; None outside of git."""
    commit = _git(path, "rev-parse", "HEAD")
    status = _git(path, "status", "--porcelain", "--ignored", "--", path.name)
    if commit is None or status is None:
        return None
    return {"commit": commit, "as_committed": status == ""}


def _git(path: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(path.absolute().parent), *arguments], capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):  # no git here, or a checkout on a sleeping disk
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # run from the sources, without installation
        return None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:  # not Linux
        pass
    return platform.processor()
