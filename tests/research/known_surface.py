"""The light of an endoscope, measured on frames whose surface is known, such as those of a phantom.

Brightness over a known surface tells the light's spread k and the response γ, if light that bounced is in
the model: without it γ comes out far too large, since a dark lumen is lit by its walls. A wall of albedo a_c
under direct light E shows, of light S that bounced (`interreflection`),

    I_c = (g_c a_c (E + S_c) cos^((1-b) k) α)^(1/γ),

b being the share of the light's fall that is the lamp's (the lens's part lights no walls). Fitted are k, γ,
three albedos, by which S differs between colours, and a brightness g_c for each frame and colour. Of lamps
that stand beside the lens, E is ω times as bright (`lamps`), and their places (x, y) are fitted with the
rest. What the model leaves goes on over much of a picture, so that errors are found by leaving out one of
eight parts of the scene after the other, and to them comes what computed bounces are off by on path-traced
frames. That γ of cameras is near 2.2, albedos are those of tissue, and lamps are in the endoscope's tip, is
heard as more measurements.
"""

import cv2
import numpy as np
import scipy

import endolab as el
from endolab.frames.frame import SATURATED
from endolab.frames.highlights import find_highlights
from endolab.metrics.depth_errors import depth_cuts, resample_truth
from endolab.model.photometry import CHANNELS, Photometry
from endolab.reconstruction.colours import LEAST_ALBEDO, MOST_ALBEDO, TISSUE, UNKNOWN
from endolab.reconstruction.estimate_light import EXPONENTS
from endolab.reconstruction.lamps import BOUNDS
from endolab.reconstruction.walls import Walls, bounced_light_and_slope, sectors

WIDTH = 225  # px, of what is fitted
# Degrees from the axis. The nearest walls, at the rim, tell where lamps are: up to 60°, C3VD's came out at
# (-0.1, 2.2) and k at 1.2, and its frames read 7.2 %; up to the rim (0.5, 1.8), 1.6, and 6.1 %.
WIDEST = 80.0
LAMP = 0.8  # b
GAMMA, GAMMA_SIGMA = (
    2.2,
    0.2,
)  # of cameras whose γ nobody measured, and its standard deviation
TIP = 3.0  # mm, standard deviation of x and y of a lamp in a tip that is 13 mm wide
# Of k, γ and albedos' logarithms, and of a lamp's place, mm, that computed bounces make.
MODEL_ERRORS = (0.1, 0.15, 0.1, 0.3, 0.3)
PLACE_ERROR = 0.5
USUAL_MISFIT = 8.0  # grey levels that the model leaves; larger ones count as lines
SECTORS = 4  # around the axis, each with a near and a far part


def measure_light(frames, camera, distances, lamps=0):
    """Measure k, γ and a matt wall's albedos on colour frames of known distances, mm, nan where unknown.

    And the places of none to two `lamps` beside the lens (`Photometry.with_lamps`); 0: one at its centre.

    Returned are the light, of unknown gain, the standard errors of "k" (joint), "gamma", "red", "green",
    "blue", and "lamp 1 x" ..., mm, and the median size of what the model leaves, grey levels.
    """
    seen = [_Patches(*pair, camera) for pair in zip(frames, distances, strict=True)]
    levels = []
    for patches in seen:
        log_light = GAMMA * np.log(np.maximum(patches.grey, 1) / 255)
        light = patches.light(1.5, np.array(TISSUE), np.empty((0, 2)))
        levels.append(np.median(log_light - light, axis=0))
    count = 5 + 2 * lamps
    places = TIP * np.eye(2)[:lamps]
    start = np.concatenate([[1.5, GAMMA], np.log(TISSUE), places.ravel(), *levels])
    fitted = _fit(seen, start, lamps)
    parts = [_fit(seen, fitted, lamps, part)[:count] for part in range(2 * SECTORS)]
    apart = np.array(parts) - np.mean(parts, axis=0)
    covariance = (len(parts) - 1) / len(parts) * apart.T @ apart
    covariance += np.diag(np.square([*MODEL_ERRORS, *2 * lamps * [PLACE_ERROR]]))
    usual = np.array([GAMMA, *np.log(TISSUE), *2 * lamps * [0.0]])
    width = np.array([GAMMA_SIGMA, *3 * [UNKNOWN], *2 * lamps * [TIP]])
    heard = covariance[:, 1:] @ np.linalg.inv(covariance[1:, 1:] + np.diag(width**2))
    found = fitted[:count] + heard @ (usual - fitted[1:count])
    k, gamma, *logs = found[:5]
    spread = np.sqrt(np.diag(covariance - heard @ covariance[1:]))
    albedo = np.clip(np.exp(logs), LEAST_ALBEDO, MOST_ALBEDO)
    spread[2:5] *= albedo
    light = Photometry(
        round(max(float(k), 0.0), 2),
        round(float(gamma), 2),
        brdf=el.Lambertian(tuple(albedo.round(2).tolist())),
    )
    if lamps:
        light = light.with_lamps(found[5:].reshape(-1, 2).round(1).tolist())
    names = [f"lamp {number} {axis}" for number in range(1, lamps + 1) for axis in "xy"]
    errors = dict(zip(("k", "gamma", *CHANNELS, *names), spread.tolist(), strict=True))
    return light, errors, float(np.median(np.abs(_left(seen, fitted, lamps))))


