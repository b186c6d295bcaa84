"""Scripts of the gallery as pages: comments become prose, the rest stays code, with the picture and what is printed.

A script begins with a docstring, its title and a few sentences. Lines "# %%" part it into cells, and the comment that
begins a cell is prose. NAME.webp and NAME.txt beside it are what draw_gallery.py has kept of a run.
"""

import ast
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

FOLDER = "gallery/"


def title_of(source: str) -> str:
    """Return the first line of a script's docstring."""
    return str(ast.get_docstring(ast.parse(source))).splitlines()[0]


def cells_of(source: str) -> list[tuple[str, str]]:
    """Return the cells of a script: prose and code each."""
    tree = ast.parse(source)
    head = str(ast.get_docstring(tree)).partition("\n")[2].strip()
    body = "\n".join(source.splitlines()[tree.body[0].end_lineno :])
    first, *others = body.split("\n# %%\n")
    cells = [(head, first.strip("\n"))]
    for cell in others:
        lines = cell.split("\n")
        code = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
        prose = " ".join(line.removeprefix("#").strip() for line in lines[:code])
        cells.append((prose, "\n".join(lines[code:]).strip("\n")))
    return cells


def page_of(name: str, source: str, printed: str | None, picture: bool) -> str:
    """Return the page of a script in Markdown."""
    parts = [f"# {title_of(source)}"]
    for k, (prose, code) in enumerate(cells_of(source)):
        parts.append(prose)
        if k == 0 and picture:
            parts.append(f"![{title_of(source)}]({name}.webp)")
        if code:
            parts.append(f"```python\n{code}\n```")
    if printed:
        parts.append(f"It prints:\n\n```text\n{printed.rstrip()}\n```")
    parts.append(f"Take it along: {{download}}`{name}.py`.")
    return "\n\n".join(parts) + "\n"


def read(app: Sphinx, docname: str, content: list[str]) -> None:
    """Turn a script that Sphinx has read into its page."""
    path = Path(app.srcdir) / f"{docname}.py"
    if docname.startswith(FOLDER) and path.is_file():
        printed = path.with_suffix(".txt")
        text = printed.read_text(encoding="utf-8") if printed.is_file() else None
        content[0] = page_of(path.stem, content[0], text, path.with_suffix(".webp").is_file())


def setup(app: Sphinx) -> dict[str, Any]:
    """Register."""
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
