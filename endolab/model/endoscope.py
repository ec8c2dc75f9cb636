"""What is known of an endoscope: its camera and its light, and how `endoscope.json` tells them."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

from endolab.model.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.model.cameras import Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.model.schema import Section, quoted

_CAMERAS: dict[str, dict[str, int]] = {  # numbers that each model needs; lists by their length
    "kannala_brandt": {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "k": 4},
    "pinhole": {"fx": 0, "fy": 0, "cx": 0, "cy": 0},
    "scaramuzza": {"cx": 0, "cy": 0, "a": 5, "c": 0, "d": 0, "e": 0},
}


def _camera(section: Section) -> Camera:
    model = section.choice("model", tuple(_CAMERAS))
    size = {}
    for key in ("width", "height"):
        value = section.positive(key)
        if value > 100_000 or value != int(value):
            raise section.error(key, f"expected a whole number of pixels, found {value:g}")
        size[key] = int(value)
    values: dict[str, Any] = {}
    for key, count in _CAMERAS[model].items():
        if count:
            values[key] = section.numbers(key, count)
        elif key in ("fx", "fy"):
            values[key] = section.positive(key)
        else:
            values[key] = section.number(key)
    if model == "scaramuzza":
        values["row_scale"] = section.positive("row_scale", 1.0)
    make = {"kannala_brandt": KannalaBrandt, "pinhole": Pinhole, "scaramuzza": Scaramuzza}[model]
    camera: Camera = section.build(make, **size, **values)
    return camera


def _brdf(section: Section) -> BRDF:
    if section.choice("model", ("lambertian", "tabulated")) == "tabulated":
        theta, values = section.numbers("theta"), section.numbers("value")
        table: BRDF = section.build(TabulatedBRDF, theta=theta, values=values)
        return table
    three = isinstance(section.content.get("albedo"), list | tuple)
    albedo = section.numbers("albedo", 3) if three else section.positive("albedo", 1.0)
    matt: BRDF = section.build(Lambertian, albedo=albedo)
    return matt


def _photometry(section: Section) -> Photometry:
    k, gamma = section.number("k", low=0.0), section.positive("gamma")
    gain = None if section.content.get("gain", ...) is None else section.positive("gain")
    section.take("gain", None)
    brdf = _brdf(section.section("brdf"))
    listed = section.take("lights", [])
    if not isinstance(listed, list):
        raise section.error("lights", f"expected a list, found {quoted(listed)}")
    lights = []
    for index, item in enumerate(listed):
        light = Section(item, f"{section.where}.lights[{index}]", section.file)
        values: dict[str, Any] = {name: light.numbers(name, 3) for name in ("position", "direction")}
        values |= {"exponent": light.number("exponent", low=0.0), "weight": light.positive("weight", 1.0)}
        lights.append(light.build(SpotLight, **values))
    made: Photometry = section.build(Photometry, k=k, gamma=gamma, gain=gain, brdf=brdf, lights=tuple(lights))
    return made


def _checked_version(top: Section) -> None:
    version = top.take("endolab")
    if version != 1 or isinstance(version, bool):
        raise top.error("endolab", f"expected version 1, found {quoted(version)}")


def camera_from_dict(content: Any, name: str = "camera") -> Camera:
    """Check an `endoscope.json` that holds the camera, and perhaps nothing else."""
    top = Section(content, "", name)
    _checked_version(top)
    return _camera(top.section("camera"))


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """Return the section `camera` of an `endoscope.json`."""
    content = {"model": camera.model} | asdict(camera)
    if content.get("row_scale") == 1.0:
        del content["row_scale"]
    return content


@dataclass(frozen=True)
class Endoscope:
    """What is known of an endoscope; the face's `Calibration` is one that is read from a file and written."""

    camera: Camera
    photometry: Photometry
    evidence: dict[str, Any] = field(default_factory=dict)  # standard errors, ranges, provenance

    @classmethod
    def from_dict(cls, content: dict[str, Any], name: str = "calibration") -> Self:
        """Check the content of an `endoscope.json`; errors name the file (or `name`) and the key."""
        top = Section(content, "", name)
        _checked_version(top)
        camera, photometry = _camera(top.section("camera")), _photometry(top.section("photometry"))
        evidence = top.take("evidence", {})
        if not isinstance(evidence, dict):
            raise top.error("evidence", f"expected an object {{…}}, found {quoted(evidence)}")
        top.end()
        return cls(camera, photometry, evidence)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of an `endoscope.json`."""
        brdf = self.photometry.brdf
        if isinstance(brdf, TabulatedBRDF):
            surface: dict[str, Any] = {"model": "tabulated", "theta": brdf.theta, "value": brdf.values}
        elif isinstance(brdf, Lambertian):
            surface = {"model": "lambertian", "albedo": brdf.albedo}
        else:
            raise ValueError(
                f"a calibration file holds Lambertian or tabulated BRDFs, not {type(brdf).__name__}"
            )
        photometry = {name: getattr(self.photometry, name) for name in ("k", "gamma", "gain")}
        photometry["brdf"] = surface
        if self.photometry.lights:
            photometry["lights"] = [asdict(light) for light in self.photometry.lights]
        whole = {"endolab": 1, "camera": camera_to_dict(self.camera), "photometry": photometry}
        return whole | ({"evidence": self.evidence} if self.evidence else {})

    def resize(self, width: int, height: int) -> Self:
        """Return the same for pictures of another size, px."""
        return replace(self, camera=self.camera.resize(width, height))
