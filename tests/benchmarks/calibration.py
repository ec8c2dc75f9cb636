"""The photometric calibration as tables: `python -m tests.benchmarks.calibration [--seeds N] [recovery]...`.

Not a test: it asserts nothing and depends on the machine. `--seeds N` before the names sets how
many simulated videos each row is measured on (20). With OPENBLAS_NUM_THREADS=1 it runs alike on
a busy machine.
"""

import sys
from dataclasses import dataclass, field

import numpy as np

from endolab import datasets
from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.identifiability import NotIdentifiableError
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples, sample_depth
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from endolab.calibration.targets import TARGETS
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from tests.benchmarks.report import seconds_of, table

K, GAMMA = 2.5, 2.2
CAMERA = datasets.load_calibration("paper").camera
TRUTH = Photometry(K, GAMMA, 1.0, PAPER_SHEET)
EDGES = np.deg2rad([0, 5, 15, 25, 35, 45, 55, 65])  # of held-out errors
SEEDS = 20
PATCHES = {"exact": 0.5, "± 2 %": (0.5, 0.01), "2 % too light": 0.51, "unknown": None}
PHANTOM_LEVELS = (45 / 255, 210 / 255)  # its texture is ± 13 grey levels


@dataclass
class Outcomes:
    """What the fits of one set-up came to, an entry each."""

    fits: list = field(default_factory=list)
    gains: list = field(default_factory=list)  # the true ones
    held_out: list = field(default_factory=list)
    refused: list = field(default_factory=list)

    def of(self, name):
        """Error of k, gamma or k/gamma."""
        found = [(f.k, f.photometry.gamma, f.ratio) for f in self.fits]
        true = np.array([K, GAMMA, K / GAMMA])
        return (np.array(found).reshape(-1, 3) - true)[:, ["k", "gamma", "k/gamma"].index(name)]

    def pulls(self, name: str) -> np.ndarray:
        """Errors in standard errors."""
        return self.of(name) / [f.standard_errors[name] for f in self.fits]


def take(target, seed, count=300, light=TRUTH, **how):
    """Samples of a video and its gains."""
    return simulate_samples(TARGETS[target], CAMERA, light, count, seed=seed, **how)


def sheen(fit: PhotometricFit) -> tuple[float, np.ndarray]:
    """Relative rms error of the BRDF over the sampled angles, %, scale apart; pulls of its nodes."""
    theta = np.linspace(*fit.theta_range, 400)
    ratio = fit.photometry.brdf.value(np.cos(theta), 1.0) / PAPER_SHEET.value(np.cos(theta), np.cos(theta))
    nodes = np.cos(fit.photometry.brdf.theta)
    values = np.array(fit.photometry.brdf.values)
    errors = np.array([fit.standard_errors[f"brdf {j}"] for j in range(len(values))])
    true = PAPER_SHEET.value(nodes, nodes)
    true = true * (values / true)[errors == 0]
    return 100 * float(np.std(ratio / ratio.mean())), ((values - true)[errors > 0] / errors[errors > 0])


def gain_errors(fit: PhotometricFit, true: np.ndarray) -> np.ndarray:
    """Relative errors of the gains in the fit's gauge."""
    values = np.array(fit.photometry.brdf.values)
    pinned = next(j for j in range(len(values)) if fit.standard_errors[f"brdf {j}"] == 0)
    cosine = np.cos(fit.photometry.brdf.theta[pinned])
    return fit.gains / (true[fit.frames] * PAPER_SHEET.value(cosine, cosine) / values[pinned]) - 1


def repeat(target, how, fit, score=False, count=300):
    """Fit a set-up on many simulated videos."""
    out = Outcomes()
    for seed in range(SEEDS):
        samples, gains = take(target, seed, count, **how)
        try:
            found = calibrate_light(samples, **fit)
        except NotIdentifiableError as error:
            out.refused.append(error.unknown)
            continue
        out.fits.append(found)
        out.gains.append(gains)
        if score:
            out.held_out.append(found.held_out(take(target, 1000 + seed, 300, **how)[0], EDGES).error)
    return out


def spread(errors: np.ndarray, digits: int = 4) -> str:
    """Mean ± sd of errors, and the largest."""
    return f"{errors.mean():+.{digits}f} ± {errors.std():.{digits}f}, {np.abs(errors).max():.{digits}f}"


def folded(degrees):
    """A folded sheet whose γ is sought: its target, how to simulate and how to fit it."""
    return "vicalib_folded", {"fold": np.deg2rad(degrees)}, {"gamma": "free"}


def grey(reflectance):
    """The sheet with grey patches of that reflectance, γ sought: its target, and how to fit it."""
    return "vicalib_grey", {}, {"gamma": "free", "reflectance": (reflectance,)}


