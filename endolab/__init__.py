"""endolab: see how one endoscope frame becomes 3D.

    import endolab as el
    calibration = el.Calibration.load("endoscope.json")
    frame = el.read_frame("frame.png", calibration)
    result = el.reconstruct(frame, calibration, observers=[el.record("run.rrd")])

Names are loaded when they are first used, so that importing endolab costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from endolab.brdf import Glossy, Lambertian, TabulatedBRDF
    from endolab.calibration.geometric import calibrate_camera
    from endolab.calibration.photometric import calibrate_light
    from endolab.calibration.samples import Samples
    from endolab.calibration.session import calibrate
    from endolab.calibration.targets import TARGETS
    from endolab.calibration_report import to_calibration
    from endolab.cameras import KannalaBrandt, Pinhole, Scaramuzza
    from endolab.embed import show
    from endolab.endoscope import Calibration
    from endolab.files import read_frame, save_result
    from endolab.iteration import Iterate, Result, Status, run
    from endolab.lights import SpotLight
    from endolab.meshes import Mesh, mesh_of, write_mesh
    from endolab.photometry import Photometry
    from endolab.preprocess import Frame
    from endolab.reconstruction import iterate, reconstruct
    from endolab.recording import Comparison, record
    from endolab.recordings import read_recording
    from endolab.rendering import render
    from endolab.scenes import SCENES, Bowl, Colon, Plane, Tube
    from endolab.video import open_frames
    from endolab.widgets import tuner

_HOME = {
    "brdf": ("Glossy", "Lambertian", "TabulatedBRDF"),
    "calibration.geometric": ("calibrate_camera",),
    "calibration.photometric": ("calibrate_light",),
    "calibration.samples": ("Samples",),
    "calibration.session": ("calibrate",),
    "calibration.targets": ("TARGETS",),
    "calibration_report": ("to_calibration",),
    "cameras": ("KannalaBrandt", "Pinhole", "Scaramuzza"),
    "datasets": ("traced",),
    "embed": ("show",),
    "endoscope": ("Calibration",),
    "files": ("read_frame", "save_result"),
    "folders": ("open_folder",),
    "iteration": ("Iterate", "Result", "Status", "run"),
    "lights": ("SpotLight",),
    "meshes": ("Mesh", "mesh_of", "write_mesh"),
    "photometry": ("Photometry",),
    "preparation": ("prepare",),
    "preprocess": ("Frame",),
    "reconstruction": ("iterate", "reconstruct"),
    "recording": ("Comparison", "record"),
    "recordings": ("read_recording",),
    "rendering": ("render",),
    "scenes": ("SCENES", "Bowl", "Colon", "Plane", "Tube"),
    "sequence": ("reconstruct_sequence",),
    "sweeps": ("sweep",),
    "video": ("open_frames",),
    "widgets": ("tuner",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__version__ = "0.1.0"
__all__ = [
    "SCENES",
    "TARGETS",
    "Bowl",
    "Calibration",
    "Colon",
    "Comparison",
    "Frame",
    "Glossy",
    "Iterate",
    "KannalaBrandt",
    "Lambertian",
    "Mesh",
    "Photometry",
    "Pinhole",
    "Plane",
    "Result",
    "Samples",
    "Scaramuzza",
    "SpotLight",
    "Status",
    "TabulatedBRDF",
    "Tube",
    "calibrate",
    "calibrate_camera",
    "calibrate_light",
    "iterate",
    "mesh_of",
    "open_folder",
    "open_frames",
    "prepare",
    "read_frame",
    "read_recording",
    "reconstruct",
    "reconstruct_sequence",
    "record",
    "render",
    "run",
    "save_result",
    "show",
    "sweep",
    "to_calibration",
    "traced",
    "tuner",
    "write_mesh",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'endolab' has no attribute {name!r}")
    value = getattr(import_module(f"endolab.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
