"""Parts of pages in docs that a command makes anew, between marks such as <!-- rows --> and <!-- end of rows -->."""

from __future__ import annotations

import datetime
import platform
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def replace_part(page: Path, name: str, part: str) -> None:
    """Replace the part of a page between the marks of a name."""
    text = page.read_text()
    before, rest = text.split(f"<!-- {name} -->\n")
    _, after = rest.split(f"<!-- end of {name} -->")
    page.write_text(f"{before}<!-- {name} -->\n{part.strip()}\n<!-- end of {name} -->{after}")


def made_by(command: str) -> str:
    """Return how, when and where figures were made, as the start of a sentence."""
    import torch

    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    threads = torch.get_num_threads()
    machine = f"{threads} thread{'s' * (threads > 1)} of {names[0] if names else platform.processor()}"
    return f"Made by `{command}` on {datetime.date.today()}, {machine}, torch {torch.__version__.split('+')[0]}"
