"""What is known of an endoscope: its camera and its light, and how `endoscope.json` tells them."""

from dataclasses import field, replace
from typing import Annotated, Any, Literal, Self

from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.photometry import Photometry
from endolab.numerics.checked_types import OneOf, checked, from_content, to_content

AnyCamera = Annotated[Camera, OneOf(BrownConrady, KannalaBrandt, Pinhole, Scaramuzza)]


@checked
class Calibration:
    """What is known of an endoscope: its camera and its light.

    Parameters
    ----------
    camera : Camera
    photometry : Photometry
    evidence : dict
        Standard errors, sampled ranges, provenance; nothing here depends on it.
    """

    endolab: Literal[1] = field(default=1, kw_only=True, repr=False)  # version of the file
    camera: AnyCamera
    photometry: Photometry
    evidence: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, content: Any, name: str = "calibration") -> Self:
        """Check the content of an `endoscope.json`; errors name the file (or `name`) and the key."""
        calibration: Self = from_content(cls, content, name)
        return calibration

    def to_dict(self) -> dict[str, Any]:
        """Return the content of an `endoscope.json`."""
        return to_content(self)

    def resize(self, width: int, height: int) -> Self:
        """Return the same for pictures of another size, px."""
        return replace(self, camera=self.camera.resize(width, height))


def camera_from_dict(content: Any, name: str) -> Camera:
    """Check the camera of an `endoscope.json`, which may hold nothing else."""
    alone = {"photometry": {}} | content if isinstance(content, dict) else content
    return Calibration.from_dict(alone, name).camera
