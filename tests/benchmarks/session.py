"""A calibration from rendered pictures, end to end: `python -m tests.benchmarks.session [FRAMES [SEEDS]]`.

Not a test: it asserts nothing and depends on the machine; 300 frames take some minutes a video.
"""

import sys
import time
from statistics import median

import numpy as np

from endolab import datasets
from endolab.calibration.detection.detect import Detection, detect
from endolab.calibration.geometric.projection import predict_view
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.session import calibrate
from endolab.calibration.simulation.sheet_image import Sensor, SheetFrame
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.targets import TARGETS, Target
from endolab.model.photometry import Photometry
from tests.benchmarks.report import table

CAMERA = datasets.load_calibration("paper").camera
TRUTH = Photometry(2.5, 2.2, None, PAPER_SHEET)
WRONG = 5.0  # px from where it should be: another dot's name; glints move some by less


def judge(frame: SheetFrame, target: Target, found: Detection) -> tuple[float, int]:
    """Share of the lit dots in view that were found, and the number of wrong names."""
    panel = target.panel_of(target.points)
    truth = np.full((len(target.points), 2), np.nan)
    for number, pose in enumerate(frame.poses):
        here = panel == number
        truth[here] = predict_view(
            CAMERA, pose, target.points[here], target.radii[here]
        )
    height, width = frame.image.shape
    inside = np.all((truth > 5) & (truth < [width - 6, height - 6]), axis=1)
    wrong = np.linalg.norm(found.pixels - truth[found.ids], axis=1) > WRONG
    return len(found.ids) / max(np.count_nonzero(inside), 1), int(wrong.sum())


def pulls_of(light: PhotometricFit) -> list[float]:
    """How far k, γ and the nodes of the BRDF are off, in their standard errors."""
    theta = np.array(light.photometry.brdf.theta)
    values = np.array(light.photometry.brdf.values)
    errors = np.array(
        [light.standard_errors[f"brdf {node}"] for node in range(len(theta))]
    )
    ratio = values / PAPER_SHEET.value(np.cos(theta), np.cos(theta))
    pinned = int(np.argmin(errors))
    free = np.arange(len(theta)) != pinned
    nodes = (ratio / ratio[pinned] - 1)[free] / (errors / values)[free]
    known = {"k": light.k - TRUTH.k, "gamma": light.photometry.gamma - TRUTH.gamma}
    scale = light.standard_errors
    return [
        off / scale[name] for name, off in known.items() if scale[name]
    ] + nodes.tolist()


def run(
    name: str, fold: float, count: int, seed: int, **options: object
) -> tuple[list[str], list[float]]:
    """Render, detect, calibrate; return a row of the table, and the pulls of the light."""
    target = TARGETS[name]
    stored = []
    detections = {}
    seconds = []
    gains = []
    shares = []
    wrong = 0
    seen = {"movement": Movement(fold), "sensor": Sensor(outliers=0.001)}
    video = simulate_video(target, CAMERA, TRUTH, count, seed=seed, **seen)
    for number, frame in enumerate(video):
        label = f"{number:04d}"
        stored.append((label, frame.image.astype(np.float32)))
        started = time.perf_counter()
        detections[label] = detect(frame.image, target)
        seconds.append(time.perf_counter() - started)
        gains.append(frame.gain)
        share, bad = judge(frame, target, detections[label])
        shares.append(share)
        wrong += bad
    size = CAMERA.width, CAMERA.height
    session = calibrate(stored, target, detections=detections, size=size, **options)
    light = session.light
    geometry = session.geometry
    assert light is not None, session.refused
    assert geometry is not None
    camera = geometry.camera
    worst = max(
        abs(getattr(camera, x) - getattr(CAMERA, x)) for x in ("fx", "fy", "cx", "cy")
    )
    angle = np.linspace(0, np.deg2rad(68), 100)
    rays = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    drift = np.linalg.norm(camera.project(rays) - CAMERA.project(rays), axis=1).max()
    theta = np.linspace(0, np.deg2rad(70), 71)
    known = PAPER_SHEET.value(np.cos(theta), np.cos(theta))
    shape = light.photometry.brdf.value(np.cos(theta), np.cos(theta)) / known
    true = np.array(gains)[[int(list(session.poses)[frame]) for frame in light.frames]]
    ratio = light.gains / true * np.mean(shape)
    row = [
        name,
        f"{sum(share > 0 for share in shares)}/{count}",
        f"{np.median(shares):.3f}",
        str(wrong),
    ]
    row.append(f"{1e3 * median(seconds):.0f}")
    row += [f"{geometry.rmse:.3f}", f"{worst:.3f}", f"{drift:.3f}"]
    row.append(f"{light.k - 2.5:+.4f} ± {light.standard_errors['k']:.4f}")
    row.append(
        f"{light.photometry.gamma - 2.2:+.4f} ± {light.standard_errors['gamma']:.4f}"
    )
    row += [
        f"{light.ratio - 2.5 / 2.2:+.4f}",
        f"{100 * np.std(shape / np.mean(shape)):.2f}",
    ]
    return [*row, f"{100 * np.std(np.log(ratio)):.2f}", f"{light.sigma:.2f}"], pulls_of(
        light
    )


def main(arguments: list[str]) -> None:
    """Print the table."""
    count, seeds = (
        int(value) for value in (*arguments, *("300", "1")[len(arguments) :])
    )
    rows = []
    pulls: dict[str, list[float]] = {}
    for seed in range(seeds):
        for name, fold, gamma in (
            ("vicalib_small", 0.0, 2.2),
            ("vicalib_folded", np.deg2rad(20), "free"),
        ):
            row, off = run(name, fold, count, seed, gamma=gamma)
            rows.append(row)
            pulls.setdefault(name, []).extend(np.abs(off))
    heads = [
        "target",
        "frames found",
        "dots found",
        "wrong names",
        "ms to detect",
        "RMSE px",
        "f, c px",
    ]
    heads += [
        "map to 68° px",
        "Δk",
        "Δγ",
        "Δ(k/γ)",
        "BRDF % rms",
        "gain % sd",
        "σ grey",
    ]
    table(
        f"From {count} rendered pictures of 1440x1080, noise 3 grey levels", heads, rows
    )

    shares = []
    for name, off in pulls.items():
        within = (f"{100 * np.mean(np.array(off) < limit):.0f} %" for limit in (1, 2))
        shares.append([name, str(len(off)), *within])
    table(
        "Truths of k, γ and nodes within their errors",
        ["target", "numbers", "1 σ", "2 σ"],
        shares,
    )


if __name__ == "__main__":
    main(sys.argv[1:])
