"""Random path-traced frames: what an endoscope may see, drawn by a seed, so that nothing can be tuned to it.

24 open ones to look at and to judge by, 24 sealed ones, to be scored once, at the end. A seed decides
everything: the cavity, the camera, lamps, wall, sensor and what is known of them. Mitsuba is needed to make
them, not to read.
"""

import itertools
import math
import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

import endolab as el
from endolab.io.atomic import write_atomically
from endolab.io.datasets.traced import LAYERS, TracedSample
from endolab.metrics.depth_errors import depth_cuts
from tests.research.cavities import Cavity, Fold, Polyp

FOLDER = Path(__file__).resolve().parents[2] / "build" / "unseen"
COUNT = 24
SETS = {"open": range(1000, 1000 + COUNT), "sealed": range(770_000, 770_000 + COUNT)}
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
LOOK_WIDTH = 40  # px, of the glance that tells

# Kinds of cavity, which take turns, and their radii, mm
RADII = {
    "colon": (17, 28),
    "tube": (10, 26),
    "blind": (18, 30),
    "bag": (28, 45),
    "polyps": (16, 28),
}


# Cavities --------------------------------------------------------------------------------


def _tube_like(rng, low, high):
    """A tube of a radius between two."""
    radius = rng.uniform(low, high)
    off = radius * 0.5 * np.sqrt(rng.uniform())
    side = rng.uniform(0, 2 * np.pi)
    return Cavity(
        radius=radius,
        ahead=rng.uniform(80, 170),
        behind=rng.uniform(15, 90),
        ends=tuple(radius * rng.uniform(0.6, 1.1, 2)),
        bend=rng.uniform(0, 1 / max(60.0, 2.5 * radius)),
        sway=(rng.uniform(0, 8), rng.uniform(140, 260)),
        place=(off * np.cos(side), off * np.sin(side)),
        look=(rng.uniform(-180, 180), *rng.normal(0, 9, 2)),
        bumps=rng.uniform(0.0, 0.5),
        seed=int(rng.integers(2**31)),
    )


def _folds(rng, cavity, beyond=0.0, low=1.0):
    """The cavity with folds as far as its far end begins, and some radii beyond; lower by a factor."""
    radius = cavity.radius
    folds = []
    s = -cavity.behind + rng.uniform(0, 15)
    while s < cavity.ahead + beyond * radius:
        height = radius * rng.uniform(0.2, 0.5)
        width = rng.uniform(0.35, 0.7) * height
        side = rng.uniform(0, 2 * np.pi)
        reach = rng.uniform(0, 2.5)
        lean = radius * rng.uniform(-0.3, 0.5)
        folds.append(Fold(s, low * height, width, side, reach, lean))
        s += rng.uniform(0.7, 1.5) * radius + 4
    return replace(cavity, folds=tuple(folds))


def _polyps(rng, cavity, camera):
    """The cavity with polyps where pixels chosen at random see the wall."""
    count = int(rng.integers(1, 5))
    pixels = rng.uniform(0.15, 0.85, (count, 2)) * [camera.width, camera.height]
    rays = camera.unproject(pixels)
    rays = rays[rays[:, 2] > 0]
    polyps = []
    for u, v, s in cavity.to_tube(cavity.distance(rays)[:, None] * rays):
        radius = rng.uniform(3.0, 8.0)
        height = radius * rng.uniform(1.0, 2.2)
        polyps.append(Polyp(s, math.atan2(v, u), radius, height))
    return replace(cavity, polyps=tuple(polyps))


def _cavity(kind, rng, camera):
    """A cavity of a kind."""
    cavity = _tube_like(rng, *RADII[kind])
    match kind:
        case "colon":
            return _folds(rng, cavity)
        case "tube":
            return replace(cavity, bumps=rng.uniform(0, 0.3))
        case "blind":
            ahead = rng.uniform(15, 50)
            cavity = replace(cavity, ahead=ahead, bumps=rng.uniform(0.2, 1.0))
            folded = _folds(rng, cavity, beyond=0.3)
            return folded if rng.uniform() < 0.6 else cavity
        case "bag":
            return replace(
                cavity,
                ahead=rng.uniform(0, 25),
                behind=rng.uniform(0, 20),
                look=(rng.uniform(-180, 180), *rng.uniform(-50, 50, 2)),
                rugae=rng.uniform(0, 4.5),
                bumps=rng.uniform(0.3, 1.5),
            )
    if rng.uniform() < 0.5:
        cavity = _folds(rng, cavity, low=0.5)
    return _polyps(rng, cavity, camera)


