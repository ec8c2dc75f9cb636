"""Films of a camera that moves, seen by a small endoscope in green."""

from dataclasses import replace

import numpy as np

import endolab as el
from endolab.synthetic.scenes import Colon, Tube
from tests.tools.cases import drawn

GREEN = el.load_calibration("simple").photometry.channel("green")
UNKNOWN = replace(el.load_calibration("simple", 96), photometry=GREEN)


def moved_tube(t):
    """The tube, the camera having gone on by 3 t mm."""
    return Tube(length=130 - 3 * t, tilt=5 + 0.5 * t, offset=(3 - 0.5 * t, 1))


def moved_colon(t):
    """The colon, the camera having gone on by t mm."""
    return type("Moved", (Colon,), {"_camera": np.array([2 + 0.1 * t, -1.5, t])})()


def filmed(scenes, gains):
    """A case a scene, each with its gain, and 1 grey level of noise."""
    return [
        drawn(scene, UNKNOWN, None, replace(GREEN, gain=gain), noise=1, bits=8, seed=k)
        for k, (scene, gain) in enumerate(zip(scenes, gains, strict=False))
    ]
