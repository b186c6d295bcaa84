"""Count rooms, floors, arrows and circles of the three packages: python tests/structure.py [--revision REV]

A room is a folder with its files; a file that lies at the top of a package is a room of its own. An arrow leads from a
file, or its room, to one that it imports, wherever in the file the import stands. A circle is a set of files or rooms
that can all be reached from each other (a strongly connected component of two or more); its back arrows are the fewest
whose removal leaves no circle. Floors are the longest chain of arrows, a circle counted as one floor.

Imports under `if TYPE_CHECKING:` are arrows as well, for a reader follows them; those that nothing but a type asks for
are counted beside the others. `import_module("name")` counts, a name that is computed does not.
"""

from __future__ import annotations

import argparse
import ast
import io
import subprocess
import tarfile
from collections.abc import Collection, Iterator, Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("implicit", "meshref", "compare")

Arrow = tuple[str, str]


class Import(NamedTuple):
    """One module that a file imports.

    Attributes:
        module: Dotted name, as in "implicit.field.field"; of a name out of a package, the package.
        line: Where in the file.
        where: "top", "function", or "type" under `if TYPE_CHECKING:`.
    """

    module: str
    line: int
    where: str


class Graph(NamedTuple):
    """Rooms or files of one package and the arrows between them.

    Attributes:
        nodes: Names.
        arrows: Pairs (importer, imported), never of one node with itself.
        types_only: Those arrows that stand under TYPE_CHECKING alone.
    """

    nodes: list[str]
    arrows: set[Arrow]
    types_only: set[Arrow]


def sources(revision: str | None = None) -> dict[str, str]:
    """Return the text of each Python file of the packages by its path, of the working tree or of a git revision."""
    if revision is None:
        paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
        return {path.relative_to(ROOT).as_posix(): path.read_text() for path in sorted(paths)}
    command = ["git", "archive", revision, *PACKAGES]
    archive = subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        files = [member for member in tar if member.name.endswith(".py")]
        return {member.name: tar.extractfile(member).read().decode() for member in files}


@cache
def tree(text: str) -> ast.Module:
    """Return the syntax tree of a file's text, parsed once."""
    return ast.parse(text)


