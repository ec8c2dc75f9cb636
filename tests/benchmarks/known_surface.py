"""The light of an endoscope, measured on frames whose surface is known, such as those of a phantom.

Brightness over a known surface tells the light's spread k and the response γ, if light that bounced is in
the model: without it γ comes out far too large, since a dark lumen is lit by its walls. A wall of albedo a_c
under direct light E shows, of light S that bounced (`interreflection`),

    I_c = (g_c a_c (E + S_c) cos^((1-b) k) α)^(1/γ),

b being the share of the light's fall that is the lamp's (the lens's part lights no walls). Fitted are k, γ,
three albedos, by which S differs between colours, and a brightness g_c for each frame and colour. What the
model leaves goes on over much of a picture, so that errors are found by leaving out one of eight parts of
the scene after the other, and to them comes what computed bounces are off by on path-traced frames. That γ of
cameras is near 2.2, and albedos are those of tissue, is heard as four more measurements.
"""

import cv2
import numpy as np
import scipy

from endolab.frames.frame import SATURATED
from endolab.frames.highlights import find_highlights
from endolab.metrics.depth_errors import depth_cuts, resample_truth
from endolab.model.brdf import Lambertian
from endolab.model.photometry import CHANNELS, Photometry
from endolab.reconstruction.colours import LEAST_ALBEDO, MOST_ALBEDO, TISSUE, UNKNOWN
from endolab.reconstruction.estimate_light import EXPONENTS
from endolab.reconstruction.walls import Walls, bounced_light_and_slope, sectors

WIDTH = 225  # px, of what is fitted
WIDEST = 60.0  # degrees from the axis: beyond, few cameras are known well enough
LAMP = 0.8  # b
GAMMA, GAMMA_SIGMA = (
    2.2,
    0.2,
)  # of cameras whose γ nobody measured, and its standard deviation
# Of k, γ and albedos' logarithms, that computed bounces make.
MODEL_ERRORS = (0.1, 0.15, 0.1, 0.3, 0.3)
USUAL_MISFIT = 8.0  # grey levels that the model leaves; larger ones count as lines
SECTORS = 4  # around the axis, each with a near and a far part


def measure_light(frames, camera, distances):
    """Measure k, γ and a matt wall's albedos on colour frames of known distances, mm, nan where unknown.

    Returned are the light, of unknown gain, the standard errors of "k", "gamma", "red", "green" and "blue",
    and the median size of what the model leaves, grey levels.
    """
    seen = [_Patches(*pair, camera) for pair in zip(frames, distances, strict=True)]
    start = np.array([1.5, GAMMA, *np.log(TISSUE)])
    for patches in seen:
        log_light = GAMMA * np.log(np.maximum(patches.grey, 1) / 255)
        level = np.median(log_light - patches.light(1.5, np.array(TISSUE)), axis=0)
        start = np.append(start, level)
    fitted = _fit(seen, start)
    parts = [_fit(seen, fitted, part)[:5] for part in range(2 * SECTORS)]
    apart = np.array(parts) - np.mean(parts, axis=0)
    covariance = (len(parts) - 1) / len(parts) * apart.T @ apart
    covariance += np.diag(np.square(MODEL_ERRORS))
    usual = np.array([GAMMA, *np.log(TISSUE)])
    width = np.array([GAMMA_SIGMA, *[UNKNOWN] * 3])
    heard = covariance[:, 1:] @ np.linalg.inv(covariance[1:, 1:] + np.diag(width**2))
    k, gamma, *logs = fitted[:5] + heard @ (usual - fitted[1:5])
    spread = np.sqrt(np.diag(covariance - heard @ covariance[1:]))
    albedo = np.clip(np.exp(logs), LEAST_ALBEDO, MOST_ALBEDO)
    spread[2:] *= albedo
    light = Photometry(
        round(max(float(k), 0.0), 2),
        round(float(gamma), 2),
        brdf=Lambertian(tuple(albedo.round(2).tolist())),
    )
    errors = dict(zip(("k", "gamma", *CHANNELS), spread.tolist(), strict=True))
    return light, errors, float(np.median(np.abs(_left(seen, fitted))))


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
        points = walls.points[: walls.count][full]
        far = np.linalg.norm(points, axis=-1)
        self.part = 2 * sectors(points, SECTORS) + (far > np.median(far))

    def light(self, k, albedo):
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
        return np.log(np.exp(direct)[:, None] + bounced) + (k * self.aside)[:, None]


def _left(seen, x, but=-1):
    """What the model leaves of frames, but for one part of the scene, grey levels.

    x holds k, γ, the logarithms of three albedos, and three of the brightness for each frame.
    """
    left = []
    for patches, level in zip(seen, x[5:].reshape(-1, 3), strict=True):
        modelled = np.exp((patches.light(x[0], np.exp(x[2:5])) + level) / x[1])
        left.append((255 * modelled - patches.grey)[patches.part != but].ravel())
    return np.concatenate(left)


def _fit(seen, start, but=-1):
    """Fit the model to frames, `but` for one part of the scene."""
    bounds = np.full((2, len(start)), np.inf)
    bounds[0] = -np.inf
    bounds[:, 0] = EXPONENTS[[0, -1]]
    bounds[:, 1] = 1.2, 4.5
    bounds[:, 2:5] = np.log([[LEAST_ALBEDO], [MOST_ALBEDO]])
    return scipy.optimize.least_squares(
        lambda x: _left(seen, x, but) / USUAL_MISFIT,
        np.clip(start, bounds[0] + 1e-3, bounds[1] - 1e-3),
        bounds=bounds,
        loss="soft_l1",
    ).x
