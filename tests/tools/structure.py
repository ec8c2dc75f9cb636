"""Measure the house: files, folders, levels, arrows that run back up, circles, tokens and how dense they are.

``python tests/tools/structure.py [FOLDER]`` prints the figures of the package in a folder, by default
this checkout's. Imports are read from the code, those inside functions and under ``TYPE_CHECKING``
included; nothing is run.
"""

import ast
import graphlib
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
Graph = Mapping[str, set[str]]  # who imports whom


def modules(package: Path) -> dict[str, Path]:
    """Dotted names, below the package, of its modules; its own faces (``__init__``) left out."""
    paths = sorted(package.rglob("*.py"))
    return {
        ".".join(p.relative_to(package).with_suffix("").parts): p
        for p in paths
        if p.stem != "__init__"
    }


def imports(package: Path) -> dict[str, set[str]]:
    """Which modules of the package each of its modules imports.

    A name that is taken from a folder's face counts as the folder.
    """
    known = modules(package)
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        graph[module] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _imported(node):
                start, *parts = name.split(".")
                # The longest part of the name that is a module, or else a folder.
                ends = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
                folders = [
                    end for end in ends if (package / end.replace(".", "/")).is_dir()
                ]
                found = [*(end for end in ends if end in known), *folders]
                if start == package.name and found and found[0] != module:
                    graph[module].add(found[0])
    return graph


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.level == 0:
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def folder_of(module: str) -> str:
    """The room of a module: the first part of its name."""
    return module.split(".")[0]


def by_folder(graph: Graph) -> dict[str, set[str]]:
    """The same arrows between folders; a module at the top stands for itself."""
    folders: dict[str, set[str]] = {}
    for module, others in graph.items():
        here = folders.setdefault(folder_of(module), set())
        here |= {folder_of(other) for other in others} - {folder_of(module)}
    return folders


def circle(graph: Graph) -> list[str]:
    """Modules that import one another in a circle; empty if there is none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def levels(graph: Graph) -> dict[str, int]:
    """Longest way down from each, from 1; the graph has no circle."""
    depth: dict[str, int] = {}
    for name in graphlib.TopologicalSorter(graph).static_order():
        below = [depth[other] for other in graph.get(name, ())]
        depth[name] = 1 + max(below, default=0)
    return depth


def upward(graph: Graph, order: list[str]) -> list[tuple[str, str]]:
    """Arrows from a lower folder to a higher one, in an order given from the bottom up."""
    rank = {folder: place for place, folder in enumerate(order)}
    return sorted(
        (module, other)
        for module, others in graph.items()
        for other in others
        if rank.get(folder_of(other), -1) > rank.get(folder_of(module), len(order))
    )


def size_of(text: str) -> Counter[str]:
    """How much code a module has, and how densely it is packed; without comments and docstrings.

    `packed` are assignments of tuples to tuples, `constants` those of the module.
    """
    tree = ast.parse(text)
    words: set[int] = set()
    size: Counter[str] = Counter()
    for node in ast.walk(tree):
        documented = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if documented and ast.get_docstring(node):
            words |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            size["packed"] += isinstance(node.targets[0], ast.Tuple)
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE and token.start[0] not in words:
            size["tokens"] += 1
            code |= set(range(token.start[0], token.end[0] + 1))
    size["lines"] = len(code)
    for node in tree.body:
        if isinstance(node, ast.Assign):
            name = node.targets[0]
            size["constants"] += isinstance(name, ast.Name) and name.id.isupper()
    return size


def measure(folder: Path) -> str:
    """The sizes of all modules below a folder, as a line of the table."""
    size: Counter[str] = Counter()
    for path in folder.rglob("*.py"):
        size += size_of(path.read_text(encoding="utf-8"))
    lines = max(size["lines"], 1)
    return (
        f"{size['tokens']:>7} {size['lines']:>6} {size['tokens'] / lines:>6.1f} "
        f"{1000 * size['packed'] / lines:>6.1f} {size['constants']:>6}"
    )


def main(root: Path = ROOT) -> None:
    """Print the figures."""
    package = root / "endolab"
    graph = imports(package)
    folders = by_folder(graph)
    print(f"files   {len(graph)}, {sum(map(len, graph.values()))} arrows between them")
    print(f"circles {circle(graph)} of files, {circle(folders)} of folders")
    print(f"levels  {max(levels(graph).values())} of files; of folders:")
    for name, level in sorted(levels(folders).items(), key=lambda item: item[1]):
        print(f"{level:>3} {name}")
    print(
        " tokens  lines  a line packed constants; packed: tuples assigned to tuples, per 1000 lines"
    )
    rooms = sorted(
        path for path in package.iterdir() if (path / "__init__.py").is_file()
    )
    for folder in (package, *rooms, root / "tests"):
        print(f"{measure(folder)}  {folder.relative_to(root)}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
