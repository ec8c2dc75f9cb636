"""The house: imports point down, none in a circle; the core knows neither files nor people."""

import ast
import re
from pathlib import Path

from tests.tools import structure

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
MOST_LEVELS = 9

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


def test_no_import_runs_back_up():
    assert structure.upward(structure.imports(PACKAGE), ORDER) == []


def test_nothing_imports_in_a_circle():
    assert structure.circle(structure.imports(PACKAGE)) == []


def test_the_house_is_not_too_high():
    levels = structure.levels(structure.by_folder(structure.imports(PACKAGE)))
    assert max(levels[folder] for folder in ORDER) <= MOST_LEVELS


def test_no_import_hides_where_it_leads():
    for path in structure.modules(PACKAGE).values():
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
    for name, path in structure.modules(PACKAGE).items():
        if structure.folder_of(name) in CORE:
            found = set(complaints(path.read_text(encoding="utf-8")))
            assert found <= BORROWED.get(name, set()), name


def test_the_map_of_the_house_shows_the_same_order():
    text = (
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## The house")[1]
    )
    assert re.findall(r"^\| `(\w+)/` \|", text, re.MULTILINE) == ORDER
