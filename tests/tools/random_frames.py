"""Random path-traced frames: what an endoscope may see, drawn by a seed, so that nothing can be tuned to it.

`tests.benchmarks.unseen` makes and scores them: 24 open ones to look at and to judge by, 24 sealed ones, to
be scored once, at the end. A seed decides everything: the
cavity, the camera, lamps, wall, sensor and what is known of them. One file a frame holds its picture, truth
and layers of light, see `read`. Mitsuba is needed to make them, not to read.
"""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tqdm import tqdm

from endolab.frames.frame import Frame
from endolab.io.atomic import PathLike, write_atomically
from endolab.io.datasets.sample import Sample
from endolab.io.datasets.traced import LAYERS
from endolab.metrics.depth_errors import depth_cuts
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera, KannalaBrandt, Pinhole
from endolab.model.endoscope import Calibration
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray
from tests.tools.cavities import Cavity, Fold, Polyp
from tests.tools.path_tracing import Traced, stored, trace

COUNT = 24
SETS = {
    "open": range(1000, 1000 + COUNT),
    "sealed": range(770_000, 770_000 + COUNT),
}
SIZE = 200, 150  # px
SAMPLES = 128  # paths a pixel: leaves about a grey level of their noise in red, half of one in green
MESH = 260  # steps a side
PAPER = (-0.13893, -1.2396e-3, 9.1258e-4, -4.0716e-5)  # the distortion of its fisheye

# What a frame must be to be one, beside lit: mm, and a share of the steps between pixels.
CLEARANCE = 6.0  # from the optical centre to the wall, any way
# that is seen
NEAREST = 9.0
FARTHEST = 230.0
MEDIAN = 16.0, 90.0
FOLDED = 0.004  # of the steps between pixels that jump, in a colon
ATTEMPTS = 200
LOOK_WIDTH = 40  # px, of the glance that tells


@dataclass(frozen=True)
class RandomCase:
    """What a frame shows, how it was lit and developed, and what is known of it."""

    kind: str
    cavity: Cavity
    camera: Camera
    photometry: (
        Photometry  # that the light is made with; the gain follows from the exposure
    )
    wall: dict[str, float]  # options of `path_tracing.trace`
    fog: float  # 1/mm
    noise: float  # grey levels of 255
    # This share of the pixels is brighter than this stored value.
    exposure: tuple[float, float]
    jpeg: int | None  # quality
    albedo_known: bool  # all three, or green's alone
    seed: int


@dataclass(frozen=True)
class RandomFrame(Sample):
    """A random frame: its calibration is what a user would have, one light that stands for all."""

    normals: (
        FloatArray  # (H, W, 3), true, unit, in the camera frame, towards the camera
    )
    direct: (
        FloatArray  # (H, W, 3), linear light times gain, 1 being the sensor's maximum
    )
    indirect: FloatArray  # (H, W, 3), the same
    mirrored: FloatArray  # (H, W), the same
    kind: str


# Cavities --------------------------------------------------------------------------------


def _folds(
    rng: np.random.Generator, first: float, last: float, radius: float
) -> tuple[Fold, ...]:
    folds = []
    s = first + rng.uniform(0, 15)
    while s < last:
        height = radius * rng.uniform(0.2, 0.5)
        width = rng.uniform(0.35, 0.7) * height
        side = rng.uniform(0, 2 * np.pi)
        reach = rng.uniform(0, 2.5)
        lean = radius * rng.uniform(-0.3, 0.5)
        folds.append(Fold(s, height, width, side, reach, lean))
        s += rng.uniform(0.7, 1.5) * radius + 4
    return tuple(folds)


