"""Frames whose truth is known, by the name of their set: path-traced, published, and random ones."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import endolab as el
from endolab import datasets
from endolab.io.datasets.sample import Sample
from endolab.metrics.depth_errors import Errors, compare, resample_truth
from endolab.numerics.arrays import BoolArray, FloatArray
from tests.tools.random_frames import SETS, make, read

FOLDER = Path(__file__).resolve().parents[2] / "build" / "unseen"
TISSUE = el.Lambertian((0.75, 0.38, 0.30))
C3VD_FIELD = 55.0  # degrees off the axis, beyond which its fisheye is not judged


@dataclass(frozen=True)
class Case:
    """A frame, what is known of its endoscope, and its truth."""

    name: str
    kind: str
    frame: el.Frame
    calibration: el.Calibration
    distance: FloatArray
    normals: FloatArray | None = None
    scale: str = "none"  # "median" where the gain is unknown
    max_angle: float = 90.0  # degrees from the axis that are scored

    @property
    def scored(self) -> BoolArray:
        """Pixels that are scored."""
        cosine = np.nan_to_num(self.calibration.camera.field.cos_alpha, nan=-1.0)
        return cosine > np.cos(np.deg2rad(self.max_angle))

    def errors_of(self, result: el.Result) -> Errors:
        """How far a result is from the truth."""
        return compare(
            result.distance,
            self.distance,
            result.problem.field.cos_alpha,
            normals=result.normals,
            true_normals=self.normals,
            mask=self.scored,
            scale=self.scale,
        )

    def with_light(self, photometry: el.Photometry) -> "Case":
        """The same frame, of whose light something else is known."""
        return replace(
            self, calibration=replace(self.calibration, photometry=photometry)
        )


def cases_of(wanted: str) -> Iterator[Case]:
    """The frames of "traced", "c3vd", "simcol3d", or of a set of random ones, which is made if need be."""
    folder = datasets.data_folder()
    if wanted == "traced":
        for name in datasets.TRACED:
            yield _exact(name, el.load_traced(name))
    elif wanted == "c3vd":
        for index in (1, 6):
            sample = datasets.read_c3vd(folder / "c3vd_trans_t1_a", index)
            case = _published(f"c3vd {index}", sample, 338)
            yield replace(case, max_angle=C3VD_FIELD)
    elif wanted == "simcol3d":
        for index in range(5):
            sample = datasets.read_simcol3d(folder / "simcol3d", index)
            yield _published(f"simcol {index}", sample, 320)
    else:
        make(SETS[wanted], FOLDER / wanted)
        for path in sorted((FOLDER / wanted).glob("*.npz")):
            drawn = read(path)
            yield replace(_exact(drawn.frame.name, drawn), kind=drawn.kind)


def _exact(name: str, sample: Any) -> Case:
    """A path-traced frame, at true scale."""
    return Case(
        name, "", sample.frame, sample.calibration, sample.distance, sample.normals
    )


def _published(name: str, sample: Sample, width: int) -> Case:
    """A smaller frame, scaled by its median, with the albedos of tissue."""
    height = round(sample.frame.height * width / sample.frame.width)
    frame = sample.frame.resize(width, height, 2.2)
    known = sample.calibration.resize(width, height)
    known = replace(known, photometry=replace(known.photometry, brdf=TISSUE))
    truth = resample_truth(sample.distance, (height, width))
    return Case(name, "", frame, known, truth, scale="median")
