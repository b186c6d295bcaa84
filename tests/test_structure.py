"""How the packages are built: who may import whom, in which order, and how large a function may grow."""

import ast
import importlib.util
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SPEC = importlib.util.spec_from_file_location("structure", ROOT / "tests" / "structure.py")
structure = importlib.util.module_from_spec(SPEC)
sys.modules["structure"] = structure
SPEC.loader.exec_module(structure)

FILES = structure.sources()
MODULES = {structure.module_name(path) for path in FILES}

FORBIDDEN = {
    "implicit": {"igl", "meshref", "compare", "trimesh", "pymeshlab"},
    "meshref": {"torch", "implicit", "compare"},
}

# The wings, from the ground up: no import runs to one that comes later. What is new in a package takes its place here.
ORDER = {
    "implicit": [
        "arguments", "renamed", "files", "data", "field", "models", "shapes", "surface", "sensitivity", "step",
        "evolve", "fitting", "edits", "families", "__init__",
    ],
    "compare": [
        "errors", "files", "cases", "operations", "fitting", "runs", "reports", "studies", "paper", "editor",
        "commands", "__init__", "__main__",
    ],
}  # fmt: skip

MOST_LINES = 60
MOST_ARGUMENTS = 12
MORE_ARGUMENTS = {
    # Every edit takes the field, points, damping, constraints, resolution, track, progress and seed: eight.
    "implicit/edits/geometric.py::geometric_edit": (13, "the eight, two for the target, three for how it is reached"),
    "implicit/edits/rigid.py::rigid_edit": (
        17,
        "the eight, the method, the shape at rest, and a weight for each of the four terms of the energy",
    ),
    "implicit/edits/smoothing.py::smooth": (
        19,
        "the eight, a law of motion with its time and form, and what ends and holds it",
    ),
    # The samples are three arrays; each option stands alone in fit_mesh and in the command line, with its default.
    "compare/fitting/fit.py::fit_mesh": (
        15,
        "the mesh, those of fit_field that a command has, and what is good enough",
    ),
    "implicit/fitting/fit.py::fit_field": (
        22,
        "three arrays, five for a network or one of the caller's, the rest for one training",
    ),
}


@pytest.mark.parametrize("package", FORBIDDEN)
def test_a_package_imports_only_what_it_may(package):
    found = [
        f"{path}:{x.line} imports {x.module}"
        for path, text in FILES.items()
        if path.startswith(f"{package}/")
        for x in structure.imports(path, text, MODULES)
        if x.module.split(".")[0] in FORBIDDEN[package]
    ]
    assert found == []


def test_one_module_imports_pymeshlab():
    """The library is under the GPL: its one importer does so when it is called."""
    found = {
        (path, x.where)
        for path, text in FILES.items()
        for x in structure.imports(path, text, MODULES)
        if x.module.split(".")[0] == "pymeshlab"
    }
    assert found == {("meshref/meshlab.py", "function")}


@pytest.mark.parametrize("package", structure.PACKAGES)
def test_no_import_runs_in_a_circle(package):
    files = structure.file_graph(FILES, package)
    assert structure.circles(files) == []
    assert structure.circles(structure.room_graph(files)) == []


@pytest.mark.parametrize("package", ORDER)
def test_no_import_runs_upwards(package):
    rooms = structure.room_graph(structure.file_graph(FILES, package))
    level = {name: place for place, name in enumerate(ORDER[package])}
    assert {wing(room) for room in rooms.nodes} <= set(level)
    assert [f"{a} imports {b}" for a, b in sorted(rooms.arrows) if level[wing(a)] < level[wing(b)]] == []


def wing(room):
    """Return "step" for "implicit/step" and for "implicit/step/factors" within it."""
    return room.split("/")[1]


def test_every_file_that_is_no_module_is_package_data():
    """So that a wheel has all that the packages read: types, shapes, trained families, studies, the report's page."""
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    packed = set()
    for package, globs in patterns.items():
        folders = [ROOT / package.replace(".", "/")] if package != "*" else [ROOT / name for name in structure.PACKAGES]
        packed |= {path for folder in folders for pattern in globs for path in folder.glob(pattern)}
    there = [path for name in structure.PACKAGES for path in (ROOT / name).rglob("*.*")]
    assert {path for path in there if path.suffix not in (".py", ".pyc")} == packed
    assert {ROOT / name / "py.typed" for name in structure.PACKAGES} <= packed


def functions():
    """Each function with the path of its file, its full name, and the lines of code of its file."""
    for path, text in FILES.items():
        lines = code_lines(text)
        stack = [(node, "") for node in structure.tree(text).body]
        while stack:
            node, prefix = stack.pop()
            name = prefix + getattr(node, "name", "")
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield path, name, node, lines
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                stack += [(child, f"{name}.") for child in node.body]


