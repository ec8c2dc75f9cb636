"""The path-traced frames that come with endolab: made anew with Mitsuba, read without it.

`python -m endolab.traced_set FOLDER [NAMES]` makes them. One file a frame, NAME.npz, holds

- image: (H, W, 3) uint8, the frame as a camera stores it;
- distance: (H, W) uint16, Euclidean, steps of 1/256 mm; 0 where there is no surface;
- direct, indirect (H, W, 3) and mirrored (H, W): uint16, linear light times gain to the power of
  1/γ, in steps of 1/8 of a grey level of 255;
- facts: JSON text with the scene, the calibration that the light was made with, and the options.

Rows of the uint16 hold differences to the left, modulo 65536, which pack better. The normals are
the scene's own at the stored distance.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from endolab.datasets.known_endoscopes import load_calibration
from endolab.datasets.sample import Sample
from endolab.io.atomic import PathLike, staged_folder, write_atomically
from endolab.io.descriptions import Calibration
from endolab.model.brdf import Lambertian
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.synthetic.path_tracing import Traced, trace
from endolab.synthetic.scenes import Colon

FOLDER = Path(__file__).resolve().parent / "frames"
SAMPLES = 256  # paths a pixel: leaves less than a grey level of their noise
LAYERS = ("direct", "indirect", "mirrored")
DISTANCE_STEP = 1 / 256  # mm
GREY_STEPS = 8 * 255

_TISSUE = Lambertian((0.75, 0.38, 0.30))
_ONE = Photometry(k=2.5, gamma=2.2, brdf=_TISSUE)
_THREE = Photometry(
    k=0.0,
    gamma=2.2,
    brdf=_TISSUE,
    lights=tuple(
        SpotLight((3.5 * np.cos(angle), 3.5 * np.sin(angle), 0.0), exponent=2.5, weight=1 / 3)
        for angle in np.deg2rad([90, 210, 330])
    ),
)
_COLONS = (
    Colon(),
    Colon(radius=26, fold_height=0.3, fold_spacing=33, sharpness=5, winding=-9, length=190),
    Colon(radius=19, fold_height=0.45, fold_spacing=24, sharpness=9, winding=18, length=150),
)
_TEXTURED = {"texture": 0.10, "vessels": 0.35}
_DRY = _TEXTURED | {"noise": 1.0}
_WET = _TEXTURED | {"film": 0.025, "noise": 3.0}


@dataclass(frozen=True)
class Case:
    """What a frame of the set shows.

    Attributes
    ----------
    scene : Colon
    camera : {"simple", "paper"}
        A pinhole, or the paper's fisheye at 320 px.
    photometry : Photometry
    options : dict
        Of `path_tracing.trace`.
    """

    scene: Colon
    camera: str
    photometry: Photometry
    options: dict[str, float]


CASES = {
    "matt": Case(_COLONS[0], "simple", _ONE, {}),
    "diffuse-1": Case(_COLONS[0], "simple", _ONE, _DRY | {"seed": 1}),
    "diffuse-2": Case(_COLONS[1], "paper", _ONE, _DRY | {"texture": 0.12, "seed": 2}),
    "diffuse-3": Case(_COLONS[2], "simple", _ONE, _DRY | {"seed": 3}),
    "wet-1": Case(_COLONS[0], "simple", _THREE, _WET | {"seed": 4}),
    "wet-2": Case(_COLONS[1], "paper", _THREE, _WET | {"seed": 5}),
    "foggy": Case(_COLONS[2], "paper", _THREE, _WET | {"fog": 0.001, "seed": 6}),
}


@dataclass(frozen=True)
class TracedSample(Sample):
    """A path-traced frame with its truth.

    Attributes
    ----------
    frame : Frame
    calibration : Calibration
        What the light was made with, gain and all its lights; `photometry.simplified()` is the one
        light that stands for three.
    distance : (H, W) float array
        True Euclidean distance, mm, to 0.002 mm; nan where there is no surface.
    normals : (H, W, 3) float array
        True unit normals in the camera frame, towards the camera.
    direct, indirect : (H, W, 3) float arrays
        Linear light times gain, 1 being the sensor's maximum.
    mirrored : (H, W) float array
        The same, of the wet film.
    scene : Colon
    """

    normals: FloatArray
    direct: FloatArray
    indirect: FloatArray
    mirrored: FloatArray
    scene: Colon


def write(path: PathLike, traced: Traced, case: Case, samples: int) -> None:
    """Write a frame of the set; see the module for the layout.

    Raises
    ------
    OSError
        In one sentence, if it cannot be written.
    ValueError
        If a distance is beyond 255 mm.
    """
    far = float(np.nanmax(traced.distance))
    if far > 255:
        raise ValueError(f"the file holds distances up to 255 mm, got {far:.0f} mm")
    facts = {
        "scene": asdict(case.scene),
        "calibration": Calibration(traced.camera, traced.photometry).to_dict(),
        "options": case.options | {"samples": samples},
    }
    layers: dict[str, FloatArray] = {"distance": np.nan_to_num(traced.distance) / DISTANCE_STEP}
    for name in LAYERS:
        layers[name] = GREY_STEPS * getattr(traced, name) ** (1 / traced.photometry.gamma)
    arrays: dict[str, Any] = {
        "image": np.round(255 * traced.image).astype(np.uint8),
        "facts": np.array(json.dumps(facts, allow_nan=False)),
    }
    for name, layer in layers.items():
        code = np.clip(np.round(layer), 0, 65535).astype(np.uint16)
        arrays[name] = np.diff(code, axis=1, prepend=np.uint16(0))
    packed = BytesIO()
    np.savez_compressed(packed, **arrays)
    write_atomically(path, packed.getvalue())


def read(path: PathLike) -> TracedSample:
    """Read a frame of the set.

    Parameters
    ----------
    path : path

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read or is none.
    """
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"{source}: there is no such file")
    try:
        with open(source, "rb") as stream, np.load(stream, allow_pickle=False) as content:
            stored: dict[str, Any] = dict(content)
        facts = json.loads(str(stored["facts"]))
        scene = Colon(**facts["scene"])
        made_with = Calibration.from_dict(facts["calibration"], str(source))
        image = stored["image"] / 255
        codes = {name: np.cumsum(stored[name], axis=1, dtype=np.uint16) for name in ("distance", *LAYERS)}
        layers = {name: (codes[name] / GREY_STEPS) ** made_with.photometry.gamma for name in LAYERS}
    except Exception as error:  # a broken zip, a missing part: NumPy has many ways to say so
        raise ValueError(f"{source}: not a path-traced frame that endolab wrote ({error})") from error
    mask = codes["distance"] > 0
    distance = np.where(mask, codes["distance"] * DISTANCE_STEP, np.nan)
    rays, normals = made_with.camera.field.rays[mask], np.full(image.shape, np.nan)
    here, beyond = (scene.normals((distance[mask] + step)[:, None] * rays) for step in (0.0, DISTANCE_STEP))
    far_wall = (beyond == [0.0, 0.0, -1.0]).all(axis=-1)  # which begins at its place to rounding
    normals[mask] = np.where(far_wall[:, None], beyond, here)
    frame = Frame(image, mask, source.stem)
    return TracedSample(frame, made_with, distance, normals, scene=scene, **layers)


def _show(bar: Any, share: float) -> None:
    bar.update(100 * share - bar.n)


def make(folder: PathLike, names: Sequence[str] = (), *, samples: int = SAMPLES) -> None:
    """Path-trace frames of the set into a folder, each whole or not at all.

    Parameters
    ----------
    folder : path
        Made if need be.
    names : sequence of str
        Which; all by default.
    samples : int
        Paths a pixel.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is none of a name, if Mitsuba cannot be used, or if the folder cannot
        be written.
    """
    from tqdm import tqdm

    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise ValueError(f"unknown frame {unknown[0]!r}; choose {', '.join(CASES)}")
    for name in names or CASES:
        case = CASES[name]
        width = 320 if case.camera == "paper" else None
        with tqdm(total=100, unit="%", desc=name, bar_format="{desc} {percentage:3.0f} % {elapsed}") as bar:
            traced = trace(
                case.scene,
                load_calibration(case.camera, width).camera,
                case.photometry,
                bits=8,
                samples=samples,
                progress=partial(_show, bar),
                **case.options,  # type: ignore[arg-type]
            )
        with staged_folder(folder) as staging:
            write(staging / f"{name}.npz", traced, case, samples)


def main(arguments: Sequence[str]) -> int:
    """Make the set: ``python -m endolab.traced_set FOLDER [NAMES]``."""
    if not arguments or arguments[0].startswith("-"):
        print(f"usage: python -m endolab.traced_set FOLDER [{' | '.join(CASES)}]...", file=sys.stderr)
        return 2
    try:
        make(arguments[0], arguments[1:])
    except (ValueError, OSError) as error:
        print(f"endolab: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

TRACED = ("matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy")


def load_traced(name: str = "diffuse-1") -> TracedSample:
    """Load a path-traced frame that comes with endolab, with its truth and its layers of light.

    Parameters
    ----------
    name : {"matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy"}
        `matt` is a bare wall; `diffuse-1` to `diffuse-3` have mottles, vessels and one grey level of
        noise; `wet-1`, `wet-2` and `foggy` three lights, a wet film and three grey levels. The second
        and the last two are of a fisheye.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is none of that name or it cannot be read.
    """
    if name not in TRACED:
        raise ValueError(f"unknown traced frame {name!r}; choose {', '.join(TRACED)}")
    return read(FOLDER / f"{name}.npz")
