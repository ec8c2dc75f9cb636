"""The house: imports point down, none in a circle; the core knows neither files nor people."""

import ast
import graphlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
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
BESIDE = {"_extras", "__main__"}  # files at the top

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
BORROWED = {
    "metrics.mesh_distance": {
        "imports open3d"
    },  # what a library measures, ours need not
}
SLOW_TO_IMPORT = [
    "numpy",
    "rerun",
    "open3d",
    "matplotlib",
    "ipywidgets",
    "numba",
    "cv2",
]


# Who imports whom -----------------------------------------------------------------------
def modules():
    """Dotted names, below the package, of its modules; its own faces (``__init__``) left out."""
    return {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.stem != "__init__"
    }


def imports():
    """Which modules of the package each of its modules imports.

    A name that is taken from a folder's face counts as the folder.
    """
    known = modules()
    graph = {module: set() for module in known}
    for module, path in known.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            for name in names:
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
    """The room of a module: the first part of its name."""
    return module.split(".")[0]


def complaints(source):
    """What a module of the core may not have in it."""
    wrong = set()
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        elif isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            wrong |= {f"calls {name}"} & {f"calls {call}" for call in FILE_CALLS}
        wrong |= {
            f"imports {name.split('.')[0]}"
            for name in names
            if name.split(".")[0] in UPSTAIRS_ONLY
        }
    return wrong


def in_core():
    return sorted(name for name in modules() if folder_of(name) in CORE)


def test_every_file_lives_in_a_folder_that_has_its_place():
    assert {folder_of(name) for name in modules()} == {*ORDER, *BESIDE}


def test_no_import_runs_back_up():
    floor = {folder: place for place, folder in enumerate(ORDER)}
    for module, others in imports().items():
        for other in others if folder_of(module) in floor else ():
            assert floor.get(folder_of(other), -1) <= floor[folder_of(module)], module


def test_nothing_imports_in_a_circle():
    graphlib.TopologicalSorter(imports()).prepare()


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


@pytest.mark.parametrize("module", in_core())
def test_the_core_knows_neither_files_nor_people(module):
    source = modules()[module].read_text(encoding="utf-8")
    assert complaints(source) <= BORROWED.get(module, set())


def test_the_map_of_the_house_shows_the_same_order_and_every_file():
    text = (
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## The house")[1]
    )
    rows = re.findall(r"^\| `(\w+)/` \|[^|]*\|(.*)\|$", text, re.MULTILINE)
    assert [folder for folder, _ in rows] == ORDER
    named = {
        f"{folder}.{name}"
        for folder, files in rows
        for name in re.findall(r"`(\w+)/?`", files)
    }
    assert named == {".".join(name.split(".")[:2]) for name in modules()} - BESIDE


def test_importing_the_package_loads_nothing_slow():
    code = (
        f"import sys, endolab; print([m for m in {SLOW_TO_IMPORT} if m in sys.modules])"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert (result.returncode, result.stdout.strip()) == (0, "[]"), result.stderr
