"""Links from pages to files outside docs: links on GitHub, paths in code on the site."""

import re
from pathlib import Path

from sphinx.application import Sphinx

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?:\.\./)+([^)#]+)(?:#[^)]*)?\)")


def read(app: Sphinx, docname: str, content: list[str]) -> None:
    """Replace links that lead out of docs to a file that is there; others are left to the warning that is due."""
    root = Path(app.srcdir).parent

    def path(match: re.Match[str]) -> str:
        text, target = match[1].strip("`"), match[2]
        if not (root / target).exists() or (root / "docs" / target).exists():
            return match[0]
        return f"`{target}`" if text in (target, Path(target).name) else f"{match[1]} (`{target}`)"

    if docname.count("/") == 0:
        content[0] = LINK.sub(path, content[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register."""
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
