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

import math
from pathlib import Path
from typing import Any

import numpy as np

from endolab.io.atomic import PathLike, name_damage
from endolab.io.cameras.documents import read_document
from endolab.io.cameras.formats import read_camera
from endolab.io.cameras.readers import numbers
from endolab.model.endoscope import Calibration
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry


def cosine_power(mu: float) -> tuple[float, float]:
    """Find the cosine power nearest to the spread function of EndoMapper's spot light.

    There the light falls as exp(-μ (1 - cos ψ)), here as w cosⁿψ, which fall alike near the axis and
    apart from about 45° off it on: by 5 % of a distance at 60° with μ = 2.8. Returned are n and w of
    least squares in the logarithm up to 60°, where sheets are seen well.
    """
    cos_psi = np.linspace(0.5, 1, 200)  # of equal solid angles
    exponent, offset = np.polyfit(np.log(cos_psi), -mu * (1 - cos_psi), 1).tolist()
    return exponent, math.exp(offset)


def read_endomapper(geometry: PathLike, photometry: PathLike) -> Calibration:
    """Join the two calibrations of an endoscope, its camera's and its light's.

    The lights are in mm; one at the optical centre that looks along the axis becomes the exponent k.
    The gain changes from frame to frame and is unknown; the file says nothing of a surface, so that
    is a white Lambertian one. The evidence names the two files. OSError or ValueError in one sentence, if a
    file cannot be read.
    """
    camera = read_camera(geometry)
    document = read_document(photometry)
    with name_damage(photometry, "a gamma and lights sls of EndoMapper's tool"):
        rig = document["rig"]
        model = rig["camera"]["camera_model"]
        k, gamma = numbers([model.get("vignetting", 0.0), model["gamma"]])
        lights = []
        for found in rig["light"] if isinstance(rig["light"], list) else [rig["light"]]:
            light = found["light_model"]
            sigma, mu = numbers([light["sigma"], light["mu"]])
            exponent, weight = cosine_power(mu)
            position: Any = 1000 * np.array(numbers(light["P"], 3))
            direction: Any = numbers(light["D"], 3)
            lights.append(SpotLight(position, direction, exponent, sigma * weight))
        if [(one.position, one.direction) for one in lights] == [((0, 0, 0), (0, 0, 1))]:
            k += lights.pop().exponent
        made = Photometry(k=k, gamma=gamma, lights=tuple(lights))
    files = {"geometry": Path(geometry).name, "photometry": Path(photometry).name}
    return Calibration(camera, made, {"converted": files})


def find_calibrations(folder: PathLike) -> list[Path]:
    """Find `*_geometrical.xml` and `*_photometrical.xml` in a folder `Endoscope_XX`."""
    found = sorted(Path(folder).glob("*_*metrical.xml"))
    if len(found) != 2:
        text = (
            "expected one *_geometrical.xml and one *_photometrical.xml, as of EndoMapper"
        )
        raise FileNotFoundError(f"{folder}: {text}")
    return found
