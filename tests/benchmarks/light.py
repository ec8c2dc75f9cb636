"""How well k is told by frames of an endoscope whose light is not known, and what it is worth.

    python -m tests.benchmarks.light [open | sealed | traced | c3vd]...

A row for each frame: the true k, what the frame alone tells, and the mean error of the distance, scaled by
its median, with the true k, with the one that was found, and with 2.5. Frames of one endoscope are then
asked together. Albedos are not told. No test: it takes minutes.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import compare
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.light.unknown_light import EXPONENT_SEARCH
from tests.benchmarks.colon import at_width
from tests.benchmarks.report import table
from tests.benchmarks.unseen import FOLDER
from tests.tools.random_frames import SETS, make, read

WIDTH = 338  # px, of published frames


@dataclass(frozen=True)
class Known:
    """A frame, its camera and truth, and whose endoscope took it; k is nan if that is not known."""

    frame: el.Frame
    camera: Camera
    distance: FloatArray
    endoscope: str
    k: float = np.nan
    gamma: float = 2.2
    most: float = 90.0  # degrees from the axis that are scored


def of(what: str) -> Iterator[Known]:
    """Give the frames of a set, by its name."""
    if what == "traced":
        for name in datasets.TRACED:
            sample = el.load_traced(name)
            light = sample.calibration.photometry.simplify()
            yield Known(
                sample.frame,
                sample.calibration.camera,
                sample.distance,
                what,
                light.k,
                light.gamma,
            )
    elif what == "c3vd":
        for index in (1, 6):
            sample = datasets.read_c3vd(datasets.data_folder() / "c3vd_trans_t1_a", index)
            frame, calibration, truth = at_width(sample, WIDTH)
            yield Known(frame, calibration.camera, truth, what, most=55.0)
    else:
        make(SETS[what], FOLDER / what)
        for path in sorted((FOLDER / what).glob("*.npz")):
            one = read(path)
            camera = one.calibration.camera
            light = one.calibration.photometry
            whose = f"{what}, {camera.model}, k {light.k:.2f}"
            yield Known(one.frame, camera, one.distance, whose, light.k, light.gamma)


def error(one: Known, k: float) -> float:
    """Mean error of the distance with this k, %."""
    light = el.Photometry(k, one.gamma, None)
    result = el.reconstruct(
        one.frame, el.Calibration(one.camera, light), channel="separated"
    )
    cosine = result.problem.field.cos_alpha
    near = np.nan_to_num(cosine, nan=-1.0) > np.cos(np.deg2rad(one.most))
    return compare(
        result.distance, one.distance, cosine, mask=near, scale="median"
    ).mean_percent


def row(name: str, frames: Sequence[Known]) -> tuple[list[str], list[float]]:
    """Say what frames of one endoscope tell, and what it is worth."""
    one = frames[0]
    found = el.estimate_light([each.frame for each in frames], one.camera, gamma=one.gamma)
    ks = [one.k, found.photometry.k, EXPONENT_SEARCH.usual]
    errors = [
        float(np.mean([error(each, k) for each in frames])) if np.isfinite(k) else np.nan
        for k in ks
    ]
    estimate = f"{found.k:.2f} ± {found.standard_error:.2f}"
    cells = [
        name,
        f"{one.k:.2f}",
        estimate,
        found.outcome,
        *(f"{each:.1f}" for each in errors),
    ]
    print("  ".join(cells), flush=True)
    return cells, [found.k - one.k, *errors]


def main(arguments: Sequence[str]) -> None:
    """Print a table for each set: ``python -m tests.benchmarks.light open c3vd``."""
    heads = [
        "frames",
        "k",
        "told",
        "",
        "% with k",
        "with what was told",
        f"with {EXPONENT_SEARCH.usual:g}",
    ]
    for what in arguments or ["open"]:
        frames = list(of(what))
        rows, figures = zip(*(row(one.frame.name, [one]) for one in frames), strict=True)
        off, *errors = np.array(figures).T
        mean = [
            "mean",
            "",
            f"{off.mean():.2f} ± {off.std():.2f} off",
            "",
            *(f"{e.mean():.1f}" for e in errors),
        ]
        together = []
        for name in dict.fromkeys(one.endoscope for one in frames):
            own = [one for one in frames if one.endoscope == name]
            if len(own) > 1:
                together.append(row(f"{name}, together", own)[0])
        table(f"k of {what}, asked of the frames", heads, [*rows, mean, *together])


if __name__ == "__main__":
    main(sys.argv[1:])
