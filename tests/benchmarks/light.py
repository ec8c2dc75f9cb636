"""How well k is told by frames of an endoscope whose light is not known, and what it is worth.

    python -m tests.benchmarks.light [open | traced | c3vd | simcol3d | FOLDER]...

A row for each frame: the true k, what the frame alone tells, and the mean error of the distance, scaled by
its median, with the true k, with the one that was found, and with 2.5. Frames of one endoscope are then
asked together. Albedos are not told. No test: it takes minutes.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import compare
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.unknown_light import USUAL
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
    """Give the frames of a set, by its name, or of a folder of random frames."""
    folder = datasets.data_folder()
    if what == "traced":
        for name in datasets.TRACED:
            sample = el.load_traced(name)
            light = sample.calibration.photometry.simplified()
            yield Known(sample.frame, sample.calibration.camera, sample.distance, what, light.k, light.gamma)
    elif what in ("c3vd", "simcol3d"):
        for index in (1, 6) if what == "c3vd" else range(5):
            if what == "c3vd":
                sample = datasets.read_c3vd(folder / "c3vd_trans_t1_a", index)
            else:
                sample = datasets.read_simcol3d(folder / "simcol3d", index)
            frame, calibration, truth = at_width(sample, WIDTH)
            yield Known(frame, calibration.camera, truth, what, most=55.0 if what == "c3vd" else 90.0)
    else:
        where = FOLDER / what if what in SETS else Path(what)
        if what in SETS:
            make(SETS[what], where)
        for path in sorted(where.glob("*.npz")):
            one = read(path)
            light = one.calibration.photometry
            camera = one.calibration.camera
            whose = f"{what}, {camera.model}, k {light.k:.2f}"
            yield Known(one.frame, camera, one.distance, whose, light.k, light.gamma)


def error(one: Known, k: float) -> float:
    """Mean error of the distance with this k, %."""
    light = el.Photometry(k, one.gamma, None)
    result = el.reconstruct(one.frame, el.Calibration(one.camera, light), channel="separated")
    cosine = result.problem.field.cos_alpha
    near = np.nan_to_num(cosine, nan=-1.0) > np.cos(np.deg2rad(one.most))
    return compare(result.distance, one.distance, cosine, mask=near, scale="median").mean_percent


def row(name: str, frames: Sequence[Known], found: el.LightEstimate) -> tuple[list[str], list[float]]:
    """Say what frames of one endoscope tell, and what it is worth."""
    ks = [frames[0].k, found.photometry.k, USUAL]
    errors = [float(np.mean([error(one, k) for one in frames])) if np.isfinite(k) else np.nan for k in ks]
    told = f"{found.k:.2f} ± {found.standard_error:.2f}"
    cells = [name, _shown(ks[0], 2), told, found.outcome, *(_shown(one, 1) for one in errors)]
    return cells, [found.k - ks[0], *errors]


def _shown(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def main(arguments: Sequence[str]) -> None:
    """Print a table for each set: ``python -m tests.benchmarks.light open c3vd``."""
    heads = ["frames", "k", "told", "", "% with k", "with what was told", f"with {USUAL:g}"]
    for what in arguments or ["open"]:
        frames = list(of(what))
        rows, figures = [], []
        for one in frames:
            found = el.estimate_light([one.frame], one.camera, gamma=one.gamma)
            cells, numbers = row(one.frame.name, [one], found)
            rows.append(cells)
            figures.append(numbers)
            print("  ".join(cells), flush=True)
        off, *errors = np.array(figures).T
        means = [_shown(one.mean(), 1) for one in errors]
        rows.append(["mean", "", f"{_shown(off.mean(), 2)} ± {_shown(off.std(), 2)} off", "", *means])
        for name in dict.fromkeys(one.endoscope for one in frames):
            own = [one for one in frames if one.endoscope == name]
            if len(own) > 1:
                together = el.estimate_light([one.frame for one in own], own[0].camera, gamma=own[0].gamma)
                rows.append(row(f"{name}, together", own, together)[0])
        table(f"k of {what}, asked of the frames", heads, rows)


if __name__ == "__main__":
    main(sys.argv[1:])
