"""Names of version 0.1 still work, with a warning; new ones say nothing, and wrong ones are wrong."""

import importlib
import subprocess
import sys

import pytest

import endolab as el
from endolab import datasets


def reach(dotted):
    """Import a module and get its attribute, as `from module import name` does."""
    module, _, name = dotted.rpartition(".")
    return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("endolab.tuner", "endolab.tune"),
        ("endolab.mesh_of", "endolab.make_mesh"),
        ("endolab.open_folder", "endolab.open_dataset"),
        ("endolab.traced", "endolab.load_traced"),
        ("endolab.to_calibration", "endolab.make_calibration"),
        ("endolab.evaluation.compare", "endolab.metrics.compare"),
        ("endolab.style.BLUE", "endolab.plots.style.BLUE"),
        ("endolab.calibration.photometric.calibrate_light", "endolab.calibrate_light"),
        ("endolab.meshes.mesh_of", "endolab.make_mesh"),
        ("endolab.meshes.Mesh", "endolab.Mesh"),
        ("endolab.datasets.calibration", "endolab.load_calibration"),
        ("endolab.iteration.run", "endolab.run"),
        ("endolab.iteration.Status", "endolab.Status"),
        ("endolab.traced_set.read", "endolab.datasets.traced.read"),
        ("endolab.endomapper.convert", "endolab.datasets.endomapper.read_endomapper"),
        ("endolab.ucl.ucl2019", "endolab.datasets.read_ucl2019"),
    ],
)
def test_an_old_name_is_the_new_one_with_a_warning(old, new):
    expected = reach(new)
    with pytest.warns(DeprecationWarning, match="the old name goes with the next version") as warned:
        assert reach(old) is expected
    assert str(warned[0].message).startswith(f"{old} is ")


def test_old_modules_are_imported_as_before():
    from endolab import evaluation, plots, style

    with pytest.warns(DeprecationWarning, match=r"endolab\.evaluation\.compare is endolab\.metrics"):
        from endolab.evaluation import compare
    with pytest.warns(DeprecationWarning, match=r"endolab\.evaluation\.compare"):
        assert evaluation.compare is compare
    with pytest.warns(DeprecationWarning, match=r"endolab\.style\.BLUE is endolab\.plots\.style\.BLUE"):
        assert style.BLUE == plots.style.BLUE
    with pytest.warns(DeprecationWarning, match=r"datasets\.calibration is .*load_calibration"):
        assert datasets.calibration("paper") == el.load_calibration("paper")


@pytest.mark.parametrize("name", ["c3vd", "simcol3d", "ucl2019", "traced"])
def test_a_loader_that_is_a_module_now_can_still_be_called(name, tmp_path):
    """First asked for by a fresh interpreter, whose package knows none of its files yet."""
    arguments = {"traced": "'matt'", "ucl2019": f"{str(tmp_path)!r}, 'T1', 1, None"}
    code = f"from endolab import datasets; datasets.{name}({arguments.get(name, f'{str(tmp_path)!r}, 1')})"
    done = subprocess.run([sys.executable, "-W", "always", "-c", code], capture_output=True, text=True)
    assert f"DeprecationWarning: endolab.datasets.{name}(…) is " in done.stderr
    assert (done.returncode == 0) == (name == "traced")  # no frame of the others is in the folder
    assert name == "traced" or "FileNotFoundError" in done.stderr
    assert getattr(datasets, name) is importlib.import_module(f"endolab.datasets.{name}")


@pytest.mark.parametrize(
    ("module", "error", "sentence"),
    [
        ("reconstruction.reconstruct", TypeError, "missing 2 required positional arguments"),
        ("calibration.detection.detect", TypeError, "missing 2 required positional arguments"),
        ("cli.main", SystemExit, "2"),
    ],
)
def test_a_function_whose_name_is_a_files_now_can_still_be_called(module, error, sentence, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["endolab"])
    called = importlib.import_module(f"endolab.{module}")
    name = module.rpartition(".")[2]
    with (
        pytest.warns(DeprecationWarning, match=rf"{module}\(…\) is endolab\.{module}\.{name}\(…\) now"),
        pytest.raises(error, match=sentence),
    ):
        called()


def test_new_names_do_not_warn():
    for place in (el, datasets, el.plots, el.metrics):
        for name in place.__all__:
            getattr(place, name)
    from endolab.datasets.c3vd import read_c3vd
    from endolab.datasets.traced import load_traced

    assert read_c3vd is datasets.read_c3vd
    assert load_traced is el.load_traced


@pytest.mark.parametrize("module", ["", ".datasets", ".plots", ".calibration.photometric", ".evaluation"])
def test_a_wrong_name_is_no_attribute(module):
    with pytest.raises(AttributeError):
        reach(f"endolab{module}.no_such_name")
    with pytest.raises(ImportError):
        exec(f"from endolab{module} import no_such_name")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module(f"endolab{module}.no_such_name")
