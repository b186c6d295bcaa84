"""The documentation holds together: every public name has its place, pages lead somewhere, scripts and snippets run."""

import ast
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import implicit
from implicit import EditStatus

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(page for page in DOCS.rglob("*.md"))
SCRIPTS = sorted((DOCS / "gallery").glob("*.py"))
MODULES = ("implicit", "implicit.shapes", "implicit.models", "implicit.families", "meshref", "compare")

spec = importlib.util.spec_from_file_location("draw_gallery", DOCS / "site" / "draw_gallery.py")
draw_gallery = importlib.util.module_from_spec(spec)
spec.loader.exec_module(draw_gallery)


def names_of(text):
    """Yield each module and name that a page of the reference shows."""
    for module, block in re.findall(r"^\.\. names:: (\S+)\n\n((?:   \S+\n)+)", text, flags=re.MULTILINE):
        for name in block.split():
            yield module, name


REFERENCE = [entry for page in sorted((DOCS / "api").glob("*.rst")) for entry in names_of(page.read_text())]


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_is_in_the_reference_once(module):
    thing = importlib.import_module(module)
    shown = [name for where, name in REFERENCE if where == module]
    # A name that a package has from a module of its own is shown with one of them.
    elsewhere = {
        id(getattr(implicit, name)) for where, name in REFERENCE if where == "implicit" and module != "implicit"
    }
    wanted = [
        name
        for name in thing.__all__
        if not inspect.ismodule(getattr(thing, name)) and id(getattr(thing, name)) not in elsewhere
    ]
    assert sorted(shown) == sorted(wanted)


def test_every_page_of_the_reference_is_listed():
    listed = re.findall(r"^([a-z-]+)$", (DOCS / "api" / "index.md").read_text(), flags=re.MULTILINE)
    assert sorted(listed) == sorted(page.stem for page in (DOCS / "api").glob("*.rst"))


def test_every_status_of_an_edit_is_explained():
    text = (DOCS / "howto-statuses.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE)
    assert sorted(rows) == sorted(EditStatus.__members__)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_to_files_hold(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def blocks(page):
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def missing_names(source):
    """Return names of our packages in a script that are not there: implicit.X, compare.X, meshref.X, shapes.X."""
    imported = {"implicit": implicit, "shapes": implicit.shapes, "families": implicit.families}
    imported |= {name: importlib.import_module(name) for name in ("meshref", "compare")}
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in imported:
            if not hasattr(imported[node.value.id], node.attr):
                found.append(f"{node.value.id}.{node.attr}")
        elif isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("implicit", "meshref", "compare"):
            module = importlib.import_module(str(node.module))
            found += [f"{node.module}.{alias.name}" for alias in node.names if not hasattr(module, alias.name)]
    return found


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=lambda page: page.stem)
def test_snippets_use_names_that_are_there(page):
    assert [name for block in blocks(page) for name in missing_names(block)] == []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_has_its_picture_what_it_prints_and_a_place_in_the_gallery(script):
    source = script.read_text(encoding="utf-8")
    assert missing_names(source) == []
    assert ast.get_docstring(ast.parse(source))
    assert script.with_suffix(".webp").stat().st_size < 100_000
    assert script.with_suffix(".txt").read_text(encoding="utf-8").strip()
    title = ast.get_docstring(ast.parse(source)).splitlines()[0]
    assert f"[![{title}]({script.stem}.webp)]({script.stem}.py)" in (DOCS / "gallery" / "index.md").read_text()


def test_the_cheapest_script_runs(tmp_path):
    assert "ARAP" in draw_gallery.run(DOCS / "gallery" / "mesh_editors.py", tmp_path)


@pytest.mark.nightly
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_runs_and_draws(script, tmp_path):
    assert draw_gallery.run(script, tmp_path).strip()


# The snippets of a page belong together, in its order.
RUNNING = [
    "start",
    "tutorial-mesh",
    "howto-statuses",
    "howto-choose",
    "howto-pandas",
    "howto-flows",
    "howto-watch-smoothing",
]


@pytest.mark.nightly
@pytest.mark.parametrize("page", RUNNING)
def test_the_snippets_of_a_page_run(page, tmp_path):
    code = "\n".join(blocks(DOCS / f"{page}.md"))
    if "import pandas" in code:
        pytest.importorskip("pandas", reason="the page shows pandas, which is no dependency")
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx", reason="the extra docs is not installed; .ci/site builds the site")
    done = subprocess.run(
        ["bash", str(ROOT / ".ci" / "site"), str(tmp_path / "site")],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "gallery" / "bump.html").is_file()


def test_the_citation_names_the_version_and_the_paper():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), flags=re.MULTILINE)[1]
    assert f'version: "{version}"' in text
    assert "2304.12951" in text


def test_the_seconds_of_slow_tests_name_tests_that_are_here():
    listed = [name for name in json.loads((ROOT / "tests" / "slow_tests.json").read_text()) if "test_site.py" in name]
    here = Path(__file__).read_text()
    assert all(f"def {name.split('::')[1]}(" in here for name in listed)
