"""Frames whose truth is known, by the name of their set: path-traced, published, and random ones."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import endolab as el
from endolab import datasets
from endolab.io.datasets.sample import Sample
from endolab.metrics.depth_errors import Errors, compare, resample_truth
from endolab.numerics.arrays import BoolArray, FloatArray
from tests.benchmarks.known_surface import measure_light
from tests.tools.random_frames import SETS, make, read

FOLDER = Path(__file__).resolve().parents[2] / "build" / "unseen"
NOMINAL = el.Photometry(2.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))


@dataclass(frozen=True)
class Published:
    """Frames of others: where they lie, on how many columns they are solved, and what of them is scored."""

    folder: str
    read: Callable[[Path, int], Sample]
    indices: Sequence[int]
    width: int
    field: float = 90.0  # degrees off the axis


# C3VD's fisheye is not well known farther off its axis.
SIMCOL = Published("simcol3d", datasets.read_simcol3d, range(5), 320)
PUBLISHED = {
    "c3vd": Published("c3vd_trans_t1_a", datasets.read_c3vd, (1, 6), 338, 55.0),
    "simcol3d": SIMCOL,
    "simcol3d_nominal": SIMCOL,
}


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
    indirect_ratio: FloatArray | None = (
        None  # (H, W, 3), what is not direct over direct light, if known
    )

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

    def resize(self, width: int) -> "Case":
        """The same frame on fewer pixels, of this width at most."""
        if self.frame.width <= width:
            return self
        height = round(self.frame.height * width / self.frame.width)
        normals = self.normals
        if normals is not None:
            with np.errstate(invalid="ignore"):
                normals = resample_truth(normals, (height, width))
        return replace(
            self,
            frame=self.frame.resize(width, height, self.calibration.photometry.gamma),
            calibration=self.calibration.resize(width, height),
            distance=resample_truth(self.distance, (height, width)),
            normals=normals,
        )

    def with_light(self, photometry: el.Photometry) -> "Case":
        """The same frame, of whose light something else is known."""
        return replace(
            self, calibration=replace(self.calibration, photometry=photometry)
        )


def cases_of(wanted: str) -> Iterator[Case]:
    """The frames of a set; none if its folder is not here. Random ones are made if need be."""
    folder = datasets.data_folder() or Path("nowhere")
    if wanted == "scenes":
        yield from _scenes()
    elif wanted == "traced":
        for name in datasets.TRACED:
            yield _exact(name, el.load_traced(name))
    elif wanted in SETS:
        make(SETS[wanted], FOLDER / wanted)
        for path in sorted((FOLDER / wanted).glob("*.npz")):
            drawn = read(path)
            yield replace(_exact(drawn.frame.name, drawn), kind=drawn.kind)
    elif wanted in PUBLISHED:
        yield from _published(wanted, folder)
    else:
        for path in sorted((folder / wanted).glob("*.json")):
            yield _described(path)


def _scenes() -> Iterator[Case]:
    """What the model itself makes of the four scenes."""
    known = datasets.load_calibration("simple")
    for name, scene in el.SCENES.items():
        made = el.render(scene, known.camera, known.photometry)
        lit = el.Calibration(made.camera, made.photometry)
        frame = el.Frame(made.image, made.mask, name)
        yield Case(name, "", frame, lit, made.distance, made.normals)


def _exact(name: str, sample: Any) -> Case:
    """A path-traced frame, at true scale."""
    others = sample.indirect + sample.mirrored[..., None]
    ratio = others / np.maximum(sample.direct, 0.05 * others + 1e-9)
    return Case(
        name,
        "",
        sample.frame,
        sample.calibration,
        sample.distance,
        sample.normals,
        indirect_ratio=np.nan_to_num(ratio),
    )


def _described(path: Path) -> Case:
    """A rendered frame, beside its description, mask and truth."""
    known = el.load_calibration(path)
    mask = path.with_name(f"{path.stem}_mask.png")
    frame = el.read_frame(path.with_suffix(".png"), known, mask=mask)
    with np.load(path.with_name(f"{path.stem}_truth.npz")) as truth:
        distance, normals = (
            truth[part].astype(float) for part in ("distance", "normals")
        )
    return Case(path.stem, "", frame, known, distance, normals)


def _published(wanted: str, folder: Path) -> Iterator[Case]:
    """Smaller frames, scaled by their median; the light of each is measured on the others, or nominal."""
    data = PUBLISHED[wanted]
    samples = []
    if (folder / data.folder).is_dir():
        samples = [data.read(folder / data.folder, index) for index in data.indices]
    for index, sample in zip(data.indices, samples, strict=False):
        light = NOMINAL
        if wanted != "simcol3d_nominal":
            others = [other for other in samples if other is not sample]
            frames = [other.frame for other in others]
            distances = [other.distance for other in others]
            camera = sample.calibration.camera
            light, *_ = measure_light(frames, camera, distances)
        case = Case(
            f"{wanted} {index}",
            "",
            sample.frame,
            replace(sample.calibration, photometry=light),
            sample.distance,
            scale="median",
            max_angle=data.field,
        )
        yield case.resize(data.width)