def module_name(path: str) -> str:
    """Return "implicit.field.field" for "implicit/field/field.py", and "implicit.field" for its __init__.py."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def room(path: str) -> str:
    """Return the room of a file: "implicit/edits" for "implicit/edits/rigid.py", "implicit/files" at the top."""
    folder, _, name = path.rpartition("/")
    return folder if "/" in folder else f"{folder}/{name.removesuffix('.py')}"


def imports(path: str, text: str, modules: Collection[str]) -> list[Import]:
    """Return all that a file imports; `from a import b` counts as a.b if that is one of the modules, else as a."""
    package = module_name(path).split(".") if path.endswith("/__init__.py") else module_name(path).split(".")[:-1]
    found = []
    for node, where in _placed(tree(text), "top"):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names = [f"{base}.{a.name}" if f"{base}.{a.name}" in modules else base for a in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names = [node.args[0].value] if isinstance(node.args[0], ast.Constant) else []
        else:
            continue
        found += [Import(name, node.lineno, where) for name in dict.fromkeys(names)]
    return found


def _placed(node: ast.AST, where: str) -> Iterator[tuple[ast.AST, str]]:
    for child in ast.iter_child_nodes(node):
        yield child, where
        inside = where
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and where == "top":
            inside = "function"
        if isinstance(child, ast.If) and ast.unparse(child.test).endswith("TYPE_CHECKING"):
            for statement in child.body:
                yield statement, "type"
                yield from _placed(statement, "type")
            child = ast.Module(child.orelse, [])
        yield from _placed(child, inside)


def file_graph(files: Mapping[str, str], package: str) -> Graph:
    """Return the files of a package and which imports which."""
    path_of = {module_name(path): path for path in files}
    own = [path for path in files if path.startswith(f"{package}/")]
    at_run_time, of_types = set(), set()
    for path in own:
        for found in imports(path, files[path], path_of):
            target = path_of.get(found.module)
            if target in own and target != path:
                (of_types if found.where == "type" else at_run_time).add((path, target))
    return Graph(own, at_run_time | of_types, of_types - at_run_time)


def room_graph(files: Graph) -> Graph:
    """Return the rooms of a package and which imports which."""
    arrows = {(room(a), room(b)) for a, b in files.arrows if room(a) != room(b)}
    at_run_time = {(room(a), room(b)) for a, b in files.arrows - files.types_only}
    return Graph(sorted({room(path) for path in files.nodes}), arrows, arrows - at_run_time)


def components(graph: Graph) -> list[list[str]]:
    """Return the strongly connected components, the imported before the importers. Source: Tarjan 1972."""
    successors = {node: sorted(b for a, b in graph.arrows if a == node) for node in graph.nodes}
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for after in successors[node]:
            if after not in index:
                visit(after)
                low[node] = min(low[node], low[after])
            elif after in stack:
                low[node] = min(low[node], index[after])
        if low[node] == index[node]:
            at = stack.index(node)
            found.append(sorted(stack[at:]))
            del stack[at:]

    for node in graph.nodes:
        if node not in index:
            visit(node)
    return found


def circles(graph: Graph) -> list[list[str]]:
    """Return the components of two or more."""
    return [component for component in components(graph) if len(component) > 1]


def floors(graph: Graph) -> int:
    """Return the number of nodes, or circles of nodes, in the longest chain of arrows."""
    height: dict[str, int] = {}
    for component in components(graph):
        below = [height[b] for a, b in graph.arrows if a in component and b not in component]
        height.update(dict.fromkeys(component, 1 + max(below, default=0)))
    return max(height.values(), default=0)


def back_arrows(graph: Graph) -> list[Arrow]:
    """Return the fewest arrows whose removal leaves no circle, the first such set in the order of the alphabet."""
    for most in range(len(graph.arrows) + 1):
        found = _cuts(graph, most)
        if found is not None:
            return sorted(found)
    raise AssertionError("without arrows there is no circle")


def _cuts(graph: Graph, most: int) -> list[Arrow] | None:
    loop = _shortest_loop(graph)
    if loop is None:
        return []
    if most == 0:
        return None
    for arrow in sorted(pairwise(loop)):  # one of them has to go
        rest = _cuts(graph._replace(arrows=graph.arrows - {arrow}), most - 1)
        if rest is not None:
            return [arrow, *rest]
    return None


def _shortest_loop(graph: Graph) -> list[str] | None:
    # From each start in breadth; the loop begins and ends with it.
    best: list[str] | None = None
    for circle in circles(graph):
        inner = sorted((a, b) for a, b in graph.arrows if a in circle and b in circle)
        for start in circle:
            ways, seen = [[start]], {start}
            while ways and (best is None or len(ways[0]) + 1 < len(best)):
                way = ways.pop(0)
                after = [b for a, b in inner if a == way[-1]]
                if start in after:
                    best = [*way, start]
                ways += [[*way, b] for b in after if b not in seen]
                seen.update(after)
    return best


def _lines(graph: Graph, what: str) -> list[str]:
    found, back = circles(graph), back_arrows(graph)
    types = f" ({len(graph.types_only)} for types only)" if graph.types_only else ""
    return [
        f"  {what}: {len(graph.nodes)}, floors {floors(graph)}, arrows {len(graph.arrows)}{types}, "
        f"circles {len(found)}, back arrows {len(back)}",
        *(f"    circle: {', '.join(circle)}" for circle in found),
        *(f"    back arrow: {a} -> {b}" for a, b in back),
    ]


def main() -> None:
    """Print the figures of each package."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--revision", help="a git revision to read; the working tree if left out")
    files = sources(parser.parse_args().revision)
    for package in PACKAGES:
        graph = file_graph(files, package)
        print(package)
        print("\n".join([*_lines(room_graph(graph), "rooms"), *_lines(graph, "files")]))


if __name__ == "__main__":
    main()