def _put_polyps(
    rng: np.random.Generator, cavity: Cavity, camera: Camera, count: int
) -> Cavity:
    """Polyps where pixels chosen at random see the wall."""
    pixels = rng.uniform(0.15, 0.85, (count, 2)) * [camera.width, camera.height]
    rays = camera.unproject(pixels)
    rays = rays[rays[:, 2] > 0]
    polyps = []
    for u, v, s in cavity.to_tube(cavity.distance(rays)[:, None] * rays):
        radius = rng.uniform(3.0, 8.0)
        polyps.append(
            Polyp(s, math.atan2(v, u), radius, radius * rng.uniform(1.0, 2.2))
        )
    return replace(cavity, polyps=tuple(polyps))


def _tube_like(rng: np.random.Generator, low: float, high: float) -> dict[str, Any]:
    radius = rng.uniform(low, high)
    off = radius * 0.5 * np.sqrt(rng.uniform())
    side = rng.uniform(0, 2 * np.pi)
    return {
        "radius": radius,
        "ahead": rng.uniform(80, 170),
        "behind": rng.uniform(15, 90),
        "ends": tuple(radius * rng.uniform(0.6, 1.1, 2)),
        "bend": rng.uniform(0, 1 / max(60.0, 2.5 * radius)),
        "sway": (rng.uniform(0, 8), rng.uniform(140, 260)),
        "place": (off * np.cos(side), off * np.sin(side)),
        "look": (rng.uniform(-180, 180), *rng.normal(0, 9, 2)),
        "bumps": rng.uniform(0.0, 0.5),
        "seed": int(rng.integers(2**31)),
    }


def _colon(rng: np.random.Generator, camera: Camera) -> Cavity:
    shape = _tube_like(rng, 17, 28)
    return Cavity(
        **shape, folds=_folds(rng, -shape["behind"], shape["ahead"], shape["radius"])
    )


def _tube(rng: np.random.Generator, camera: Camera) -> Cavity:
    return Cavity(**_tube_like(rng, 10, 26) | {"bumps": rng.uniform(0, 0.3)})


def _blind(rng: np.random.Generator, camera: Camera) -> Cavity:
    shape = _tube_like(rng, 18, 30)
    shape |= {"ahead": rng.uniform(15, 50), "bumps": rng.uniform(0.2, 1.0)}
    folds = _folds(
        rng, -shape["behind"], shape["ahead"] + 0.3 * shape["radius"], shape["radius"]
    )
    return Cavity(**shape, folds=folds if rng.uniform() < 0.6 else ())


def _bag(rng: np.random.Generator, camera: Camera) -> Cavity:
    shape = _tube_like(rng, 28, 45)
    shape |= {"ahead": rng.uniform(0, 25), "behind": rng.uniform(0, 20)}
    shape |= {"look": (rng.uniform(-180, 180), *rng.uniform(-50, 50, 2))}
    return Cavity(
        **shape | {"rugae": rng.uniform(0, 4.5), "bumps": rng.uniform(0.3, 1.5)}
    )


def _polyps(rng: np.random.Generator, camera: Camera) -> Cavity:
    shape = _tube_like(rng, 16, 28)
    folds = (
        _folds(rng, -shape["behind"], shape["ahead"], shape["radius"])
        if rng.uniform() < 0.5
        else ()
    )
    low = tuple(replace(fold, height=0.5 * fold.height) for fold in folds)
    return _put_polyps(rng, Cavity(**shape, folds=low), camera, int(rng.integers(1, 5)))


KINDS: dict[str, Callable[[np.random.Generator, Camera], Cavity]] = {
    "colon": _colon,
    "tube": _tube,
    "blind": _blind,
    "bag": _bag,
    "polyps": _polyps,
}


def _is_a_view(kind: str, cavity: Cavity, camera: Camera) -> bool:
    """Whether the camera has room, and sees something at a distance at which endoscopes work."""
    rng = np.random.default_rng(0)
    around = rng.normal(size=(300, 3))
    around /= np.linalg.norm(around, axis=-1, keepdims=True)
    if cavity.inside(np.linspace(0, CLEARANCE, 7)[:, None, None] * around).min() <= 0:
        return False
    glance = camera.resize(LOOK_WIDTH, round(LOOK_WIDTH * camera.height / camera.width))
    distance = cavity.distance(glance.field.rays)
    seen = distance[np.isfinite(distance) & (glance.field.cos_alpha > 0)]
    if (
        seen.min() < NEAREST
        or seen.max() > FARTHEST
        or not MEDIAN[0] < np.median(seen) < MEDIAN[1]
    ):
        return False
    jumps = depth_cuts(distance, 0.08 * camera.width / LOOK_WIDTH).mean()
    return kind != "colon" or bool(jumps > FOLDED)


