"""The house: imports point down, none in a circle; the core knows neither files nor people."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "endolab"

# From the bottom up: a folder imports only folders that stand before it. CONTRIBUTING.md shows the same list.
ORDER = [
    "numerics",
    "model",
    "frames",
    "synthetic",
    "solvers",
    "calibration",
    "metrics",
    "reconstruction",
    "io",
    "workbench",
    "batch",
    "cli",
]
CORE = ORDER[: ORDER.index("io")]

UPSTAIRS_ONLY = {
    "rerun",
    "matplotlib",
    "ipywidgets",
    "IPython",
    "open3d",
    "tqdm",
    "pathlib",
    "io",
    "csv",
}
FILE_CALLS = {
    "open",
    "print",
    "input",
    "imread",
    "imwrite",
    "imdecode",
    "VideoCapture",
    "VideoWriter",
    "imshow",
    "savez",
    "savez_compressed",
    "loadtxt",
    "savetxt",
    "genfromtxt",
    "fromfile",
    "tofile",
    "read_text",
    "write_text",
    "read_bytes",
    "write_bytes",
}
# What a library measures, ours need not.
BORROWED = {"metrics.open3d_mesh": {"imports open3d"}}


def complaints(source):
    """What a module of the core may not have in it."""
    for node in ast.walk(ast.parse(source)):
        names = [getattr(node, "module", None)]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        starts = {name.split(".")[0] for name in names if name}
        yield from (f"imports {start}" for start in starts & UPSTAIRS_ONLY)
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            yield from (f"calls {call}" for call in {name} & FILE_CALLS)


def modules():
    """Files of the package's modules, by their dotted names below it; its own faces left out."""
    return {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.stem != "__init__"
    }


def imported(node):
    """Names that a statement imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.level == 0:
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def imports():
    """Which modules of the package each of its modules imports, inside functions and for types, too.

    A name that is taken from a folder's face counts as the folder.
    """
    known = modules()
    graph = {module: set() for module in known}
    for module, path in known.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in imported(node):
                start, *parts = name.split(".")
                # The longest part of the name that is a module, or else a folder.
                ends = [".".join(parts[:n]) for n in range(len(parts), 0, -1)]
                found = [end for end in ends if end in known]
                found += [
                    end for end in ends if (PACKAGE / end.replace(".", "/")).is_dir()
                ]
                if start == PACKAGE.name and found and found[0] != module:
                    graph[module].add(found[0])
    return graph


def folder_of(module):
    return module.split(".")[0]


def test_imports_run_down_and_in_no_circle():
    graph = imports()
    TopologicalSorter(graph).prepare()
    floors = {folder: number for number, folder in enumerate(ORDER)}
    for module, others in graph.items():
        floor = floors.get(folder_of(module), len(ORDER))  # the top imports all
        assert [o for o in others if floors.get(folder_of(o), 0) > floor] == [], module


def test_no_import_hides_where_it_leads():
    for path in modules().values():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            assert not getattr(node, "level", 0), f"{path}: relative"
            text = ast.unparse(node) if isinstance(node, ast.Call) else ""
            hidden = "import_module" in text and "endolab" in text
            assert not hidden, f"{path}: import_module"


def test_no_test_imports_another_test():
    """What two of them need is in tests/tools, or beside them in a file that is no test."""
    for path in (ROOT / "tests").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [getattr(node, "module", None) or ""]
            if isinstance(node, ast.Import | ast.ImportFrom):
                names += [alias.name for alias in node.names]
            assert not any(
                part.endswith("_test") for name in names for part in name.split(".")
            ), path


def test_the_core_knows_neither_files_nor_people():
    for name, path in modules().items():
        if folder_of(name) in CORE:
            found = set(complaints(path.read_text(encoding="utf-8")))
            assert found <= BORROWED.get(name, set()), name


def test_the_map_of_the_house_shows_the_same_order():
    text = (
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## The house")[1]
    )
    assert re.findall(r"^\| `(\w+)/` \|", text, re.MULTILINE) == ORDER
