"""Calibrations of the EndoMapper data set: two XML files in, what endolab knows of an endoscope out.

`Endoscope_XX_geometrical.xml` is written by Vicalib (the Calibu library): a Kannala-Brandt camera.
`Endoscope_XX_photometrical.xml` is written by EndoMapper's tool for the light [1]_: the response γ
and a spot light (SLS) of Modrzejewski et al. [2]_. Its fields are documented in the tool's README;
`vignetting` is not, but the tool writes it: the exponent of cos α.

Units and frames: the camera looks along z, x right, y down, as here; the light's centre P is in
metres there, in mm here. Where pixels count from is not documented: u0 and v0 are taken as they are,
from the centre of the top-left pixel, which is wrong by half a pixel (0.04°) at most.

.. [1] Azagra et al., "EndoMapper dataset of complete calibrated endoscopy procedures", 2023;
   github.com/endomapper/EM_Dataset-PhotometricCalibration.
.. [2] Modrzejewski et al., "Light modelling and calibration in laparoscopy", IJCARS 2020.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from endolab.io.atomic import PathLike
from endolab.io.cameras.documents import read_document
from endolab.io.cameras.formats import read_camera
from endolab.io.cameras.readers import numbers
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.checks import shorten


# The light ----------------------------------------------------------------------------------
def cosine_power(mu: float, cos_psi: np.ndarray) -> tuple[float, float, float]:
    """Find the cosine power nearest to the spread function of EndoMapper's spot light.

    There the light falls as exp(-μ (1 - cos ψ)), here as w cosⁿψ, which fall alike near the axis and
    apart from about 45° off it on: by 5 % of a distance at 60° with μ = 2.8. n and w are those of
    least squares in the logarithm at `cos_psi`, (m,), above 0: half an error there is the relative
    error of a distance. Returns n, w and the largest such error.
    """
    if mu == 0:
        return 0.0, 1.0, 0.0
    there = -mu * (1 - cos_psi)
    here = np.log(cos_psi)
    spread = here - here.mean()
    exponent = float(spread @ there / (spread @ spread))
    offset = float(np.mean(there - exponent * here))
    worst = float(np.max(np.abs(there - exponent * here - offset))) / 2
    return exponent, math.exp(offset), worst


def _light(part: dict[str, Any], rays: np.ndarray) -> tuple[SpotLight, dict[str, Any]]:
    sigma, mu = numbers([part["sigma"], part["mu"]])
    position = numbers(part["P"], 3)
    direction = numbers(part["D"], 3)
    if math.hypot(*position) > 0.05:  # m
        raise ValueError(f"P: expected a light at most 0.05 m off, found {position}")
    cos_psi = rays @ np.asarray(direction)
    # Up to 60° off the light's direction sheets are seen well, so the light is known.
    lit = cos_psi[cos_psi > math.cos(math.radians(60.0))]
    if abs(math.hypot(*direction) - 1) > 1e-3 or direction[2] <= 0 or lit.size < 2:
        raise ValueError(f"D: expected a unit vector to what is seen, found {direction}")
    exponent, weight, worst = cosine_power(mu, lit)
    place = tuple(1000 * value for value in position)
    made = SpotLight(place, direction, exponent, sigma * weight)  # type: ignore[arg-type]
    known = {"mu": mu, "sigma": sigma, "exponent": exponent}
    return made, known | {"worst_distance_percent": 100 * worst}


def read_photometry(path: PathLike, camera: Camera) -> tuple[Photometry, dict[str, Any]]:
    """Read the light and the response that EndoMapper's tool wrote; errors name the file.

    `<rig>` has `<camera><camera_model type="gamma">` (`gamma`, and `vignetting`, the exponent of
    cos α, if it was fitted) and one or more `<light><light_model type="sls">` (`sigma`, the strength;
    `mu`, the spread; `P`, the centre, m; `D`, the direction, a unit vector). The spread is matched at
    the pixels that the camera sees, up to 60° off D.

    The lights are in mm; one at the optical centre that looks along the axis becomes the exponent k.
    The gain changes from frame to frame and is unknown; the file says nothing of a surface, so that
    is a white Lambertian one. The evidence says what each light was, and how far the cosine power is
    from it at worst: the relative error of a distance, %.
    """
    document = read_document(path)
    field = camera.resize(160, max(1, round(camera.height * 160 / camera.width))).field
    rays = field.rays[field.valid & (field.cos_alpha > 0)]
    try:
        rig = document["rig"]
        model = rig["camera"]["camera_model"]
        found = rig["light"] if isinstance(rig["light"], list) else [rig["light"]]
        kinds = (model["type"], {light["light_model"]["type"] for light in found})
        if kinds != ("gamma", {"sls"}):
            raise ValueError(f"expected a camera_model gamma and an sls, found {kinds}")
        k, gamma = numbers([model.get("vignetting", 0.0), model["gamma"]])
        made = [_light(light["light_model"], rays) for light in found]
        evidence = {"gamma": gamma, "vignetting": k, "lights": [known for _, known in made]}
        lights = tuple(light for light, _ in made)
        axis = [((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))]
        if [(light.position, light.direction) for light in lights] == axis:
            k = k + lights[0].exponent
            lights = ()
        return Photometry(k=k, gamma=gamma, gain=None, lights=lights), evidence
    except KeyError as error:
        raise ValueError(f"{path}: {error.args[0]} is missing") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: {shorten(str(error), 400)}") from error


# Both ---------------------------------------------------------------------------------------
def read_endomapper(geometry: PathLike, photometry: PathLike) -> Calibration:
    """Join the two calibrations of an endoscope, see `read_camera` and `read_photometry`.

    The evidence names the two files and says how well the light could be expressed.
    """
    camera = read_camera(geometry)
    light, evidence = read_photometry(photometry, camera)
    names = {"geometry": Path(geometry).name, "photometry": Path(photometry).name}
    return Calibration(camera, light, {"converted": names | evidence})


def find_calibrations(folder: PathLike) -> tuple[Path, Path | None]:
    """Find `*_geometrical.xml` and, if it is there, `*_photometrical.xml` in a folder `Endoscope_XX`."""
    place = Path(folder)
    calibrations = []
    for kind in ("geometrical", "photometrical"):
        paths = sorted(place.glob(f"*_{kind}.xml"))
        if len(paths) > 1:
            raise ValueError(f"{place}: expected one *_{kind}.xml, found {len(paths)}")
        calibrations.append(paths[0] if paths else None)
    geometry, photometry = calibrations
    if geometry is None:
        raise FileNotFoundError(
            f"{place}: expected a file *_geometrical.xml, as EndoMapper's Endoscope_01 has"
        )
    return geometry, photometry
