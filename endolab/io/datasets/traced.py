"""The path-traced frames that come with endolab: what a file holds.

`make traced` makes them anew with Mitsuba. One file a frame, NAME.npz, holds

- image: (H, W, 3) uint8, the frame as a camera stores it;
- distance: (H, W) uint16, Euclidean, steps of 1/256 mm; 0 where there is no surface;
- direct, indirect (H, W, 3) and mirrored (H, W): uint16, linear light times gain to the power of
  1/γ, in steps of 1/8 of a grey level of 255;
- facts: JSON text with the scene, the calibration that the light was made with, and the options.

Rows of the uint16 hold differences to the left, modulo 65536, which pack better. The normals are
the scene's own at the stored distance.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.frames.frame import Frame, check_size
from endolab.io.atomic import PathLike, name_damage
from endolab.io.datasets.sample import Sample
from endolab.io.surfaces import read_arrays
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import unknown_name
from endolab.synthetic.scenes import Colon

FOLDER = Path(__file__).resolve().parent / "frames"
LAYERS = ("direct", "indirect", "mirrored")
DISTANCE_STEP = 1 / 256  # mm
GREY_STEPS = 8 * 255
TRACED = ("matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy")


@dataclass(frozen=True, eq=False)
class TracedSample(Sample):
    """A path-traced frame with its truth.

    Its calibration is what the light was made with, gain and all its lights; `photometry.simplify()` is the
    one light that stands for three. Distances are true to 0.002 mm.
    """

    normals: FloatArray  # (H, W, 3), true, unit, in the camera frame, towards the camera
    direct: FloatArray  # (H, W, 3), linear light times gain, 1 being the sensor's maximum
    indirect: FloatArray  # (H, W, 3), the same
    mirrored: FloatArray  # (H, W), the same, of the wet film
    scene: Colon


def read(path: PathLike) -> TracedSample:
    """Read a frame of the set; OSError or ValueError in one sentence, if it cannot be read or is none."""
    source = Path(path)
    what = "a path-traced frame that endolab wrote"
    stored = read_arrays(source, what, ("image", "distance", *LAYERS, "facts"))
    with name_damage(source, what):
        facts = json.loads(str(stored["facts"]))
        scene = Colon(**facts["scene"])
        made_with = Calibration.from_dict(facts["calibration"], source.stem)
        image = stored["image"] / 255
        check_size(source.stem, image.shape[1::-1], made_with.camera)
        codes = {
            layer: np.cumsum(stored[layer], axis=1, dtype=np.uint16)
            for layer in ("distance", *LAYERS)
        }
        layers = {
            layer: (codes[layer] / GREY_STEPS) ** made_with.photometry.gamma
            for layer in LAYERS
        }
        mask = codes["distance"] > 0
        distance = np.where(mask, codes["distance"] * DISTANCE_STEP, np.nan)
        rays = made_with.camera.field.rays[mask]
        here = scene.normals(distance[mask][:, None] * rays)
        beyond = scene.normals((distance[mask] + DISTANCE_STEP)[:, None] * rays)
        # Which begins at its place to rounding.
        far_wall = (beyond == [0.0, 0.0, -1.0]).all(axis=-1)
        normals = np.full(image.shape, np.nan)
        normals[mask] = np.where(far_wall[:, None], beyond, here)
        frame = Frame(image, mask, source.stem)
        return TracedSample(frame, made_with, distance, normals, scene=scene, **layers)


def load_traced(name: str = "diffuse-1") -> TracedSample:
    """Load a path-traced frame that comes with endolab, with its truth and its layers of light.

    Parameters
    ----------
    name : {"matt", "diffuse-1", "diffuse-2", "diffuse-3", "wet-1", "wet-2", "foggy"}
        `matt` is a bare wall; `diffuse-1` to `diffuse-3` have mottles, vessels and one grey level of
        noise; `wet-1`, `wet-2` and `foggy` three lights, a wet film and three grey levels. The second
        and the last two are of a fisheye.

    Returns
    -------
    TracedSample
        Frame, calibration, true distance and normals, and the layers of light.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is none of that name or it cannot be read.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("wet-1")
    >>> sample.frame.image.shape, sample.mirrored.any()
    ((240, 320, 3), np.True_)
    """
    if name not in TRACED:
        raise unknown_name("traced frame", name, TRACED)
    return read(FOLDER / f"{name}.npz")
