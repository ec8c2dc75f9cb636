"""How far a real colon is from what is found: path-traced frames, C3VD and SimCol3D, beside their truth.

    python -m tests.benchmarks.colon [traced | c3vd | simcol3d | variants]...

No test: it takes minutes, and real frames are looked for in $ENDOLAB_DATA or ../shared/data.
"""

import sys
import time
from dataclasses import replace
from itertools import product

import cv2
import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import compare, depth_cuts

TISSUE = el.Lambertian((0.75, 0.38, 0.30))
WAYS = {
    "facing": {"solver": "facing"},
    "marched": {"solver": "fast_marching"},
    "solved": {"channel": "green"},
    "automatic": {},
    "blue": {"channel": "blue"},
    "separated": {"channel": "separated"},
    "separated, marched": {"channel": "separated", "solver": "fast_marching"},
}


def tell(
    name, way, frame, calibration, truth, normals=None, most=90.0, scale="none", **options
):
    """Reconstruct, print one line of the table, and return the result."""
    started = time.perf_counter()
    result = el.reconstruct(frame, calibration, **options)
    seconds = time.perf_counter() - started
    cosine = result.problem.field.cos_alpha
    near_axis = np.nan_to_num(cosine, nan=-1.0) > np.cos(np.deg2rad(most))
    known = {
        "normals": result.normals,
        "true_normals": normals,
        "mask": near_axis,
        "scale": scale,
    }
    found = compare(result.distance, truth, cosine, **known)
    degrees = f"{found.mean_degrees:5.1f}°" if normals is not None else "     -"
    settings = result.provenance.settings
    torn = "torn" if settings.get("contours") else ""
    albedo = " ".join(f"{one:.2f}" for one in settings.get("albedo", ()))
    way = way.format(status=result.status.name)
    print(
        f"{name:12} {way:24} {found.mean_percent:5.1f} {found.median_percent:5.1f} % "
        f"{found.mean_mm:6.2f} {found.median_mm:6.2f} mm {degrees} {result.iterations:5d} {seconds:5.1f} s "
        f"{torn:5}{albedo}",
        flush=True,
    )
    return result


def without_albedo(calibration):
    return replace(
        calibration, photometry=replace(calibration.photometry, brdf=el.Lambertian(0.38))
    )


def traced():
    print("path-traced, mean and median of the distance, true scale; normals; iterations")
    for name in datasets.TRACED:
        sample = el.load_traced(name)
        frame = sample.frame
        known = sample.calibration
        truth = (sample.distance, sample.normals)
        for way, options in WAYS.items():
            tell(name, way, frame, known, *truth, **options)
        unknown = without_albedo(known)
        torn = depth_cuts(sample.distance)
        tell(name, "separated, albedo unknown", frame, unknown, *truth, channel="separated")
        tell(
            name,
            "separated, true contours",
            frame,
            known,
            *truth,
            channel="separated",
            cuts=torn,
        )


def at_width(sample, width):
    """A smaller frame with its calibration and truth."""
    height = round(sample.frame.height * width / sample.frame.width)
    known = np.isfinite(sample.distance).astype(float)
    share, sums = (
        cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA)
        for values in (known, np.nan_to_num(sample.distance))
    )
    truth = np.where(share > 0.5, sums / np.maximum(share, 1e-9), np.nan)
    return (
        sample.frame.resize(width, height, 2.2),
        sample.calibration.resize(width, height),
        truth,
    )


def with_light(calibration, **light):
    return replace(
        calibration, photometry=replace(calibration.photometry, brdf=TISSUE, **light)
    )


def c3vd(width=338):
    folder = datasets.data_folder()
    print("C3VD, within 55°, median-scaled; k and γ as published, and as fitted to frame 1")
    scored = {"most": 55, "scale": "median"}
    for index in (1, 6):
        name = f"c3vd {index} {width}"
        frame, calibration, truth = at_width(
            datasets.read_c3vd(folder / "c3vd_trans_t1_a", index), width
        )
        published = with_light(calibration)
        fitted = with_light(calibration, k=1.52, gamma=2.2)
        for way, options in WAYS.items():
            tell(name, f"{way}, published", frame, published, truth, **scored, **options)
        for way in ("solved", "separated"):
            tell(name, f"{way}, of frame 1", frame, fitted, truth, **scored, **WAYS[way])
        unknown = without_albedo(calibration)
        tell(
            name,
            "separated, no albedo",
            frame,
            unknown,
            truth,
            **scored,
            channel="separated",
        )


def simcol3d():
    folder = datasets.data_folder()
    print(
        "SimCol3D, median-scaled; AbsRel, RMSE and L1 of z in cm, as its challenge has them"
    )
    for index in range(5):
        sample = datasets.read_simcol3d(folder / "simcol3d", index)
        frame, calibration, truth = at_width(sample, 320)
        for way in ("marched", "solved", "separated"):
            known = with_light(calibration)
            result = tell(
                f"simcol {index}", way, frame, known, truth, scale="median", **WAYS[way]
            )
            good = result.mask & np.isfinite(truth)
            cosine = result.problem.field.cos_alpha[good]
            z = result.distance[good] * cosine
            true = truth[good] * cosine
            z *= np.median(true) / np.median(z)
            l1 = np.abs(z - true).mean() / 10
            rmse = np.sqrt(((z - true) ** 2).mean()) / 10
            print(
                f"{'':37} AbsRel {np.mean(np.abs(z - true) / true):.3f} RMSE {rmse:.3f} L1 {l1:.3f} cm"
            )


def variants():
    print(
        "Table II: the paper's solver on diffuse-1, all six variants; iterations, distance and normals"
    )
    sample = el.load_traced("diffuse-1")
    truth = sample.distance, sample.normals
    for light, channel in (("as it is", "green"), ("separated", "separated")):
        for regulariser, xi in product(("first", "second"), ("1/z", "d", "1/d")):
            how = {
                "solver": "primal_dual",
                "xi": xi,
                "regulariser": regulariser,
                "lam": 0.1,
            }
            way = f"{light}, {{status}}"
            tell(
                f"{xi} {regulariser}",
                way,
                sample.frame,
                sample.calibration,
                *truth,
                channel=channel,
                **how,
            )


if __name__ == "__main__":
    parts = {"traced": traced, "c3vd": c3vd, "simcol3d": simcol3d, "variants": variants}
    for wanted in sys.argv[1:] or parts:
        parts[wanted]()