# All the rest ----------------------------------------------------------------------------


def _camera(rng: np.random.Generator) -> Camera:
    wide, high = SIZE
    centre = (np.array(SIZE) - 1) / 2 + rng.uniform(-0.03, 0.03, 2) * wide
    # From the axis to the middle of the right border.
    edge = np.deg2rad(rng.uniform(35, 50))
    if rng.uniform() < 0.5:
        focal = wide / 2 / np.tan(edge)
        return Pinhole(wide, high, focal, focal, *centre)
    focal = wide / 2 / (1.35 * edge)
    return KannalaBrandt(wide, high, focal, focal, *centre, PAPER)


def _light(rng: np.random.Generator, albedo: tuple[float, ...]) -> Photometry:
    """One lamp at the optical centre, or one to three beside it; the fall-off's exponent is split."""
    joint = rng.uniform(1.0, 3.5)
    of_lens = rng.uniform()
    count = int(rng.integers(1, 4))
    off = rng.uniform(0.5, 4.0)
    first = rng.uniform(0, 2 * np.pi)
    if rng.uniform() < 1 / 3:
        count = 1
        off = 0.0
    angles = first + 2 * np.pi * np.arange(count) / count + rng.normal(0, 0.2, count)
    weights = rng.uniform(0.6, 1.4, count)
    lights = tuple(
        SpotLight(
            (off * np.cos(a), off * np.sin(a), 0.0),
            exponent=joint * (1 - of_lens),
            weight=float(w),
        )
        for a, w in zip(angles, weights / weights.sum(), strict=True)
    )
    return Photometry(
        joint * of_lens, rng.uniform(1.9, 2.5), None, Lambertian(albedo), lights
    )


def _wall(rng: np.random.Generator) -> dict[str, float]:
    """A matt wall, one under a wet film, or a rough one with a sheen; mottled, veined, stained or not."""
    wall = {
        "texture": rng.uniform(0, 0.15),
        "vessels": rng.uniform(0, 0.4),
        "seed": int(rng.integers(100)),
    }
    if rng.uniform() < 0.25:
        wall["stains"] = rng.uniform(0.3, 1.0)
    surface = rng.choice(["matt", "film", "rough"])
    if surface == "film":
        wall["film"] = rng.uniform(0.02, 0.03)
    elif surface == "rough":
        wall |= {"sheen": 0.04, "roughness": math.sqrt(rng.uniform(0.15, 0.5))}
    return wall


def random_case(seed: int) -> RandomCase:
    """Draw all that a frame is; kinds of cavity take turns."""
    kind = tuple(KINDS)[seed % len(KINDS)]
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, attempt])
        camera = _camera(rng)
        cavity = KINDS[kind](rng, camera)
        if _is_a_view(kind, cavity, camera):
            break
    else:
        raise RuntimeError(f"seed {seed} makes no {kind} that a camera fits in")
    green = rng.uniform(0.2, 0.45)
    albedo = (
        min(green * rng.uniform(1.5, 2.5), 0.85),
        green,
        green * rng.uniform(0.6, 1.0),
    )
    saturated = rng.uniform() < 0.35
    return RandomCase(
        kind=kind,
        cavity=cavity,
        camera=camera,
        photometry=_light(rng, albedo),
        wall=_wall(rng),
        fog=rng.uniform(3e-4, 2e-3) if rng.uniform() < 0.2 else 0.0,
        noise=rng.uniform(0, 4),
        exposure=(rng.uniform(0.01, 0.1), 1.0)
        if saturated
        else (0.01, rng.uniform(0.75, 0.98)),
        jpeg=int(rng.integers(70, 96)) if rng.uniform() < 0.4 else None,
        albedo_known=bool(rng.uniform() < 0.5),
        seed=seed,
    )


