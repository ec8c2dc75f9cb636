"""What is known of an endoscope: its camera and its light, and how `endoscope.json` tells them."""

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.photometry import NOMINAL, Photometry
from endolab.numerics.checked_types import OneOf, checked, from_content, to_content

NOMINAL_LIGHT = {"photometry": {"nominal": True}}  # the evidence of it
AnyCamera = Annotated[Camera, OneOf(BrownConrady, KannalaBrandt, Pinhole, Scaramuzza)]


def same_shape(size: Sequence[int], other: Sequence[int]) -> bool:
    """Whether two sizes, px, have one ratio of width to height, but for rounding."""
    (width, height), (wide, high) = size, other
    return abs(height - high * width / wide) <= max(0.51, 0.003 * height)


@checked
class Calibration:
    """What is known of an endoscope: its camera and its light.

    Parameters
    ----------
    camera : Camera
    photometry : Photometry
        `NOMINAL` where it is missing, which the evidence then says.
    evidence : dict
        Standard errors, sampled ranges, provenance; nothing here depends on it.
    others : cameras
        For pictures of other sizes, each its own. Not written to files, as is `part`.
    part : (column, row, width, height), optional
        What of larger pictures is this endoscope's, px: they are cut when they are read.
    """

    endolab: Literal[1] = field(default=1, kw_only=True, repr=False)  # version of the file
    camera: AnyCamera
    photometry: Photometry = NOMINAL
    evidence: dict[str, Any] = field(default_factory=dict)
    others: Annotated[tuple[AnyCamera, ...], Field(exclude=True)] = ()
    part: Annotated[tuple[int, int, int, int] | None, Field(exclude=True)] = None

    @classmethod
    def from_dict(cls, content: Any, name: str = "calibration") -> Self:
        """Check the content of an `endoscope.json`; errors name the file (or `name`) and the key."""
        calibration: Self = from_content(cls, content, name)
        if "photometry" in content:
            return calibration
        return replace(calibration, evidence=calibration.evidence | NOMINAL_LIGHT)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of an `endoscope.json`."""
        return to_content(self)

    def resize(self, width: int, height: int) -> Self:
        """Return the same for pictures of another size, px."""
        return replace(self, camera=self.camera.resize(width, height))

    def crop(self, column: int, row: int, width: int, height: int) -> Self:
        """Return the same for a rectangle of its pictures, px: a zoom, or half of a stereo picture.

        ValueError if they have no such rectangle.
        """
        camera: Any = self.camera  # every model has a centre
        fits = min(column, row) >= 0 < min(width, height)
        if not fits or column + width > camera.width or row + height > camera.height:
            raise ValueError(
                f"crop must be COLUMN, ROW, WIDTH, HEIGHT within the calibration's "
                f"{camera.width}x{camera.height} px, got {column},{row},{width},{height}"
            )
        centre = {"cx": camera.cx - column, "cy": camera.cy - row}
        cut = replace(camera, width=width, height=height, **centre)
        known = self.evidence | {"crop": [column, row, width, height]}
        return replace(self, camera=cut, evidence=known)

    def for_size(self, width: int, height: int) -> Self:
        """Return the same with the camera of pictures of this size, px, if one of `others` is."""
        cameras = {(camera.width, camera.height): camera for camera in self.others}
        return replace(self, camera=cameras.get((width, height), self.camera), others=())

    def fit(self, name: str, width: int, height: int) -> Self:
        """Return the same for pictures of this size, px, which have its shape or that of one of `others`.

        ValueError that names the picture, if they have another shape.
        """
        known = self.for_size(width, height)
        camera = known.camera
        if not same_shape((width, height), (camera.width, camera.height)):
            raise ValueError(
                f"{name} is {width}x{height} px, but the calibration is for {camera.width}x{camera.height} "
                "px: expected that size, the same shape, or --crop, a part of either: what this one shows of "
                "the calibration's picture (Calibration.crop), or what of this one is the calibration's"
            )
        return known.resize(width, height)

    def cut(self, picture: np.ndarray) -> np.ndarray:
        """Cut the `part` out of a picture, (H, W) or (H, W, 3), that is so large."""
        if self.part is None:
            return picture
        column, row, width, height = self.part
        found = picture[row : row + height, column : column + width]
        return found if found.shape[:2] == (height, width) else picture