def recovery() -> None:
    """What the simulated video gives back: the two set-ups in full."""
    rows, curves = [], []
    for name, target, how, options in (
        ("flat, γ given", "vicalib_big", {}, {}),
        ("folded 10°, γ free", *folded(10)),
        ("folded 30°, γ free", *folded(30)),
        ("folded 30°, γ given", *folded(30)[:2], {}),
    ):
        out = repeat(target, how, options, score=True)
        rms, nodes = zip(*map(sheen, out.fits), strict=True)
        gain = [gain_errors(fit, gains) for fit, gains in zip(out.fits, out.gains, strict=True)]
        pulls = [error / (f.gain_errors / f.gains) for error, f in zip(gain, out.fits, strict=True)]
        spreads, free = [100 * np.std(g) for g in gain], "gamma" in options
        rows.append(
            [
                name,
                spread(out.of("k")),
                spread(out.of("gamma")) if free else "",
                spread(out.of("k/gamma"), 5),
                f"{np.mean(rms):.3f}, {max(rms):.3f}",
                f"{np.mean(spreads):.2f}, {max(spreads):.2f}",
                f"{np.mean([f.sigma for f in out.fits]):.4f}, {max(abs(f.mean) for f in out.fits):.4f}",
                f"{np.std(out.pulls('k')):.2f}",
                f"{np.std(out.pulls('gamma')):.2f}" if free else "",
                f"{np.sqrt(np.mean(np.concatenate(nodes) ** 2)):.2f}",
                f"{np.std(np.concatenate(pulls)):.2f}",
            ]
        )
        errors = 100 * np.array(out.held_out)
        curves.append([name, *(f"{np.nanmean(np.abs(e)):.2f}, {np.nanmax(np.abs(e)):.2f}" for e in errors.T)])
    heads = ["set-up", "Δk: mean ± sd, max", "Δγ", "Δ(k/γ)", "BRDF rms %: mean, max", "gain rms %"]
    heads += ["σ, max |mean|", "pull k", "γ", "BRDF", "gain"]
    truth = f"k {K}, γ {GAMMA}, noise 3 grey + rounding = {np.hypot(3, 12**-0.5):.4f}, 1.5 % outliers"
    table(f"Recovery: {SEEDS} videos of 300 frames x 100 samples; {truth}", heads, rows)
    angles = zip(*np.rad2deg([EDGES[:-1], EDGES[1:]]), strict=True)
    heads = ["set-up", *(f"{a:.0f}–{b:.0f}°" for a, b in angles)]
    table("Held-out error of μ′ in %: mean |·|, max |·|, against α (300 other frames)", heads, curves)


def ways() -> None:
    """Ways to γ, and what a wrong γ does."""
    setups = [
        ("flat, γ given as 2.0", "vicalib_big", {}, {"gamma": 2.0}),
        ("flat, γ 2.2 ± 0.1 given", "vicalib_big", {}, {"gamma": (2.2, 0.1)}),
        ("flat, γ free", "vicalib_big", {}, {"gamma": "free"}),
        *((f"folded {angle}°", *folded(angle)) for angle in (1, 3, 5, 10, 30)),
        *((f"grey patches, {said}", *grey(known)) for said, known in PATCHES.items()),
        ("gain locked", "vicalib_big", {"locked": True}, {"gamma": "free", "gain": "locked"}),
    ]
    rows = []
    for name, target, how, options in setups:
        out = repeat(target, how, options)
        row = [name, f"{len(out.refused)} of {SEEDS}"]
        if out.fits:
            shape = [sheen(fit)[0] for fit in out.fits]
            errors = [np.mean([f.standard_errors[n] for f in out.fits]) for n in ("k", "gamma")]
            row += [spread(out.of("k")), spread(out.of("gamma")), spread(out.of("k/gamma"))]
            row += [f"{errors[0]:.4f}, {errors[1]:.4f}", f"{np.mean(shape):.2f}, {max(shape):.2f}"]
        rows.append(row + [""] * (7 - len(row)))
    heads = ("set-up", "refused", "Δk: mean ± sd, max", "Δγ", "Δ(k/γ)", "stated s.e. of k, γ", "BRDF rms %")
    table("Ways to γ", heads, rows)


def lambertian() -> None:
    """Bias of a fit that takes the paper to be matt, by the tilt of the sheet."""
    rows = []
    for tilt in (5, 20, 45, 55):
        row = [f"≤ {tilt}°"]
        for options in ({}, {"brdf": "lambertian"}, {"brdf": "lambertian", "gamma": "free"}):
            out = repeat("vicalib_big", {"tilt": np.deg2rad(tilt)}, options)
            found = f"k {np.mean(out.of('k')) + K:.4f} ± {np.std(out.of('k')):.4f}"
            if "gamma" in options:
                found += f", γ {np.mean(out.of('gamma')) + GAMMA:.4f} ± {np.std(out.of('gamma')):.4f}"
            row.append(f"{found}, σ {np.mean([f.sigma for f in out.fits]):.2f}")
        rows.append(row)
    heads = ("tilt", "tabulated, γ given", "Lambertian, γ given", "Lambertian, γ free")
    table(f"Lambertian bias (truth k {K}, γ {GAMMA}, a sheen of 28 %)", heads, rows)