def code_lines(text):
    """The lines that are neither blank nor a comment, nor a bare string, which docstrings are."""
    written = {n for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"}
    for node in ast.walk(structure.tree(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            written -= set(range(node.lineno, node.end_lineno + 1))
    return written


def body_lines(node, lines):
    """How many lines of code the body has; the arguments are counted by the rule for arguments."""
    return len(lines & set(range(node.body[0].lineno, node.end_lineno + 1)))


def test_no_function_is_longer_than_a_page():
    long = [
        f"{path}::{name}: {n}" for path, name, node, lines in functions() if (n := body_lines(node, lines)) > MOST_LINES
    ]
    assert long == []


def test_no_public_call_has_many_arguments_without_a_reason():
    """Public is what neither its own name nor its class's hides, and every class's __init__."""
    counts = {}
    for path, name, node, _ in functions():
        parts = name.split(".")
        if not any(part.startswith("_") and part != "__init__" for part in parts):
            arguments = [x.arg for x in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]
            counts[f"{path}::{name}"] = len(arguments) - (arguments[:1] in (["self"], ["cls"]))
    allowed = {name: most for name, (most, _) in MORE_ARGUMENTS.items()}
    assert {name: n for name, n in counts.items() if n > allowed.get(name, MOST_ARGUMENTS)} == {}
    assert {name for name in allowed if counts.get(name, 0) <= MOST_ARGUMENTS} == set(), "needs no exception any more"


# The script itself, on packages whose structure is known.

TANGLE = {
    "implicit/__init__.py": "from implicit.top import roof",
    "implicit/top/__init__.py": "",
    "implicit/top/roof.py": "def build():\n    from implicit.middle import wall\n    return wall",
    "implicit/middle/__init__.py": "",
    "implicit/middle/wall.py": "import implicit.ground\nfrom . import door",
    "implicit/middle/door.py": "from ..middle.wall import X\nfrom implicit.ground import Y",
    "implicit/ground.py": "import typing\nif typing.TYPE_CHECKING:\n    import implicit.top.roof",
}


def test_rooms_arrows_floors_and_circles_of_a_known_package():
    files = structure.file_graph(TANGLE, "implicit")
    rooms = structure.room_graph(files)
    assert rooms.nodes == ["implicit/__init__", "implicit/ground", "implicit/middle", "implicit/top"]
    assert rooms.arrows == {
        ("implicit/__init__", "implicit/top"),
        ("implicit/top", "implicit/middle"),
        ("implicit/middle", "implicit/ground"),
        ("implicit/ground", "implicit/top"),
    }
    assert rooms.types_only == {("implicit/ground", "implicit/top")}
    assert structure.circles(rooms) == [["implicit/ground", "implicit/middle", "implicit/top"]]
    assert structure.floors(rooms) == 2
    assert structure.back_arrows(rooms) == [("implicit/ground", "implicit/top")]
    wall, door, roof = "implicit/middle/wall.py", "implicit/middle/door.py", "implicit/top/roof.py"
    assert structure.circles(files) == [sorted([wall, door, roof, "implicit/ground.py"])]


def test_back_arrows_are_the_fewest_that_leave_no_circle():
    """Two circles share the arrow b -> c: it goes alone. Where circles share none, one arrow goes of each."""
    shared = structure.Graph(list("abcd"), {("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"), ("d", "b")}, set())
    assert structure.back_arrows(shared) == [("b", "c")]
    apart = structure.Graph(list("abcd"), {("a", "b"), ("b", "a"), ("c", "d"), ("d", "c"), ("a", "c")}, set())
    assert Counter(a in "ab" for a, _ in structure.back_arrows(apart)) == {True: 1, False: 1}
    chain = structure.Graph(list("abc"), {("a", "b"), ("b", "c"), ("a", "c")}, set())
    assert structure.back_arrows(chain) == []
    assert structure.floors(chain) == 3


def test_imports_are_told_apart_by_where_they_stand():
    text = "import a\nif TYPE_CHECKING:\n    import b\nelse:\n    import c\n"
    text += "def f():\n    import d\n    import_module('e.f')\n    import_module(name)"
    assert [(x.module, x.where, x.line) for x in structure.imports("implicit/x.py", text, set())] == [
        ("a", "top", 1), ("b", "type", 3), ("c", "top", 5), ("d", "function", 7), ("e.f", "function", 8),
    ]  # fmt: skip


def test_code_lines_leave_out_docstrings_comments_and_blank_lines():
    text = 'def f(\n    x,\n):\n    """One\n\n    two."""\n    # three\n\n    y = """a\nb"""\n    return y\n'
    node = structure.tree(text).body[0]
    assert body_lines(node, code_lines(text)) == 3
