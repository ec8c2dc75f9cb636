"""A frame as a pinhole camera would show it, for people: solvers work on the endoscope's own pixels."""

import cv2
import numpy as np

from endolab.frames.frame import Frame, check_size
from endolab.model.cameras import Camera, Pinhole
from endolab.numerics.arrays import BoolArray, FloatArray


def undistort_frame(frame: Frame, camera: Camera) -> tuple[Frame, Pinhole]:
    """Show a frame as a pinhole camera in its place would; returns the new frame and its camera.

    The new picture is 90° wide and as fine as the frame is at its centre, with its proportions. The mask
    leaves out what the old one left out or did not reach.
    """
    check_size(frame.name, (frame.width, frame.height), camera, "camera")
    axis = np.array([[0.0, 0.0, 1.0], [1e-4, 0.0, 1.0]])
    finest = float(np.linalg.norm(np.diff(camera.project(axis), axis=0)) / 1e-4)
    width = max(1, round(2 * finest))
    height = max(1, round(width * frame.height / frame.width))
    new = Pinhole(width, height, width / 2, width / 2, (width - 1) / 2, (height - 1) / 2)
    places = np.nan_to_num(camera.project(new.field.rays), nan=-9.0).astype(np.float32)

    def remap(a: FloatArray | BoolArray, border: int = cv2.BORDER_CONSTANT) -> FloatArray:
        x, y = places[..., 0], places[..., 1]
        values = a.astype(np.float64)
        return np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=border))

    image = np.clip(remap(np.nan_to_num(frame.image), cv2.BORDER_REPLICATE), 0.0, 1.0)
    mask = remap(frame.mask) > 0.999
    if not mask.any():
        raise ValueError(f"{frame.name}: the pinhole camera sees none of the frame's mask")
    silent = None if frame.silent is None else remap(frame.silent) > 0
    return Frame(image, mask, frame.name, silent), new
