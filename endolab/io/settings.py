"""How a frame is solved, in a small JSON file: what the tuner saves, and `endolab reconstruct` takes.

``{"endolab_settings": 1, "xi": "1/d", "lam": 0.002, "photometry": {"k": 2.4}}``: keywords of `reconstruct`,
and what is believed of the light in place of the calibration. What a file does not say stays as it is by
default.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from endolab.io.atomic import PathLike, as_json, read_json, write_atomically
from endolab.model.brdf import Lambertian
from endolab.model.endoscope import Calibration
from endolab.numerics.checked_types import checked, from_content
from endolab.reconstruction.settings import Settings


@dataclass(frozen=True)
class SolvingSettings:
    """How a frame is solved.

    Parameters
    ----------
    keywords : mapping
        Of `endolab.reconstruct`, those that are options of `Settings`.
    photometry : mapping
        What is believed of the light: see `LightBelief`.
    held : str
        A `held.npz` beside the file, which holds light and contours; nothing by default.
    """

    keywords: Mapping[str, Any] = field(default_factory=dict)
    photometry: Mapping[str, Any] = field(default_factory=dict)
    held: str = ""

    def apply(self, calibration: Calibration) -> Calibration:
        """Return the calibration as the settings believe it to be."""
        light = dict(self.photometry)
        if "albedo" in light:
            light["brdf"] = Lambertian(light.pop("albedo"))
        return replace(calibration, photometry=replace(calibration.photometry, **light))


@checked
class LightBelief:
    """What may be believed of the light; an albedo is a matt wall's, one number or three, for the BRDF."""

    k: float | None = None
    gamma: float | None = None
    gain: float | None = None
    albedo: float | tuple[float, float, float] | None = None


@checked
class _File(Settings):
    """What a file may hold."""

    endolab_settings: Literal[1] = field(kw_only=True)
    photometry: LightBelief = LightBelief()
    held: str = ""


def write_settings(settings: SolvingSettings, path: PathLike) -> None:
    """Write settings as JSON, whole or not at all; `read_settings` reads them."""
    content = {"endolab_settings": 1, **settings.keywords}
    if settings.photometry:
        content["photometry"] = dict(settings.photometry)
    if settings.held:
        content["held"] = settings.held
    write_atomically(path, as_json(content))


def read_settings(path: PathLike) -> SolvingSettings:
    """Read settings; OSError or ValueError in one sentence, which names what in the file is wrong."""
    content = read_json(path, "settings file")
    known = from_content(_File, content, str(path))
    light = content.pop("photometry", {})
    held = content.pop("held", "")
    del content["endolab_settings"]
    return SolvingSettings(
        {name: getattr(known, name) for name in content},
        {name: getattr(known.photometry, name) for name in light},
        str(Path(path).parent / held) if held else "",
    )
