"""Names of version 0.1: they work for this version, with a warning that says where things are now."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType

TYPE_CHECKING = False  # typing's own would cost as much as all else that importing endolab does
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

# What was called otherwise, wherever it is looked for.
RENAMED = {
    "View": "Subject",
    "c3vd": "read_c3vd",
    "c3vd_depth": "read_c3vd_depth",
    "Sightings": "DetectionCache",
    "calibration": "load_calibration",
    "convert": "read_endomapper",
    "mesh_of": "make_mesh",
    "open_folder": "open_dataset",
    "pose": "make_problem",
    "simcol3d": "read_simcol3d",
    "simcol3d_depth": "read_simcol3d_depth",
    "to_calibration": "make_calibration",
    "traced": "load_traced",
    "tuner": "tune",
    "ucl2019": "read_ucl2019",
    "ucl2019_depth": "read_ucl2019_depth",
}
# Where the names of a module are now: the first of these that has one.
MOVED = {
    "blueprints": "recording.layouts",
    "boards": "tuning.panels",
    "bounces": "model.interreflection",
    "brdf": "model.brdf",
    "calibration.arrow": "calibration.least_squares",
    "calibration.blobs": "calibration.detection.blobs",
    "calibration.detection": "calibration.detection.detect",
    "calibration.dots": "calibration.detection.dots",
    "calibration.geometric": "calibration.geometric.fit calibration.geometric.reprojection",
    "calibration.identifiability": "calibration.photometric.identifiability",
    "calibration.ink": "calibration.targets",
    "calibration.lattice": "calibration.detection.lattice",
    "calibration.light_fit": "calibration.photometric.result",
    "calibration.light_model": "calibration.photometric.model",
    "calibration.photometric": "calibration.photometric.fit",
    "calibration.planar": "calibration.geometric.planar_pose",
    "calibration.poses": "calibration.geometric.pose",
    "calibration.projection": "calibration.geometric.projection",
    "calibration.samples": "calibration.photometric.samples",
    "calibration.sheet_picture": "calibration.simulation.sheet_image",
    "calibration.simulate": "calibration.simulation.video",
    "calibration.trajectory": "calibration.simulation.trajectory",
    "calibration.views": "calibration.geometric.reprojection",
    "calibration_facts": "calibration.summary io.descriptions",
    "calibration_plots": "plots.calibration plots.light calibration.summary",
    "calibration_recording": "recording.calibration",
    "calibration_report": "reports.calibration_page calibration.summary io.descriptions",
    "cameras": "model.cameras",
    "cli": "cli.main",
    "cli_calibration": "cli.calibrate",
    "cli_reconstruct": "cli.reconstruct",
    "cli_sequence": "cli.reconstruct",
    "cli_solving": "cli.options",
    "contours": "preprocessing.contours",
    "datasets": "datasets.sample datasets.known_endoscopes datasets.c3vd datasets.simcol3d datasets.traced",
    "depth.compiled": "depth.energy_kernels",
    "depth.energy": "depth.energy depth.problem numerics.derivatives",
    "depth.fast_marching": "depth.fast_marching numerics.compiled",
    "depth.initial": "depth.solvers",
    "depth.padding": "numerics.compiled",
    "embed": "recording.show recording.viewer",
    "endomapper": "datasets.endomapper",
    "endoscope": "model.endoscope io.descriptions",
    "evaluation": "metrics.depth_errors",
    "files": "io.images io.atomic io.surfaces reports.result",
    "folders": "datasets.folders",
    "highlights": "preprocessing.highlights",
    "iteration": "depth.result numerics.iteration",
    "knobs": "tuning.controls",
    "lab": "cli.lab",
    "light_plots": "plots.light calibration.summary",
    "lights": "model.lights",
    "mesh_views": "plots.surface_view",
    "meshes": "reconstruction.mesh io.surfaces metrics.mesh_distance model.mesh numerics.arrays",
    "mucosa": "synthetic.mucosa",
    "operators": "numerics.derivatives numerics.arrays",
    "pair": "tuning.controls",
    "path_tracing": "synthetic.path_tracing",
    "penalties": "numerics.penalties",
    "photometry": "model.photometry",
    "pictures": "tuning.pictures",
    "plots": "plots.maps",
    "posing": "reconstruction.problem_setup",
    "preparation": "preprocessing.prepare",
    "preparation_plots": "plots.preparation",
    "preprocess": "preprocessing.frame",
    "rays": "model.cameras",
    "reconstruction": "reconstruction.reconstruct depth.solvers",
    "recording": "recording.recorder",
    "recordings": "recording.reader",
    "rendering": "synthetic.rendering",
    "roots": "numerics.roots",
    "scale": "reconstruction.scale reconstruction.assumptions",
    "scenes": "synthetic.scenes numerics.arrays",
    "sections": "model.schema io.atomic",
    "separation": "reconstruction.separation",
    "sequence": "reconstruction.sequence",
    "sequence_folder": "batch.video",
    "sequence_recording": "recording.sequence",
    "sheets": "reports.target_sheet io.descriptions",
    "side_view": "plots.surface_view",
    "sightings": "io.detection_cache",
    "style": "plots.style",
    "surface": "model.surface",
    "sweeps": "batch.sweep",
    "traced_set": "datasets.traced",
    "tuning": "tuning.engine",
    "ucl": "datasets.ucl2019",
    "video": "io.video",
    "viewer": "recording.viewer recording.stream",
    "views": "tuning.source",
    "widgets": "tuning.widget",
}
FACE = {
    "mesh_of": "reconstruction.mesh",
    "open_folder": "datasets.folders",
    "to_calibration": "io.descriptions",
    "traced": "datasets.traced",
    "tuner": "tuning.widget",
}


def _found(module: str, homes: str, name: str) -> Any:
    """Find a name of an old module in one of its new homes, and say so."""
    if not name.startswith("__"):
        for home in homes.split():
            there = import_module(f"endolab.{home}")
            new = next((n for n in (name, RENAMED.get(name, name)) if hasattr(there, n)), None)
            if new is not None:
                text = f"{module}.{name} is endolab.{home}.{new} now; the old name goes with the next version"
                warnings.warn(text, DeprecationWarning, stacklevel=3)
                return getattr(there, new)
    raise AttributeError(f"module {module!r} has no attribute {name!r}")


def with_old_names(package: str, lookup: Callable[[str], Any] | None = None) -> Callable[[str], Any]:
    """Make the ``__getattr__`` of a package that also knows what its name stood for before."""
    _, _, short = package.partition(".")

    def __getattr__(name: str) -> Any:
        if lookup is not None:
            try:
                return lookup(name)
            except AttributeError:
                pass
        if short and "__path__" in vars(sys.modules[package]):
            try:
                return import_module(f"{package}.{name}")  # a file of the folder
            except ModuleNotFoundError as error:
                if error.name != f"{package}.{name}":
                    raise
        homes = MOVED.get(short, "") if short else FACE.get(name, "")
        if not short and not homes and name in MOVED:
            return import_module(f"{package}.{name}")
        return _found(package, homes, name)

    return __getattr__


class _CalledAsBefore(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> Any:
        name = self.__name__.rpartition(".")[2]
        new = RENAMED.get(name, name)
        text = f"{self.__name__}(…) is {self.__name__}.{new}(…) now; the old name goes with the next version"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return getattr(self, new)(*arguments, **options)


def callable_as_before(module: str) -> None:
    """Let a module be called like the function that had its name before."""
    sys.modules[module].__class__ = _CalledAsBefore


class _OldModules:
    """Makes modules that are no more, asked last of all finders."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        package, _, short = name.partition(".")
        is_old = package == "endolab" and short in MOVED
        return ModuleSpec(name, self) if is_old else None  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return ModuleType(spec.name, "Moved; see endolab._deprecated.")

    def exec_module(self, module: ModuleType) -> None:
        module.__getattr__ = with_old_names(module.__name__)  # type: ignore[method-assign]


sys.meta_path.append(_OldModules())