class _Patches:
    """A frame averaged over the P patches of its surface."""

    def __init__(self, frame, distance, camera):
        height = max(1, round(frame.height * WIDTH / frame.width))
        small = frame.resize(WIDTH, height, GAMMA)
        clipped = (frame.image.max(axis=-1) >= SATURATED).astype(float)
        clipped = cv2.resize(clipped, (WIDTH, height), interpolation=cv2.INTER_AREA)
        known = resample_truth(distance, (height, WIDTH))
        field = camera.resize(WIDTH, height).field
        mask = np.isfinite(known) & field.valid & small.mask
        known = np.where(mask, known, np.nan)
        walls = Walls.of(np.log(known), mask, field, 0.0, depth_cuts(known))
        mirrored = find_highlights(small.image, mask, GAMMA)
        cos_alpha = np.nan_to_num(field.cos_alpha, nan=-1.0)
        near = cos_alpha > np.cos(np.deg2rad(WIDEST))
        usable = mask & near & (clipped == 0) & ~mirrored & (walls.direct > 0)
        aside = (1 - LAMP) * np.log(np.where(usable, cos_alpha, 1.0))
        # Light under each of K exponents: direct (K, P), and of each bounce.
        means, direct, self.orders, full = walls.averages(
            np.dstack([255 * small.image, aside]), usable, LAMP * EXPONENTS
        )
        self.grey = means[:, :3]  # stored values, grey levels
        self.aside = means[:, 3]  # log cos α, as far as it is the lens's
        self.direct = np.log(direct)
        self.points, self.normals = (
            part[: walls.count][full] for part in (walls.points, walls.normals)
        )
        far = np.linalg.norm(self.points, axis=-1)
        self.part = 2 * sectors(self.points, SECTORS) + (far > np.median(far))

    def lamp_ratio(self, places):
        """ω of lamps at places (L, 2), mm, (P,)."""
        if not len(places):
            return np.ones(len(self.points))
        light = Photometry(1.0, 1.0, 1.0)
        virtual = light.intensity(self.points, self.normals)
        real = light.with_lamps(places.tolist()).intensity(self.points, self.normals)
        return np.clip(real / np.maximum(virtual, 1e-12), *BOUNDS)

    def light(self, k, albedo, places):
        """Logarithm of the light that comes from the patches, but for a constant, (P, 3)."""
        place = k / (EXPONENTS[1] - EXPONENTS[0])
        low = min(int(place), len(EXPONENTS) - 2)
        t = place - low
        direct = (1 - t) * self.direct[low] + t * self.direct[low + 1]
        less, more = (
            bounced_light_and_slope(orders, albedo)[0]
            for orders in self.orders[low : low + 2]
        )
        bounced = (1 - t) * less + t * more
        lit = self.lamp_ratio(places) * np.exp(direct)
        return np.log(lit[:, None] + bounced) + (k * self.aside)[:, None]


def _left(seen, x, lamps, but=-1):
    """What the model leaves of frames, but for one part of the scene, grey levels.

    x holds k, γ, the logarithms of three albedos, x and y of the lamps, and three of the brightness for each
    frame.
    """
    left = []
    places = x[5 : 5 + 2 * lamps].reshape(-1, 2)
    levels = x[5 + 2 * lamps :].reshape(-1, 3)
    for patches, level in zip(seen, levels, strict=True):
        light = patches.light(x[0], np.exp(x[2:5]), places)
        modelled = np.exp((light + level) / x[1])
        left.append((255 * modelled - patches.grey)[patches.part != but].ravel())
    return np.concatenate(left)


def _fit(seen, start, lamps, but=-1):
    """Fit the model to frames, `but` for one part of the scene."""
    bounds = np.full((2, len(start)), np.inf)
    bounds[0] = -np.inf
    bounds[:, 0] = EXPONENTS[[0, -1]]
    bounds[:, 1] = 1.2, 4.5
    bounds[:, 2:5] = np.log([[LEAST_ALBEDO], [MOST_ALBEDO]])
    return scipy.optimize.least_squares(
        lambda x: _left(seen, x, lamps, but) / USUAL_MISFIT,
        np.clip(start, bounds[0] + 1e-3, bounds[1] - 1e-3),
        bounds=bounds,
        loss="soft_l1",
    ).x
