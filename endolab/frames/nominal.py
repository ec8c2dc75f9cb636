"""What is assumed of an endoscope that nobody has calibrated: a fisheye of equal angles, a nominal light."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from endolab.frames.frame import Frame
from endolab.model.cameras import KannalaBrandt
from endolab.model.endoscope import NOMINAL_LIGHT, Calibration
from endolab.model.photometry import NOMINAL
from endolab.numerics.checks import check_kinds, number


@check_kinds(frame=Frame)
def nominal_calibration(frame: Frame, fov: float = 140.0) -> Calibration:
    """Assume an endoscope for a picture of one that nobody calibrated. Distances then show the shape alone.

    The smallest circle around all that the picture shows, a disc, an octagon or the whole picture, is `fov`
    wide, and the angle off the axis grows with the distance from its centre, ϑ = h/f (Kannala-Brandt without
    its higher terms).

    Parameters
    ----------
    frame : Frame
        What surrounds the field of view is found, if its mask leaves nothing out.
    fov : float
        Field of view across that circle, degrees; makers state it, usually 120 to 170.

    Returns
    -------
    Calibration
        Its light is `endolab.model.photometry.NOMINAL`, without a gain, with γ 1 if the frame says that it is
        linear; its evidence says "nominal".

    Raises
    ------
    ValueError
        If `fov` is not between 10 and 230 degrees.

    Examples
    --------
    >>> import endolab as el
    >>> frame = el.load_traced("matt").frame
    >>> el.nominal_calibration(frame, fov=120).photometry.k
    1.0
    """
    number("fov", fov, 10, 230)
    shown = cv2.findNonZero(frame.selection.pixels.astype(np.uint8))
    (cx, cy), radius = cv2.minEnclosingCircle(cv2.convexHull(shown))
    f = (radius + 0.5) / np.deg2rad(fov / 2)
    camera = KannalaBrandt(frame.width, frame.height, f, f, cx, cy, (0, 0, 0, 0))
    evidence = {"camera": {"nominal": True, "fov": fov}, **NOMINAL_LIGHT}
    light = replace(NOMINAL, gamma=1.0) if frame.is_linear else NOMINAL
    return Calibration(camera, light, evidence)


def nominal_of_several(frames: Iterable[Frame], fov: float) -> Calibration:
    """Assume one endoscope for pictures of several sizes, a camera for each.

    It is that of the widest field but one: a picture alone may show a menu, or no endoscope. As of
    `nominal_calibration`.
    """
    found: dict[tuple[int, int], list[Any]] = {}
    for frame in frames:
        known = nominal_calibration(frame, fov)
        found.setdefault((frame.width, frame.height), []).append(known)
    chosen = [
        sorted(alike, key=lambda known: known.camera.fx)[-2:][0] for alike in found.values()
    ]
    return replace(chosen[0], others=[known.camera for known in chosen[1:]])
