"""What is known of an endoscope: its camera and its light, and how `endoscope.json` tells them."""

from dataclasses import field, replace
from typing import Annotated, Any, Literal, Self

from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.photometry import NOMINAL, Photometry
from endolab.numerics.checked_types import OneOf, checked, from_content, to_content

NOMINAL_LIGHT = {"photometry": {"nominal": True}}  # the evidence of it
AnyCamera = Annotated[Camera, OneOf(BrownConrady, KannalaBrandt, Pinhole, Scaramuzza)]


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
    """

    endolab: Literal[1] = field(default=1, kw_only=True, repr=False)  # version of the file
    camera: AnyCamera
    photometry: Photometry = NOMINAL
    evidence: dict[str, Any] = field(default_factory=dict)

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

    def fit(self, name: str, width: int, height: int) -> Self:
        """Return the same for pictures of this size, px, which have its shape.

        ValueError that names the picture, if they have another shape.
        """
        camera = self.camera
        off = abs(height - camera.height * width / camera.width)
        if off > max(0.51, 0.003 * height):  # px; it may be rounded
            raise ValueError(
                f"{name} is {width}x{height} px, but the calibration is for {camera.width}x{camera.height} "
                "px: expected that size, the same shape, or --crop (Calibration.crop), which says what part "
                "of the calibration's picture it shows"
            )
        return self.resize(width, height)
