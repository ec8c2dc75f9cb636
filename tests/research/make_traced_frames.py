"""Path-trace the frames that come with endolab anew, with Mitsuba.

`python -m tests.research.make_traced_frames FOLDER [NAMES]` makes them; `endolab.io.datasets.traced` reads
them and says what a file holds.
"""

import json
import sys
from dataclasses import asdict
from io import BytesIO
from pathlib import Path

import numpy as np
from tqdm import tqdm

import endolab as el
from endolab.io.atomic import write_atomically
from endolab.io.datasets.traced import DISTANCE_STEP, GREY_STEPS, LAYERS
from endolab.synthetic.scenes import Colon

SAMPLES = 256  # paths a pixel: leaves less than a grey level of their noise

_TISSUE = el.Lambertian((0.75, 0.38, 0.30))
_ONE = el.Photometry(k=2.5, gamma=2.2, brdf=_TISSUE)
_AROUND = [
    (3.5 * np.cos(angle), 3.5 * np.sin(angle), 0.0)
    for angle in np.deg2rad([90, 210, 330])
]
_LIGHTS = tuple(el.SpotLight(place, exponent=2.5, weight=1 / 3) for place in _AROUND)
_THREE = el.Photometry(k=0.0, gamma=2.2, brdf=_TISSUE, lights=_LIGHTS)
_COLONS = (
    Colon(),
    Colon(
        radius=26, fold_height=0.3, fold_spacing=33, sharpness=5, winding=-9, length=190
    ),
    Colon(
        radius=19,
        fold_height=0.45,
        fold_spacing=24,
        sharpness=9,
        winding=18,
        length=150,
    ),
)
_TEXTURED = {"texture": 0.10, "vessels": 0.35}
_DRY = _TEXTURED | {"noise": 1.0}
_WET = _TEXTURED | {"film": 0.025, "noise": 3.0}


# Scene, camera ("simple", a pinhole, or "paper", the paper's fisheye, at 320 px), light, options of `trace`.
CASES = {
    "matt": (_COLONS[0], "simple", _ONE, {}),
    "diffuse-1": (_COLONS[0], "simple", _ONE, _DRY | {"seed": 1}),
    "diffuse-2": (_COLONS[1], "paper", _ONE, _DRY | {"texture": 0.12, "seed": 2}),
    "diffuse-3": (_COLONS[2], "simple", _ONE, _DRY | {"seed": 3}),
    "wet-1": (_COLONS[0], "simple", _THREE, _WET | {"seed": 4}),
    "wet-2": (_COLONS[1], "paper", _THREE, _WET | {"seed": 5}),
    "foggy": (_COLONS[2], "paper", _THREE, _WET | {"fog": 0.001, "seed": 6}),
}


def write(path, traced, scene, options):
    """Write a frame of the set."""
    gamma = traced.photometry.gamma
    facts = {
        "scene": asdict(scene),
        "options": options,
        "calibration": el.Calibration(traced.camera, traced.photometry).to_dict(),
    }
    arrays = {
        "facts": np.array(json.dumps(facts, allow_nan=False)),
        "image": np.round(255 * traced.image).astype(np.uint8),
    }
    layers = {
        name: GREY_STEPS * getattr(traced, name) ** (1 / gamma) for name in LAYERS
    }
    layers["distance"] = np.nan_to_num(traced.distance) / DISTANCE_STEP
    for name, layer in layers.items():
        code = np.clip(np.round(layer), 0, 65535).astype(np.uint16)
        arrays[name] = np.diff(code, axis=1, prepend=np.uint16(0))
    packed = BytesIO()
    np.savez_compressed(packed, **arrays)
    write_atomically(path, packed.getvalue())


if __name__ == "__main__":
    from tests.research.path_tracing import trace

    folder = Path(sys.argv[1])
    for name in tqdm(sys.argv[2:] or CASES, unit="frame"):
        scene, camera, photometry, options = CASES[name]
        options = options | {"samples": SAMPLES}
        camera = el.load_calibration(camera, 320).camera
        traced = trace(scene, camera, photometry, **options)
        write(folder / f"{name}.npz", traced, scene, options)
