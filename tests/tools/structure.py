"""Measure the house: files, folders, levels, arrows that run back up, circles, tokens and how dense they are.

``python tests/tools/structure.py [FOLDER]`` prints the figures of the package in a folder, by default
this checkout's. Imports are read from the code, those inside functions and under ``TYPE_CHECKING``
included; nothing is run.
"""

import ast
import io
import sys
import tokenize
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NO_CODE = {
    *(
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    )
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
                    found = next(
                        (end for end in ends if (package / end.replace(".", "/")).is_dir()),
                        None,
                    )
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
    return [
        name.removeprefix(f"{package}.") for name in names if name.startswith(f"{package}.")
    ]


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
        seen = set()
        ahead = [node]
        while ahead:
            new = set(graph.get(ahead.pop(), ())) - seen
            seen |= new
            ahead += new
        beyond[node] = seen
    found = {
        tuple(sorted(b for b in beyond[a] if a in beyond.get(b, ())))
        for a in graph
        if a in beyond[a]
    }
    return sorted(map(list, found))


def levels(graph: Graph) -> dict[str, int]:
    """Longest way down from each, from 1; those in one circle share a level."""
    group = {
        name: name
        for name in {*graph, *(other for others in graph.values() for other in others)}
    }
    for circle in circles(graph):
        group.update(dict.fromkeys(circle, circle[0]))
    below: dict[str, set[str]] = {}
    for name, others in graph.items():
        below.setdefault(group[name], set()).update(group[other] for other in others)
    depth: dict[str, int] = {}

    def level(name: str) -> int:
        if name not in depth:
            depth[name] = 1 + max(
                (level(o) for o in below.get(name, ()) if o != name), default=0
            )
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


@dataclass(frozen=True)
class Size:
    """How much code there is, and how densely it is packed; without comments and docstrings."""

    tokens: int = 0
    lines: int = 0
    packed: int = 0  # assignments of tuples to tuples
    constants: int = 0  # of modules

    def __add__(self, other: "Size") -> "Size":
        return Size(
            self.tokens + other.tokens,
            self.lines + other.lines,
            self.packed + other.packed,
            self.constants + other.constants,
        )

    def __str__(self) -> str:
        lines = max(self.lines, 1)
        return (
            f"{self.tokens:>7} {self.lines:>6} {self.tokens / lines:>6.1f} "
            f"{1000 * self.packed / lines:>6.1f} {self.constants:>6}"
        )


def size_of(text: str) -> Size:
    """Measure the text of a module."""
    tree = ast.parse(text)
    words: set[int] = set()
    packed = 0
    for node in ast.walk(tree):
        if isinstance(
            node, ast.Module | ast.ClassDef | ast.FunctionDef
        ) and ast.get_docstring(node):
            words |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
        if isinstance(node, ast.Assign):
            packed += isinstance(node.targets[0], ast.Tuple) and isinstance(
                node.value, ast.Tuple
            )
    code: set[int] = set()
    tokens = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE and token.start[0] not in words:
            tokens += 1
            code |= set(range(token.start[0], token.end[0] + 1))
    constants = [
        node
        for node in tree.body
        if isinstance(node, ast.Assign)
        and all(
            isinstance(target, ast.Name) and target.id.isupper() for target in node.targets
        )
    ]
    return Size(tokens, len(code), packed, len(constants))


def measure(folder: Path) -> Size:
    """Measure all modules below a folder."""
    sizes = (size_of(path.read_text(encoding="utf-8")) for path in folder.rglob("*.py"))
    return sum(sizes, Size())


def main(root: Path = ROOT) -> None:
    """Print the figures."""
    package = root / "endolab"
    graph = imports(package)
    folders = by_folder(graph)
    deep = levels(graph)
    wide = levels(folders)
    print(f"files             {len(graph)}")
    print(f"folders           {sum((package / name).is_dir() for name in folders)}")
    print(f"levels of files   {max(deep.values())}")
    print(f"levels of folders {max(wide.values())}")
    print(f"arrows            {sum(map(len, graph.values()))} between files")
    print(
        f"circles           {len(circles(graph))} of files, {len(circles(folders))} of folders"
    )
    for circle in (*circles(graph), *circles(folders)):
        print("   ", " - ".join(circle))
    for level in sorted(set(wide.values())):
        print(
            f"{level:>3}  {' '.join(sorted(name for name in folders if wide[name] == level))}"
        )
    print(
        " tokens  lines  a line packed constants; packed: tuples assigned to tuples, per 1000 lines"
    )
    rooms = sorted(path for path in package.iterdir() if (path / "__init__.py").is_file())
    for folder in (package, *rooms, root / "tests"):
        print(f"{measure(folder)}  {folder.relative_to(root)}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
