"""The pages of the reference, and links to them wherever a public name stands in code.

    .. names:: implicit

       geometric_edit
       expressibility

gives a table of these names with the first sentences of their docstrings, and below it their docstrings whole.
"""

import inspect
import re
from importlib import import_module
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.nodes import make_refnode

PACKAGES = ("implicit", "meshref", "compare")
NAME = re.compile(r"^((?:implicit|meshref|compare)\.)?([A-Za-z_][\w.]*)\s*(\(.*\))?$", re.DOTALL)


class Names(Directive):
    """A table of public names, and what each of them does."""

    required_arguments = 1
    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        """Write the directives of autosummary and autodoc, and have them read."""
        module = self.arguments[0]
        names = [line.strip() for line in self.content if line.strip()]
        lines = [f".. currentmodule:: {module}", "", ".. autosummary::", "   :nosignatures:", ""]
        things = [getattr(import_module(module), name) for name in names]
        documented = [
            n for n, thing in zip(names, things, strict=True) if inspect.isclass(thing) or inspect.isroutine(thing)
        ]
        lines += [f"   {name}" for name in documented] + [""]
        for name in names:
            lines += ["", *self._directive(module, name)]
        source = self.state.document.current_source or ""
        node = nodes.section()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, source), self.content_offset, node)
        return node.children

    @staticmethod
    def _directive(module: str, name: str) -> list[str]:
        thing = getattr(import_module(module), name)
        if inspect.isclass(thing):
            members = [] if issubclass(thing, BaseException) else ["   :members:", "   :inherited-members: Enum, tuple"]
            if hasattr(thing, "__members__"):  # the sentences of a status are its values
                members = ["   :members:", "   :undoc-members:"]
            return [f".. autoclass:: {name}", *members]
        if inspect.isroutine(thing):
            return [f".. autofunction:: {name}"]
        if isinstance(thing, tuple | dict):  # names to choose from; what is printed of others says what they are
            return [f".. py:data:: {name}", "", "   " + ", ".join(f"``{entry}``" for entry in thing)]
        return [f".. py:data:: {name}", "", f"   ``{repr(thing).splitlines()[0]}``"]


class LinkedNames(SphinxPostTransform):
    """Links from code in prose to the reference: `smooth`, `implicit.smooth(field, steps=2)`, `Edit.error_field`."""

    default_priority = 9

    def run(self, **kwargs: Any) -> None:
        """Link each literal that begins with a public name of one meaning."""
        for node in list(self.document.findall(nodes.literal)):
            parents = (nodes.reference, nodes.title, addnodes.desc_signature, addnodes.pending_xref)
            ancestor = node.parent
            while ancestor is not None and not isinstance(ancestor, parents):
                ancestor = ancestor.parent
            if ancestor is None:
                self._link(node)

    def _link(self, node: nodes.literal) -> None:
        match = NAME.match(node.astext())
        if match is None or (match[1] is None and match[2].islower() and "_" not in match[2] and match[3] is None):
            return  # `area` may be a word, a column, an argument; `area(V, F)` and `meshref.area` are the function
        found = self._meanings(match[1], match[2])
        if len(found) != 1:
            return
        name, entry = found.popitem()
        if entry.docname == self.env.docname and node.astext() == name:
            return
        reference = make_refnode(
            self.app.builder, self.env.docname, entry.docname, entry.node_id, node.deepcopy(), name
        )
        node.replace_self(reference)

    def _meanings(self, package: str | None, name: str) -> dict[str, Any]:
        objects = self.env.domains["py"].objects  # type: ignore[attr-defined]
        packages = [package] if package else [f"{package}." for package in PACKAGES]
        return {full: objects[full] for p in packages if (full := p + name) in objects}


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive and the links."""
    app.add_directive("names", Names)
    app.add_post_transform(LinkedNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
