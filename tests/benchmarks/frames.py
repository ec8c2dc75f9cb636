"""Frames whose truth is known, by the name of their set, how far a result is from it, and tables.

Sets are "scenes" of the model, "traced" ones that come with endolab, random ones, "open" and "sealed", which
are made if need be, published ones, and folders of frames with a description beside each.
"""

from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

import endolab as el
from endolab import datasets
from tests.research import random_frames
from tests.research.known_surface import measure_light
from tests.tools.cases import Case, drawn, traced

NOMINAL = el.Photometry(2.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))
# Where they lie, their numbers, on how many columns they are solved, degrees off the axis
# that are scored, and how many lamps beside the lens are sought.
PUBLISHED = {
    "c3vd": ("c3vd_trans_t1_a", (1, 6), 338, 55.0, 1),
    "simcol3d": ("simcol3d", range(5), 320, 90.0, 0),
}


def cases_of(wanted):
    """The frames of a set; none if its folder is not here."""
    folder = datasets.data_folder() or Path("nowhere")
    if wanted == "scenes":
        yield from map(drawn, el.SCENES)
    elif wanted == "traced":
        yield from map(traced, datasets.TRACED)
    elif wanted in random_frames.SETS:
        yield from map(traced, random_frames.frames(wanted))
    elif wanted.removesuffix("_nominal") in PUBLISHED:
        yield from _published(wanted, folder)
    else:
        yield from map(_described, sorted((folder / wanted).glob("*.json")))


def _described(path):
    """A rendered frame, beside its description, mask and truth."""
    known = el.load_calibration(path)
    mask = path.with_name(f"{path.stem}_mask.png")
    frame = el.read_frame(path.with_suffix(".png"), known, mask=mask)
    with np.load(path.with_name(f"{path.stem}_truth.npz")) as truth:
        maps = [truth[part].astype(float) for part in ("distance", "normals")]
    return Case(path.stem, frame, known, *maps)


def _published(wanted, folder):
    """Smaller frames, scaled by their median; the light of each is measured on the others, or nominal."""
    place, indices, width, field, lamps = PUBLISHED[wanted.removesuffix("_nominal")]
    samples = []
    if (folder / place).is_dir():
        samples = list(datasets.open_dataset(folder / place))
    for index, sample in zip(indices, samples, strict=False):
        light = NOMINAL
        if wanted in PUBLISHED:
            others = [other for other in samples if other is not sample]
            light, *_ = measure_light(
                [other.frame for other in others],
                sample.calibration.camera,
                [other.distance for other in others],
                lamps,
            )
        yield Case(
            f"{wanted} {index}",
            sample.frame,
            replace(sample.calibration, photometry=light),
            sample.distance,
            align="scale",
            max_angle=field,
        ).resize(width)


def table(title, heads, rows):
    """Print a table in Markdown, row by row as they come."""
    print(f"\n{title}\n")
    for line in chain([heads, ["---"] * len(heads)], rows):
        print(f"| {' | '.join(line)} |", flush=True)