def _is_a_view(kind, cavity, camera):
    """Whether the camera has room, and sees something at a distance at which endoscopes work."""
    rng = np.random.default_rng(0)
    around = rng.normal(size=(300, 3))
    around /= np.linalg.norm(around, axis=-1, keepdims=True)
    if cavity.inside(np.linspace(0, CLEARANCE, 7)[:, None, None] * around).min() <= 0:
        return False
    glance = camera.resize(LOOK_WIDTH, round(LOOK_WIDTH * camera.height / camera.width))
    distance = cavity.distance(glance.field.rays)
    seen = distance[np.isfinite(distance) & (glance.field.cos_alpha > 0)]
    jumps = depth_cuts(distance, 0.08 * camera.width / LOOK_WIDTH).mean()
    return (
        seen.min() >= NEAREST
        and seen.max() <= FARTHEST
        and MEDIAN[0] < np.median(seen) < MEDIAN[1]
        and (kind != "colon" or jumps > FOLDED)
    )


# All the rest ----------------------------------------------------------------------------


def _camera(rng):
    wide, high = SIZE
    centre = (np.array(SIZE) - 1) / 2 + rng.uniform(-0.03, 0.03, 2) * wide
    # From the axis to the middle of the right border.
    edge = np.deg2rad(rng.uniform(35, 50))
    if rng.uniform() < 0.5:
        focal = wide / 2 / np.tan(edge)
        return el.Pinhole(wide, high, focal, focal, *centre)
    focal = wide / 2 / (1.35 * edge)
    return el.KannalaBrandt(wide, high, focal, focal, *centre, PAPER)


def _light(rng, albedo):
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
    weights /= weights.sum()
    exponent = joint * (1 - of_lens)
    lights = tuple(
        el.SpotLight(
            (off * np.cos(a), off * np.sin(a), 0.0), exponent=exponent, weight=float(w)
        )
        for a, w in zip(angles, weights, strict=True)
    )
    gamma = rng.uniform(1.9, 2.5)
    return el.Photometry(joint * of_lens, gamma, None, el.Lambertian(albedo), lights)


def _wall(rng):
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


def frame_of(seed):
    """Draw all that a frame is, path-trace it, and develop it as sensor and file do.

    Kinds of cavity take turns; the gain gives the exposure. The calibration is the one that a user
    would have: one light at the optical centre, perhaps one albedo.
    """
    from tests.research.path_tracing import stored, trace

    kind = tuple(RADII)[seed % len(RADII)]
    for attempt in itertools.count():
        rng = np.random.default_rng([seed, attempt])
        camera = _camera(rng)
        cavity = _cavity(kind, rng, camera)
        if _is_a_view(kind, cavity, camera):
            break
    green = rng.uniform(0.2, 0.45)
    red = min(green * rng.uniform(1.5, 2.5), 0.85)
    albedo = red, green, green * rng.uniform(0.6, 1.0)
    is_saturated = rng.uniform() < 0.35
    light = _light(rng, albedo)
    wall = _wall(rng)
    fog = rng.uniform(3e-4, 2e-3) if rng.uniform() < 0.2 else 0.0  # 1/mm
    noise = rng.uniform(0, 4)  # grey levels of 255
    # This share of the pixels is brighter than this stored value.
    share = rng.uniform(0.01, 0.1) if is_saturated else 0.01
    level = 1.0 if is_saturated else rng.uniform(0.75, 0.98)
    quality = int(rng.integers(70, 96)) if rng.uniform() < 0.4 else None  # of a JPEG
    is_albedo_known = rng.uniform() < 0.5  # all three, or green's alone

    how = {"samples": SAMPLES, "mesh_size": MESH, "fog": fog}
    traced = trace(cavity, camera, replace(light, gain=1.0), **how, **wall)
    lit = traced.direct + traced.indirect + traced.mirrored[..., None]
    brightest = np.percentile(lit[traced.mask].max(axis=-1), 100 * (1 - share))
    gain = level**light.gamma / float(brightest)
    image = stored(gain * lit, traced.distance, light.gamma, fog, noise, seed)
    if quality is not None:
        grey_levels = np.round(255 * image).astype(np.uint8)[..., ::-1]
        packed = cv2.imencode(".jpg", grey_levels, [cv2.IMWRITE_JPEG_QUALITY, quality])[
            1
        ]
        image = cv2.imdecode(packed, cv2.IMREAD_COLOR)[..., ::-1] / 255
    one = replace(light, gain=gain).simplify()
    known = albedo if is_albedo_known else green
    return TracedSample(
        el.Frame(image, traced.mask, f"{seed}-{kind}"),
        el.Calibration(camera, replace(one, brdf=el.Lambertian(known))),
        traced.distance,
        traced.normals,
        **{name: gain * getattr(traced, name) for name in LAYERS},
        scene=cavity,
    )


def frames(name):
    """The frames of a set; those that are not kept yet are made, each whole or not at all."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for seed in tqdm(SETS[name], unit="frame"):
        path = FOLDER / f"{seed}.pickle"
        if not path.exists():
            write_atomically(path, pickle.dumps(frame_of(seed)))
        yield pickle.loads(path.read_bytes())
