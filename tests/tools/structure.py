"""Measure the house: files, lines, folders, levels, arrows that run back up, circles.

``python tests/tools/structure.py [FOLDER]`` prints the figures of the package in a folder, by default
this checkout's. Imports are read from the code, those inside functions and under ``TYPE_CHECKING``
included; nothing is run.
"""

import ast
import io
import sys
import tokenize
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NO_CODE = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
}
Graph = Mapping[str, set[str]]  # who imports whom


def modules(package: Path) -> dict[str, Path]:
    """Dotted names, below the package, of its modules; its own faces (``__init__``) left out."""
    paths = sorted(package.rglob("*.py"))
    return {".".join(p.relative_to(package).with_suffix("").parts): p for p in paths if p.stem != "__init__"}


def imports(package: Path) -> dict[str, set[str]]:
    """Which modules of the package each of its modules imports.

    A name that is taken from a folder's face counts as all that the face offers under that name.
    """
    known = modules(package)
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        graph[module] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _imported(node, package.name):
                parts = name.split(".")
                # The longest part of the name that is a module; a folder's face is the folder itself.
                ends = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
                found = next((end for end in ends if end in known), None)
                if found is None:
                    found = next((end for end in ends if (package / end.replace(".", "/")).is_dir()), None)
                if found is not None and found != module:
                    graph[module].add(found)
    return graph


def _imported(node: ast.AST, package: str) -> Iterable[str]:
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        return []
    return [name.removeprefix(f"{package}.") for name in names if name.startswith(f"{package}.")]


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


def circles(graph: Graph) -> list[list[str]]:
    """Groups that import one another, directly or not."""
    beyond: dict[str, set[str]] = {}
    for node in graph:
        seen, ahead = set(), [node]
        while ahead:
            new = set(graph.get(ahead.pop(), ())) - seen
            seen |= new
            ahead += new
        beyond[node] = seen
    found = {tuple(sorted(b for b in beyond[a] if a in beyond.get(b, ()))) for a in graph if a in beyond[a]}
    return sorted(map(list, found))


def levels(graph: Graph) -> dict[str, int]:
    """Longest way down from each, from 1; those in one circle share a level."""
    group = {name: name for name in {*graph, *(other for others in graph.values() for other in others)}}
    for circle in circles(graph):
        group.update(dict.fromkeys(circle, circle[0]))
    below: dict[str, set[str]] = {}
    for name, others in graph.items():
        below.setdefault(group[name], set()).update(group[other] for other in others)
    depth: dict[str, int] = {}

    def level(name: str) -> int:
        if name not in depth:
            depth[name] = 1 + max((level(o) for o in below.get(name, ()) if o != name), default=0)
        return depth[name]

    return {name: level(group[name]) for name in group}


def upward(graph: Graph, order: list[str]) -> list[tuple[str, str]]:
    """Arrows from a lower folder to a higher one, in an order given from the bottom up."""
    rank = {folder: place for place, folder in enumerate(order)}
    return sorted(
        (module, other)
        for module, others in graph.items()
        for other in others
        if rank.get(folder_of(other), -1) > rank.get(folder_of(module), len(order))
    )


def code_lines(text: str) -> int:
    """Count lines of code: no blanks, comments or docstrings."""
    words: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node):
            words |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - words)


def count(folder: Path) -> int:
    """Lines of code below a folder."""
    return sum(code_lines(path.read_text(encoding="utf-8")) for path in folder.rglob("*.py"))


def main(root: Path = ROOT) -> None:
    """Print the figures."""
    package = root / "endolab"
    graph = imports(package)
    folders = by_folder(graph)
    deep, wide = levels(graph), levels(folders)
    print(f"files             {len(graph)}")
    print(f"folders           {sum((package / name).is_dir() for name in folders)}")
    print(f"levels of files   {max(deep.values())}")
    print(f"levels of folders {max(wide.values())}")
    print(f"arrows            {sum(map(len, graph.values()))} between files")
    print(f"circles           {len(circles(graph))} of files, {len(circles(folders))} of folders")
    for circle in (*circles(graph), *circles(folders)):
        print("   ", " - ".join(circle))
    for level in sorted(set(wide.values())):
        print(f"{level:>3}  {' '.join(sorted(name for name in folders if wide[name] == level))}")
    print("lines of code, without blanks, comments and docstrings")
    for folder in (package, *sorted(path for path in package.iterdir() if (path / "__init__.py").is_file())):
        print(f"{count(folder):>7}  {folder.relative_to(root)}")
    print(f"{count(root / 'tests'):>7}  tests, with benchmarks and tools")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