def frames() -> None:
    """Error of k against the number of frames."""
    rows = []
    for count in (2, 5, 10, 50, 100, 300):
        out = repeat("vicalib_big", {}, {}, count=count)
        stated = np.mean([f.standard_errors["k"] for f in out.fits]) if out.fits else np.nan
        row = [str(count), f"{len(out.refused)} of {SEEDS}", spread(out.of("k")) if out.fits else ""]
        rows.append([*row, f"{stated:.4f}", f"{np.std(out.pulls('k')):.2f}" if out.fits else ""])
    heads = ("frames", "refused", "Δk", "stated s.e.", "pull")
    table("k, γ given, against the number of frames", heads, rows)


def lights() -> None:
    """Three real lights beside the camera, fitted by one virtual light, centred or not."""
    real = [
        SpotLight((3.5 * np.cos(angle) + 0.6, 3.5 * np.sin(angle), 0.0), (0.0, 0.0, 1.0), 1.0)
        for angle in np.deg2rad([90, 210, 330])
    ]
    truth = Photometry(1.5, GAMMA, 1.0, PAPER_SHEET, tuple(real))
    rows = []
    for light in ("centred", "free"):
        fits = repeat("vicalib_big", {"light": truth}, {"light": light}).fits
        place = [f.photometry.lights[0].position for f in fits if f.photometry.lights]
        where = ", ".join(f"{v:.2f}" for v in np.mean(place, axis=0)) if place else ""
        k, sigma = [f.k for f in fits], np.mean([f.sigma for f in fits])
        rows.append([light, f"{np.mean(k):.4f} ± {np.std(k):.4f}", f"{sigma:.3f}", where])
    heads = ("virtual light", "k", "σ", "at mm")
    table("Three lights 3.5 mm around (0.6, 0, 0) mm, 1.5 + 1 exponents", heads, rows)


def speed() -> None:
    """Seconds of a fit against the number of frames."""
    rows = []
    setups = ("flat, γ given", "vicalib_big", {}, {}), ("folded 30°, γ free", *folded(30))
    for name, target, how, options in setups:
        for count in (75, 150, 300, 600, 1200):
            samples, _ = take(target, 0, count, **how)
            seconds = seconds_of(lambda given=samples, how=options: calibrate_light(given, **how), 7)
            steps = str(calibrate_light(samples, **options).history[-1]["k"])
            rows.append([name, str(count), str(len(samples)), f"{1e3 * seconds:.0f}", steps])
    table("Speed", ("set-up", "frames", "samples", "ms, median of 7", "steps"), rows)


def phantom() -> None:
    """C3VD: frames of a silicone phantom with known depth, colours as materials."""
    folder = datasets.data_folder() / "c3vd_trans_t1_a"
    rows = []
    for rim in (55, 75):
        shots = [datasets.read_c3vd(folder, index) for index in (1, 6)]
        parts = []
        for number, shot in enumerate(shots):
            field = shot.calibration.camera.field
            mask = shot.frame.mask & (field.cos_alpha > np.cos(np.deg2rad(rim)))
            parts.append(sample_depth(shot.frame.image, shot.distance, field, mask, frame=number, most=6000))
        sets = {"frame 1": parts[0], "frame 6": parts[1], "both": Samples.concatenate(parts)}
        for name, samples in sets.items():
            for gamma in ("free", 2.2):
                found = calibrate_light(
                    samples, gamma=gamma, brdf="lambertian", reflectance=(None, None), levels=PHANTOM_LEVELS
                )
                error, gains = found.standard_errors, ", ".join(f"{gain:.0f}" for gain in found.gains)
                row = [f"{name}, < {rim}°", f"{found.k:.3f} ± {error['k']:.3f}"]
                row += [f"{found.photometry.gamma:.3f} ± {error['gamma']:.3f}", gains]
                row += [f"{ratio:.3f}" for ratio in found.reflectance[1:]]
                rows.append([*row, f"{found.sigma:.1f}"])
    table("C3VD, matt", ("frames", "k", "γ", "gain · red", "green/red", "blue/red", "σ grey"), rows)


TABLES = {one.__name__: one for one in (recovery, ways, lambertian, frames, lights, speed, phantom)}


if __name__ == "__main__":
    names = sys.argv[1:]
    if names[:1] == ["--seeds"]:
        SEEDS, names = int(names[1]), names[2:]
    for name in names or TABLES:
        TABLES[name]()
