"""The photometric calibration as tables: `python -m tests.benchmarks.calibration [SEEDS [TABLE]...]`.

Not a test: it asserts nothing and depends on the machine. Each row is measured on so many simulated
videos (20). With OPENBLAS_NUM_THREADS=1 it runs alike on a busy machine.
"""

import sys

import numpy as np

from endolab import datasets
from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.identifiability import NotIdentifiableError
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from endolab.calibration.targets import TARGETS
from endolab.model.photometry import Photometry
from tests.benchmarks.report import seconds_of, table
from tests.tools.shooting import shooting

TRUE = {"k": 2.5, "gamma": 2.2, "k/gamma": 2.5 / 2.2}
CAMERA = datasets.load_calibration("paper").camera
TRUTH = Photometry(TRUE["k"], TRUE["gamma"], 1.0, PAPER_SHEET)
PATCHES = {"exact": 0.5, "± 2 %": (0.5, 0.01), "2 % too light": 0.51, "unknown": None}


def take(target, seed, count=300, **how):
    """Samples of a video and its gains."""
    return simulate_samples(
        TARGETS[target], CAMERA, TRUTH, count, seed=seed, **shooting(**how)
    )


def sheen(fit):
    """Relative rms error of the BRDF over the sampled angles, %, scale apart."""
    cosine = np.cos(np.linspace(*fit.theta_range, 400))
    ratio = fit.photometry.brdf.value(cosine, cosine) / PAPER_SHEET.value(cosine, cosine)
    return 100 * float(np.std(ratio / ratio.mean()))


def spread(errors):
    """Mean ± sd of errors, and the largest."""
    return f"{np.mean(errors):+.4f} ± {np.std(errors):.4f}, {np.abs(errors).max():.4f}"


def folded(degrees):
    """A folded sheet whose γ is sought: its target, how to simulate and how to fit it."""
    return "vicalib_folded", {"fold": np.deg2rad(degrees)}, {"gamma": "free"}


def ways(seeds):
    """What simulated videos give back, by the ways to γ; and what a wrong γ does."""
    free = {"gamma": "free"}
    setups = [
        ("flat, γ given", "vicalib_big", {}, {}),
        ("flat, γ given as 2.0", "vicalib_big", {}, {"gamma": 2.0}),
        ("flat, γ 2.2 ± 0.1 given", "vicalib_big", {}, {"gamma": (2.2, 0.1)}),
        ("flat, γ free", "vicalib_big", {}, free),
        *((f"folded {angle}°", *folded(angle)) for angle in (1, 3, 10, 30)),
        *(
            (f"grey patches, {label}", "vicalib_grey", {}, free | {"reflectance": (known,)})
            for label, known in PATCHES.items()
        ),
        ("gain locked", "vicalib_big", {"locked": True}, free | {"gain": "locked"}),
    ]
    rows = []
    for name, target, how, options in setups:
        fits = []
        scales = []
        for seed in range(seeds):
            samples, gains = take(target, seed, **how)
            try:
                fits.append(calibrate_light(samples, **options))
            except NotIdentifiableError:
                continue
            scales.append(100 * np.std(np.log(fits[-1].gains / gains[fits[-1].frames])))
        row = [name, f"{seeds - len(fits)} of {seeds}"]
        if fits:
            found = np.array([(f.k, f.photometry.gamma, f.ratio) for f in fits]) - list(
                TRUE.values()
            )
            errors = np.array([[f.standard_errors[name] for name in TRUE] for f in fits])
            row += [spread(off) for off in found.T]
            row += [f"{errors[:, 0].mean():.4f}, {errors[:, 1].mean():.4f}"]
            row += [f"{np.sqrt(np.mean((found[:, 0] / errors[:, 0]) ** 2)):.2f}"]
            row += [f"{np.mean([sheen(f) for f in fits]):.2f}", f"{np.mean(scales):.2f}"]
            row += [f"{np.mean([f.sigma for f in fits]):.4f}"]
        rows.append(row + [""] * (10 - len(row)))
    heads = [
        "set-up",
        "refused",
        "Δk: mean ± sd, max",
        "Δγ",
        "Δ(k/γ)",
        "stated s.e. of k, γ",
        "pull of k",
    ]
    table("Ways to γ", [*heads, "BRDF rms %", "gain rms %", "σ grey"], rows)


def speed(_):
    """Seconds of a fit against the number of frames."""
    rows = []
    for name, target, how, options in (
        ("flat, γ given", "vicalib_big", {}, {}),
        ("folded 30°", *folded(30)),
    ):
        for count in (75, 300, 1200):
            samples, _ = take(target, 0, count, **how)
            seconds = seconds_of(
                lambda given=samples, how=options: calibrate_light(given, **how), 7
            )
            steps = []
            calibrate_light(samples, **options, observers=[steps.append])
            numbers = [str(number) for number in (count, len(samples), steps[-1].k)]
            rows.append([name, *numbers[:2], f"{1e3 * seconds:.0f}", numbers[2]])
    table("Speed", ("set-up", "frames", "samples", "ms, median of 7", "steps"), rows)


TABLES = {one.__name__: one for one in (ways, speed)}


if __name__ == "__main__":
    for name in sys.argv[2:] or TABLES:
        TABLES[name](int(sys.argv[1]) if len(sys.argv) > 1 else 20)
