"""`endoscope.json`: what is known of an endoscope, read and written with care."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from endolab.brdf import BRDF, Lambertian, TabulatedBRDF
from endolab.cameras import Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.files import PathLike, as_json, write_atomically
from endolab.lights import SpotLight
from endolab.photometry import Photometry

_CAMERAS: dict[str, dict[str, int]] = {  # numbers that each model needs; lists by their length
    "kannala_brandt": {"fx": 0, "fy": 0, "cx": 0, "cy": 0, "k": 4},
    "pinhole": {"fx": 0, "fy": 0, "cx": 0, "cy": 0},
    "scaramuzza": {"cx": 0, "cy": 0, "a": 5, "c": 0, "d": 0, "e": 0},
}


def _is_finite(value: Any) -> bool:
    """Whether a JSON value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


class _Section:
    """A part of a JSON file that is read key by key; every error names the key."""

    def __init__(self, content: Any, where: str, file: str) -> None:
        self.where, self.file = where, file
        if not isinstance(content, dict):
            raise self.error("", f"expected an object {{…}}, found {json.dumps(content)[:40]}")
        self.content = dict(content)

    def error(self, key: str, what: str) -> ValueError:
        name = ".".join(part for part in (self.where, key) if part)
        return ValueError(f"{self.file}: {name or 'the file'}: {what}")

    def take(self, key: str, default: Any = ...) -> Any:
        if key not in self.content and default is ...:
            raise self.error(key, "missing")
        return self.content.pop(key, default)

    def section(self, key: str) -> _Section:
        return _Section(self.take(key), ".".join(filter(None, (self.where, key))), self.file)

    def number(self, key: str, default: Any = ..., low: float = -np.inf) -> float:
        value = self.take(key, default)
        if not _is_finite(value):
            raise self.error(key, f"expected a finite number, found {json.dumps(value)}")
        if value < low:
            raise self.error(key, f"expected at least {low:g}, found {value:g}")
        return float(value)

    def positive(self, key: str, default: Any = ...) -> float:
        value = self.number(key, default)
        if value <= 0:
            raise self.error(key, f"expected a positive number, found {value:g}")
        return value

    def numbers(self, key: str, count: int | None = None, default: Any = ...) -> tuple[float, ...]:
        value = self.take(key, default)
        good = isinstance(value, list | tuple) and (count is None or len(value) == count)
        if not good or not all(_is_finite(x) for x in value):
            wanted = f"{count} finite numbers" if count else "a list of finite numbers"
            raise self.error(key, f"expected {wanted}, found {json.dumps(value)}")
        return tuple(float(x) for x in value)

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        value = self.take(key)
        if value not in choices:
            raise self.error(key, f"expected one of {', '.join(choices)}, found {json.dumps(value)}")
        return str(value)

    def end(self) -> None:
        if self.content:
            raise self.error(sorted(self.content)[0], "unknown key")

    def build(self, make: Any, **values: Any) -> Any:
        """Call a constructor whose own complaint names the value; say where it stands."""
        self.end()
        try:
            return make(**values)
        except ValueError as error:
            raise self.error("", str(error)) from error


def _camera(section: _Section) -> Camera:
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


def _brdf(section: _Section) -> BRDF:
    if section.choice("model", ("lambertian", "tabulated")) == "tabulated":
        theta, values = section.numbers("theta"), section.numbers("value")
        table: BRDF = section.build(TabulatedBRDF, theta=theta, values=values)
        return table
    albedo = section.content.get("albedo")
    value = (
        section.numbers("albedo", 3) if isinstance(albedo, list | tuple) else section.positive("albedo", 1.0)
    )
    matt: BRDF = section.build(Lambertian, albedo=value)
    return matt


def _photometry(section: _Section) -> Photometry:
    k, gamma = section.number("k", low=0.0), section.positive("gamma")
    gain = None if section.content.get("gain", ...) is None else section.positive("gain")
    section.content.pop("gain", None)
    brdf = _brdf(section.section("brdf"))
    listed = section.take("lights", [])
    if not isinstance(listed, list):
        raise section.error("lights", f"expected a list, found {json.dumps(listed)[:40]}")
    lights = []
    for index, item in enumerate(listed):
        light = _Section(item, f"{section.where}.lights[{index}]", section.file)
        lights.append(
            light.build(
                SpotLight,
                position=light.numbers("position", 3),
                direction=light.numbers("direction", 3),
                exponent=light.number("exponent", low=0.0),
                weight=light.positive("weight", 1.0),
            )
        )
    made: Photometry = section.build(Photometry, k=k, gamma=gamma, gain=gain, brdf=brdf, lights=tuple(lights))
    return made


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
    def load(cls, path: PathLike) -> Calibration:
        """Read `endoscope.json`.

        Parameters
        ----------
        path : path

        Raises
        ------
        OSError, ValueError
            In one sentence that names the key, if something in it is missing, misspelt or wrong.
        """
        source = Path(path)
        if not source.is_file():
            raise FileNotFoundError(f"{source}: there is no such calibration file")
        try:
            content = json.loads(source.read_text(encoding="utf-8"))
        except OSError as error:
            raise OSError(f"{source}: cannot be read: {error.strerror or error}") from error
        except UnicodeDecodeError as error:
            raise ValueError(f"{source}: not UTF-8 text") from error
        except RecursionError as error:
            raise ValueError(f"{source}: not valid JSON: it is nested too deeply") from error
        except ValueError as error:
            raise ValueError(f"{source}: not valid JSON: {error}") from error
        return cls.from_dict(content, str(source))

    @classmethod
    def from_dict(cls, content: dict[str, Any], name: str = "calibration") -> Calibration:
        """Make a calibration from the content of an `endoscope.json`; see `load`."""
        top = _Section(content, "", name)
        version = top.take("endolab")
        if version != 1 or isinstance(version, bool):
            raise top.error("endolab", f"expected version 1, found {json.dumps(version)}")
        camera, photometry = _camera(top.section("camera")), _photometry(top.section("photometry"))
        evidence = top.take("evidence", {})
        if not isinstance(evidence, dict):
            raise top.error("evidence", f"expected an object {{…}}, found {json.dumps(evidence)[:40]}")
        top.end()
        return cls(camera, photometry, evidence)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of an `endoscope.json`."""
        camera = {"model": self.camera.model} | asdict(self.camera)
        if camera.get("row_scale") == 1.0:
            del camera["row_scale"]
        brdf = self.photometry.brdf
        if isinstance(brdf, TabulatedBRDF):
            surface: dict[str, Any] = {"model": "tabulated", "theta": brdf.theta, "value": brdf.values}
        elif isinstance(brdf, Lambertian):
            surface = {"model": "lambertian", "albedo": brdf.albedo}
        else:
            raise ValueError(
                f"a calibration file holds Lambertian or tabulated BRDFs, not {type(brdf).__name__}"
            )
        photometry: dict[str, Any] = {
            "k": self.photometry.k,
            "gamma": self.photometry.gamma,
            "gain": self.photometry.gain,
            "brdf": surface,
        }
        if self.photometry.lights:
            photometry["lights"] = [asdict(light) for light in self.photometry.lights]
        whole = {"endolab": 1, "camera": camera, "photometry": photometry}
        return whole | ({"evidence": self.evidence} if self.evidence else {})

    def save(self, path: PathLike) -> None:
        """Write `endoscope.json`, whole or not at all."""
        write_atomically(path, as_json(self.to_dict()))

    def resize(self, width: int, height: int) -> Calibration:
        """Return the calibration for pictures of another size, px."""
        return Calibration(self.camera.resize(width, height), self.photometry, self.evidence)
