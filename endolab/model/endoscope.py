"""What is known of an endoscope: its camera and its light, and how `endoscope.json` tells them."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

from endolab.model.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.model.schema import Section, quote

_CAMERAS: dict[
    str, tuple[type[Camera], dict[str, int | None]]
] = {  # with the numbers they need; lists by their length, None of any
    "brown_conrady": (
        BrownConrady,
        {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "k": None},
    ),
    "kannala_brandt": (KannalaBrandt, {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "k": 4}),
    "pinhole": (Pinhole, {"fx": 0, "fy": 0, "cx": 0, "cy": 0}),
    "scaramuzza": (Scaramuzza, {"cx": 0, "cy": 0, "a": 5, "c": 0, "d": 0, "e": 0}),
}


def _camera(section: Section) -> Camera:
    make, lengths = _CAMERAS[section.choice("model", tuple(_CAMERAS))]
    values: dict[str, Any] = {
        key: section.integer(key, low=1) for key in ("width", "height")
    }
    for key, count in lengths.items():
        values[key] = section.number(key) if count == 0 else section.numbers(key, count)
    if make is Scaramuzza:
        values["row_scale"] = section.number("row_scale", 1.0)
    camera: Camera = section.build(make, **values)
    return camera


def _brdf(section: Section) -> BRDF:
    made: BRDF
    if section.choice("model", ("lambertian", "tabulated")) == "tabulated":
        theta = section.numbers("theta")
        values = section.numbers("value")
        made = section.build(TabulatedBRDF, theta=theta, values=values)
    else:
        three = isinstance(section.content.get("albedo"), list | tuple)
        made = section.build(
            Lambertian,
            albedo=section.numbers("albedo", 3) if three else section.number("albedo", 1.0),
        )
    return made


def _photometry(section: Section) -> Photometry:
    values: dict[str, Any] = {name: section.number(name) for name in ("k", "gamma")}
    values["gain"] = (
        None if section.content.get("gain", ...) is None else section.number("gain")
    )
    section.take("gain", None)
    values["brdf"] = _brdf(section.section("brdf"))
    listed = section.take("lights", [])
    if not isinstance(listed, list):
        raise section.error("lights", f"expected a list, found {quote(listed)}")
    lights = []
    for index, item in enumerate(listed):
        light = Section(item, f"{section.where}.lights[{index}]", section.file)
        parts: dict[str, Any] = {
            "position": light.numbers("position", 3),
            "direction": light.numbers("direction", 3),
            "exponent": light.number("exponent"),
            "weight": light.number("weight", 1.0),
        }
        lights.append(light.build(SpotLight, **parts))
    made: Photometry = section.build(Photometry, **values, lights=tuple(lights))
    return made


def _check_version(top: Section) -> None:
    version = top.take("endolab")
    if version != 1 or isinstance(version, bool):
        raise top.error("endolab", f"expected version 1, found {quote(version)}")


def camera_from_dict(content: Any, name: str = "camera") -> Camera:
    """Check an `endoscope.json` that holds the camera, and perhaps nothing else."""
    top = Section(content, "", name)
    _check_version(top)
    return _camera(top.section("camera"))


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """Return the section `camera` of an `endoscope.json`."""
    content = {"model": camera.model} | asdict(camera)
    if content.get("row_scale") == 1.0:
        del content["row_scale"]
    return content


@dataclass(frozen=True)
class Calibration:
    """What is known of an endoscope: its camera and its light.

    Parameters
    ----------
    camera : Camera
    photometry : Photometry
    evidence : dict
        Standard errors, sampled ranges, provenance; nothing here depends on it.
    """

    camera: Camera
    photometry: Photometry
    evidence: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, content: dict[str, Any], name: str = "calibration") -> Self:
        """Check the content of an `endoscope.json`; errors name the file (or `name`) and the key."""
        top = Section(content, "", name)
        _check_version(top)
        camera = _camera(top.section("camera"))
        photometry = _photometry(top.section("photometry"))
        evidence = top.take("evidence", {})
        if not isinstance(evidence, dict):
            raise top.error(
                "evidence", f"expected an object {{…}}, found {quote(evidence)}"
            )
        top.end()
        return cls(camera, photometry, evidence)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of an `endoscope.json`."""
        brdf = self.photometry.brdf
        surface: dict[str, Any]
        if isinstance(brdf, TabulatedBRDF):
            surface = {"model": "tabulated", "theta": brdf.theta, "value": brdf.values}
        elif isinstance(brdf, Lambertian):
            surface = {"model": "lambertian", "albedo": brdf.albedo}
        else:
            raise ValueError(
                f"a calibration file holds Lambertian or tabulated BRDFs, not {type(brdf).__name__}"
            )
        light = self.photometry
        photometry: dict[str, Any] = {
            "k": light.k,
            "gamma": light.gamma,
            "gain": light.gain,
            "brdf": surface,
        }
        if light.lights:
            photometry["lights"] = [asdict(spot) for spot in light.lights]
        camera = camera_to_dict(self.camera)
        content = {"endolab": 1, "camera": camera, "photometry": photometry}
        return content | ({"evidence": self.evidence} if self.evidence else {})

    def resize(self, width: int, height: int) -> Self:
        """Return the same for pictures of another size, px."""
        return replace(self, camera=self.camera.resize(width, height))
