"""The documentation's site: docs/*.md as they are, the reference from docstrings, the gallery from its scripts.

`bash .ci/site` builds it. It needs `pip install ".[docs]"` and no network.
"""

import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(ROOT)]

project = "implicit-vs-mesh"
release = version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
copyright = "the authors of implicit-vs-mesh, MIT"  # the name that Sphinx wants

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "offline_math",
    "docstring_prose",
    "reference",
    "gallery_pages",
    "repository_links",
]
root_doc = "index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext", ".py": "markdown"}  # scripts: see gallery_pages.py
exclude_patterns = ["site", "gallery/README.md", "**/__pycache__"]
suppress_warnings = ["ref.python"]  # fields of several results have one name, `seconds`, and need no link
smartquotes = False  # what stands in quotes is often to be typed
nitpicky = True
# Types of other libraries, and our own that are no public names: there is nothing here to link to.
nitpick_ignore_regex = [
    ("py:class", r".*"),
    ("py:data", r"typing\..*"),
    ("py:obj", r"(typing|collections|jaxtyping)\..*"),
]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autosummary_generate = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
add_module_names = False
python_use_unqualified_type_names = True
python_display_short_literal_types = True
python_maximum_signature_line_length = 80

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "implicit-vs-mesh"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