# Frames ----------------------------------------------------------------------------------


def frame_of(
    case: RandomCase, *, samples: int = SAMPLES, mesh_size: int = MESH
) -> RandomFrame:
    """Path-trace and develop a case."""
    lit = replace(case.photometry, gain=1.0)
    how = {"samples": samples, "mesh_size": mesh_size, "fog": case.fog}
    return developed_frame(
        case, trace(case.cavity, case.camera, lit, **how, **case.wall)
    )


def developed_frame(case: RandomCase, traced: Traced) -> RandomFrame:
    """What the sensor and the file make of the layers, at a gain that gives the exposure.

    The calibration is the one that a user would have: one light at the optical centre, perhaps one albedo.
    """
    mask = traced.mask
    gamma = case.photometry.gamma
    light = traced.direct + traced.indirect + traced.mirrored[..., None]
    share, level = case.exposure
    gain = level**gamma / float(
        np.percentile(light[mask].max(axis=-1), 100 * (1 - share))
    )
    image = stored(
        gain * light, traced.distance, gamma, case.fog, case.noise, case.seed
    )
    if case.jpeg is not None:
        grey_levels = np.round(255 * image[..., ::-1]).astype(np.uint8)
        packed = cv2.imencode(
            ".jpg", grey_levels, [cv2.IMWRITE_JPEG_QUALITY, case.jpeg]
        )[1]
        image = cv2.imdecode(packed, cv2.IMREAD_COLOR)[..., ::-1] / 255
    one = replace(case.photometry, gain=gain).simplify()
    albedo = one.brdf.albedo if case.albedo_known else one.brdf.albedo[1]
    known = Calibration(case.camera, replace(one, brdf=Lambertian(albedo)))
    frame = Frame(image, mask, f"{case.seed}-{case.kind}")
    layers = {name: gain * getattr(traced, name) for name in LAYERS}
    return RandomFrame(
        frame, known, traced.distance, traced.normals, **layers, kind=case.kind
    )


def write(path: PathLike, made: RandomFrame) -> None:
    """Write a frame: 8 bits a colour of the picture, 16 of layers and normals."""
    arrays = {name: getattr(made, name).astype(np.float16) for name in LAYERS}
    arrays["image"] = np.round(255 * made.frame.image).astype(np.uint8)
    arrays["distance"] = made.distance.astype(np.float32)
    arrays["normals"] = np.round(32767 * np.nan_to_num(made.normals)).astype(np.int16)
    facts = json.dumps({"kind": made.kind, "calibration": made.calibration.to_dict()})
    packed = BytesIO()
    np.savez_compressed(packed, facts=np.array(facts), **arrays)
    write_atomically(path, packed.getvalue())


def read(path: PathLike) -> RandomFrame:
    """Read a frame that `write` wrote."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    facts = json.loads(str(arrays["facts"]))
    distance = arrays["distance"].astype(np.float64)
    mask = np.isfinite(distance)
    normals = np.where(mask[..., None], arrays["normals"], np.nan) / 32767
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    frame = Frame(arrays["image"] / 255, mask, Path(path).stem)
    known = Calibration.from_dict(facts["calibration"], str(path))
    layers = {name: arrays[name].astype(np.float64) for name in LAYERS}
    return RandomFrame(frame, known, distance, normals, **layers, kind=facts["kind"])


def make(seeds: Sequence[int], folder: PathLike, **how: int) -> None:
    """Make the frames that are not in a folder yet, each whole or not at all."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    missing = [seed for seed in seeds if not list(Path(folder).glob(f"{seed}-*.npz"))]
    for seed in tqdm(missing, unit="frame", disable=not missing):
        made = frame_of(random_case(seed), **how)
        write(Path(folder) / f"{made.frame.name}.npz", made)
