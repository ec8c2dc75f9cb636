"""The house: imports point down, the lower floors know neither files nor people, starting is quick."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "endolab"
FLOORS = [
    "operators penalties roots",
    "rays cameras lights brdf photometry surface scenes rendering mucosa",
    "iteration preprocess highlights preparation bounces contours depth calibration",
    "separation posing reconstruction evaluation views tuning sequence scale",
    "endoscope sections sheets files video sightings datasets recording recordings blueprints embed "
    "viewer style side_view plots meshes mesh_views light_plots pictures boards knobs pair widgets "
    "cli lab pages sequence_recording sequence_folder sweeps cli_solving cli_sequence cli_reconstruct "
    "cli_calibration calibration_plots calibration_facts calibration_report "
    "calibration_recording endomapper ucl folders preparation_plots path_tracing traced_set "
    "__init__ __main__",
]
FLOOR = {name: floor for floor, names in enumerate(FLOORS) for name in names.split()}
UPSTAIRS_ONLY = {
    "rerun",
    "matplotlib",
    "ipywidgets",
    "IPython",
    "open3d",
    "tqdm",
    "json",
    "pathlib",
    "io",
    "csv",
}
FILE_CALLS = {
    *("open", "print", "input", "imread", "imwrite", "imdecode", "VideoCapture", "VideoWriter", "imshow"),
    *("savez", "savez_compressed", "loadtxt", "savetxt", "genfromtxt", "fromfile", "tofile"),
    *("read_text", "write_text", "read_bytes", "write_bytes"),
}
SLOW_TO_IMPORT = ["rerun", "open3d", "matplotlib", "ipywidgets", "numba", "cv2"]


def modules():
    return sorted(str(path.relative_to(PACKAGE).with_suffix("")) for path in PACKAGE.rglob("*.py"))


def floor_of(module):
    """Floor of a module by its path or dotted name below the package: ``depth/energy`` is on depth's."""
    return FLOOR[module.replace(".", "/").split("/")[0]]


def runtime_nodes(tree):
    """Every node but those under ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for other in node.orelse:
                yield other
                yield from runtime_nodes(other)
        else:
            yield node
            yield from runtime_nodes(node)


def imported(tree):
    """Dotted names of what a module imports when it runs."""
    for node in runtime_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide their floor"
            if node.module == "endolab" or node.module.startswith("endolab."):
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
            else:
                yield node.module


def called(tree):
    """Last names of what a module calls."""
    for node in runtime_nodes(tree):
        if isinstance(node, ast.Call):
            yield getattr(node.func, "attr", getattr(node.func, "id", ""))


def complaints(source, floor):
    """What is wrong with a module's source on its floor."""
    tree = ast.parse(source)
    names = set(imported(tree))
    wrong = []
    for name in names:
        root, _, rest = name.partition(".")
        if root == "endolab" and (not rest or FLOOR.get(rest.split(".")[0], 99) > floor):
            wrong.append(f"imports {name} from above")
        if floor < 4 and root in UPSTAIRS_ONLY:
            wrong.append(f"imports {root}")
    if floor < 4:
        wrong += [f"calls {name}" for name in set(called(tree)) & FILE_CALLS]
    return sorted(wrong)


@pytest.mark.parametrize("module", modules())
def test_every_module_lives_on_a_floor_and_knows_nothing_above(module):
    assert module.split("/")[0] in FLOOR, "give the module a floor"
    source = (PACKAGE / f"{module}.py").read_text(encoding="utf-8")
    assert complaints(source, floor_of(module)) == []


@pytest.mark.parametrize(
    ("source", "complaint"),
    [
        ("from endolab.depth.energy import Problem", ["imports endolab.depth.energy.Problem from above"]),
        ("def f():\n    from endolab import files", ["imports endolab.files from above"]),
        ("import endolab", ["imports endolab from above"]),
        ("import matplotlib.pyplot as plt", ["imports matplotlib"]),
        ("from tqdm.auto import tqdm", ["imports tqdm"]),
        ("class A:\n    def f(self):\n        print(open('x'))", ["calls open", "calls print"]),
        ("import cv2\ncv2.imread('x')", ["calls imread"]),
        ("if TYPE_CHECKING:\n    from endolab.files import X\nelse:\n    import rerun", ["imports rerun"]),
        ("if TYPE_CHECKING:\n    from endolab.files import X", []),
        ("from endolab.operators import gradient\nfrom endolab import lights\nimport cv2", []),
    ],
)
def test_the_rule_itself_can_tell(source, complaint):
    assert complaints(source, 1) == complaint


def test_importing_the_package_loads_nothing_slow():
    code = f"import sys, endolab; print([m for m in {SLOW_TO_IMPORT} if m in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, timeout=60
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "[]"
