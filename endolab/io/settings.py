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
    found, mask : str
        Light and contours of one picture, and its mask, in files beside this one; nothing by default.
    """

    keywords: Mapping[str, Any] = field(default_factory=dict)
    photometry: Mapping[str, Any] = field(default_factory=dict)
    found: str = ""
    mask: str = ""

    @property
    def settings(self) -> Settings:
        """The options."""
        return Settings(**self.keywords)

    def apply(self, calibration: Calibration) -> Calibration:
        """Return the calibration as the settings believe it to be."""
        light = dict(self.photometry)
        if "albedo" in light:
            light["brdf"] = Lambertian(light.pop("albedo"))
        lamps = light.pop("lamps", None)
        photometry = replace(calibration.photometry, **light)
        evidence = calibration.evidence
        if lamps is not None:
            photometry = photometry.with_lamps(lamps)
            evidence = evidence | {"lamps": "given"}
        return replace(calibration, photometry=photometry, evidence=evidence)


@checked
class LightBelief:
    """What may be believed of the light.

    An albedo is a matt wall's, one number or three, for the BRDF; lamps stand at x, y, mm.
    """

    k: float | None = None
    gamma: float | None = None
    gain: float | None = None
    albedo: float | tuple[float, float, float] | None = None
    lamps: tuple[tuple[float, float], ...] | None = None


@checked
class _File(Settings):
    """What a file may hold."""

    endolab_settings: Literal[1] = field(kw_only=True)
    photometry: LightBelief = LightBelief()
    found: str = ""
    mask: str = ""


def write_settings(settings: SolvingSettings, path: PathLike) -> None:
    """Write settings as JSON, whole or not at all; `read_settings` reads them."""
    content = {"endolab_settings": 1, **settings.keywords}
    named = {name: getattr(settings, name) for name in ("photometry", "found", "mask")}
    content |= {name: value for name, value in named.items() if value}
    write_atomically(path, as_json(content))


def read_settings(path: PathLike) -> SolvingSettings:
    """Read settings; OSError or ValueError in one sentence, which names what in the file is wrong."""
    content = read_json(path, "settings file")
    known = from_content(_File, content, str(path))
    light = content.pop("photometry", {})
    files = {name: content.pop(name, "") for name in ("found", "mask")}
    del content["endolab_settings"]
    return SolvingSettings(
        {name: getattr(known, name) for name in content},
        {name: getattr(known.photometry, name) for name in light},
        **{name: str(Path(path).parent / file) for name, file in files.items() if file},
    )
