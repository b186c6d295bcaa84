"""Links from pages to files of the repository that are no pages: sources, data, the README."""

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)


def resolve(app: Sphinx, env: Any, node: Any, contnode: nodes.Element) -> nodes.Element | None:
    """Take a link to a file of the repository for its path in code, and leave others to the warning that is due."""
    if node.get("reftype") != "myst":
        return None
    target = str(node["reftarget"]).partition("#")[0]
    file = (Path(app.srcdir) / node["refdoc"]).parent / target
    root = Path(app.srcdir).parent
    if target and file.is_file() and file.resolve().is_relative_to(root.resolve()):
        return nodes.literal("", str(file.resolve().relative_to(root.resolve())))
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Register."""
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
