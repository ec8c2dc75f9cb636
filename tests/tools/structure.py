"""Measure the house: files, folders, levels, arrows that run back up, circles.

Imports are read from the code, those inside functions and under ``TYPE_CHECKING`` included; nothing is run.
A graph is a mapping: who imports whom.
"""

import ast
import graphlib


def modules(package):
    """Dotted names, below the package, of its modules; its own faces (``__init__``) left out."""
    return {
        ".".join(path.relative_to(package).with_suffix("").parts): path
        for path in sorted(package.rglob("*.py"))
        if path.stem != "__init__"
    }


def imports(package):
    """Which modules of the package each of its modules imports.

    A name that is taken from a folder's face counts as the folder.
    """
    known = modules(package)
    graph = {module: set() for module in known}
    for module, path in known.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _imported(node):
                start, *parts = name.split(".")
                # The longest part of the name that is a module, or else a folder.
                ends = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
                found = [end for end in ends if end in known]
                found += [
                    end for end in ends if (package / end.replace(".", "/")).is_dir()
                ]
                if start == package.name and found and found[0] != module:
                    graph[module].add(found[0])
    return graph


def _imported(node):
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.level == 0:
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def folder_of(module):
    """The room of a module: the first part of its name."""
    return module.split(".")[0]


def by_folder(graph):
    """The same arrows between folders; a module at the top stands for itself."""
    folders = {}
    for module, others in graph.items():
        here = folders.setdefault(folder_of(module), set())
        here |= {folder_of(other) for other in others} - {folder_of(module)}
    return folders


def circle(graph):
    """Modules that import one another in a circle; empty if there is none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def levels(graph):
    """Longest way down from each, from 1; the graph has no circle."""
    depth = {}
    for name in graphlib.TopologicalSorter(graph).static_order():
        below = [depth[other] for other in graph.get(name, ())]
        depth[name] = 1 + max(below, default=0)
    return depth


def upward(graph, order):
    """Arrows from a lower folder to a higher one, in an order given from the bottom up."""
    rank = {folder: place for place, folder in enumerate(order)}
    return sorted(
        (module, other)
        for module, others in graph.items()
        for other in others
        if rank.get(folder_of(other), -1) > rank.get(folder_of(module), len(order))
    )
