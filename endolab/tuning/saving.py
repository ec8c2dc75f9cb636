"""What the tuner's knobs say, as settings that `endolab reconstruct --settings` takes."""

from typing import Any

from endolab.io.settings import SolvingSettings
from endolab.model.endoscope import Endoscope
from endolab.tuning.source import Settings


def saved(settings: Settings, calibration: Endoscope, grey: bool = False) -> SolvingSettings:
    """Say a position of the knobs as settings for a frame, which may be `grey`, and its calibration.

    Of the light they hold what the solver believes otherwise than the calibration.
    """
    keywords = settings.keywords(grey) | {"width": min(settings.width, calibration.camera.width)}
    known = calibration.photometry
    believed = settings.believed(known)
    names = [name for name in ("k", "gamma", "gain") if getattr(believed, name) != getattr(known, name)]
    light: dict[str, Any] = {name: getattr(believed, name) for name in names}
    albedo = getattr(believed.brdf, "albedo", None)
    if believed.brdf is not known.brdf and albedo is not None:
        light["albedo"] = albedo
    return SolvingSettings(keywords, light)
