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

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy

from endolab.frames.frame import SATURATED, Frame, check_size
from endolab.frames.highlights import find_highlights
from endolab.metrics.depth_errors import depth_cuts, resample_truth
from endolab.model.brdf import Lambertian
from endolab.model.cameras import Camera
from endolab.model.photometry import CHANNELS, Photometry
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.light.colours import FIT
from endolab.reconstruction.light.unknown_light import EXPONENTS
from endolab.reconstruction.light.walls import Walls, bounced_light_and_slope, sectors


@dataclass(frozen=True)
class SurfaceFit:
    """How the light is fitted to known surfaces, and what is believed of it beforehand."""

    width: int = 225  # px, of what is fitted
    widest: float = 60.0  # degrees from the axis: beyond, few cameras are known well enough
    lamp: float = 0.8  # b, share of the light's fall that is the lamp's
    gamma: tuple[float, float] = (2.2, 0.2)  # of cameras, and its standard deviation
    gammas: tuple[float, float] = (1.2, 4.5)  # least and greatest
    # Of k, γ and albedos' logarithms, that computed bounces make.
    model_errors: tuple[float, float, float, float, float] = (0.1, 0.15, 0.1, 0.3, 0.3)
    # Grey levels that the model leaves; larger ones count as lines, not squares.
    usual_misfit: float = 8.0
    sectors: int = 4  # around the axis, each with a near and a far part


SURFACE_FIT = SurfaceFit()


TOO_LITTLE = "too little of {} and its surface is known to measure the light"


@dataclass(frozen=True)
class MeasuredLight:
    """What known surfaces tell of a light; `photometry` is ready to reconstruct with, its gain unknown."""

    photometry: Photometry
    # Of "k" and "gamma", and of "red", "green" and "blue" albedos.
    standard_errors: dict[str, float]
    misfit: float  # median size of what the model leaves, grey levels of 255
    names: tuple[str, ...]  # of the frames

    @property
    def evidence(self) -> dict[str, Any]:
        """All of it in plain numbers, for `endoscope.json`."""
        errors = {name: round(value, 3) for name, value in self.standard_errors.items()}
        known = {"frames": list(self.names), "misfit_grey_levels": round(self.misfit, 2)}
        return {"photometry": {"standard_errors": errors}, "known_surface": known}


def measure_light(
    frames: Sequence[Frame],
    camera: Camera,
    distances: Sequence[FloatArray],
    *,
    lamp: float = SURFACE_FIT.lamp,
) -> MeasuredLight:
    """Measure k, γ and the wall's albedos on colour frames whose surface is known.

    Parameters
    ----------
    frames : sequence of Frame
        Of one matt wall, in colour, such as those of a phantom.
    camera : Camera
        For pictures of that size.
    distances : sequence of (H, W) float arrays
        True distance from the optical centre, mm, of each frame; nan where unknown.
    lamp : float
        Share of the light's fall to the side that is the lamp's, in [0, 1]; the rest is the lens's.

    Returns
    -------
    MeasuredLight
        Its standard errors say how far these frames tell it: one scene leaves k open by some 0.3.

    Raises
    ------
    ValueError
        If there is no frame, one is grey or of another size, or too little of it is known.
    """
    if not frames or len(frames) != len(distances):
        raise ValueError(
            f"frames and distances must be as many, got {len(frames)} and {len(distances)}"
        )
    seen = [
        _Patches.of(*pair, camera, lamp) for pair in zip(frames, distances, strict=True)
    ]
    fitted = _fit(seen)
    parts = [_fit(seen, fitted, part) for part in range(2 * SURFACE_FIT.sectors)]
    apart = np.array(parts)[:, :5] - np.mean(parts, axis=0)[:5]
    covariance = (len(parts) - 1) / len(parts) * apart.T @ apart + np.diag(
        np.square(SURFACE_FIT.model_errors)
    )
    usual = np.array([SURFACE_FIT.gamma[0], *np.log(FIT.tissue)])
    width = np.array([SURFACE_FIT.gamma[1], *[FIT.unknown] * 3])
    heard = covariance[:, 1:] @ np.linalg.inv(covariance[1:, 1:] + np.diag(width**2))
    k, gamma, *logs = fitted[:5] + heard @ (usual - fitted[1:5])
    spread = np.sqrt(np.diag(covariance - heard @ covariance[1:]))
    albedo = np.clip(np.exp(logs), *FIT.albedos)
    spread[2:] *= albedo
    red, green, blue = (round(float(rho), 2) for rho in albedo)
    light = Photometry(
        round(max(float(k), 0.0), 2),
        round(float(gamma), 2),
        brdf=Lambertian((red, green, blue)),
    )
    left = np.concatenate([np.ravel(part) for part in _residuals(fitted, seen)])
    return MeasuredLight(
        light,
        dict(zip(("k", "gamma", *CHANNELS), spread.tolist(), strict=True)),
        float(np.median(np.abs(left))),
        tuple(frame.name for frame in frames),
    )


@dataclass(frozen=True)
class _Patches:
    """A frame averaged over the patches of its surface."""

    grey: FloatArray  # (P, 3), stored values, grey levels of 255
    aside: FloatArray  # (P,), log cos α, as far as it is the lens's
    direct: FloatArray  # (K, P), log E under each of EXPONENTS
    orders: list[FloatArray]  # (bounces, P) under each, see `Walls.orders`
    part: FloatArray  # (P,), number of the part of the scene

    @classmethod
    def of(
        cls, frame: Frame, distance: FloatArray, camera: Camera, lamp: float
    ) -> _Patches:
        check_size(frame.name, (frame.width, frame.height), camera)
        if frame.image.ndim == 2:
            raise ValueError(
                f"{frame.name} is grey; its light is measured in three colours"
            )
        if distance.shape != frame.mask.shape:
            raise ValueError(
                f"the distance of {frame.name} has shape {distance.shape}, not {frame.mask.shape}"
            )
        height = max(1, round(frame.height * SURFACE_FIT.width / frame.width))
        small = frame.resize(SURFACE_FIT.width, height, SURFACE_FIT.gamma[0])
        clipped = frame.image.max(axis=-1) >= SATURATED
        clipped = cv2.resize(
            clipped.astype(float), (small.width, height), interpolation=cv2.INTER_AREA
        )
        known = resample_truth(distance, (height, SURFACE_FIT.width))
        field = camera.resize(SURFACE_FIT.width, height).field
        mask = np.isfinite(known) & field.valid & small.mask
        if mask.sum() < FIT.least_patches:
            raise ValueError(TOO_LITTLE.format(frame.name))
        known = np.where(mask, known, np.nan)
        walls = Walls.of(np.log(known), mask, field, 0.0, depth_cuts(known))
        mirrored = find_highlights(small.image, mask, SURFACE_FIT.gamma[0])
        cos_alpha = np.nan_to_num(field.cos_alpha, nan=-1.0)
        near = cos_alpha > np.cos(np.deg2rad(SURFACE_FIT.widest))
        usable = mask & near & (clipped == 0) & ~mirrored & (walls.direct > 0)
        aside = (1 - lamp) * np.log(np.where(usable, cos_alpha, 1.0))
        means, direct, orders, full = walls.averages(
            np.dstack([255 * small.image, aside]), usable, lamp * EXPONENTS
        )
        if len(means) < FIT.least_patches:
            raise ValueError(TOO_LITTLE.format(frame.name))
        points = walls.points[: walls.count][full]
        far = np.linalg.norm(points, axis=-1)
        part = 2 * sectors(points, SURFACE_FIT.sectors) + (far > np.median(far))
        return cls(
            means[:, :3],
            means[:, 3],
            np.log(direct),
            orders,
            part,
        )

    def light(self, k: float, albedo: FloatArray) -> FloatArray:
        """Logarithm of the light that comes from the patches, but for a constant, (P, 3)."""
        place = k / (EXPONENTS[1] - EXPONENTS[0])
        low = min(int(place), len(EXPONENTS) - 2)
        share = place - low
        direct = (1 - share) * self.direct[low] + share * self.direct[low + 1]
        less, more = (
            bounced_light_and_slope(orders, albedo)[0]
            for orders in self.orders[low : low + 2]
        )
        bounced = (1 - share) * less + share * more
        return np.log(np.exp(direct)[:, None] + bounced) + (k * self.aside)[:, None]


def _residuals(x: FloatArray, seen: Sequence[_Patches]) -> list[FloatArray]:
    """What the model leaves of each frame, (P, 3), grey levels.

    x holds k, γ, the logarithms of three albedos, and three of the brightness for each frame.
    """
    albedo = np.exp(x[2:5])
    levels = x[5:].reshape(len(seen), 3)
    return [
        255 * np.exp((patches.light(x[0], albedo) + level) / x[1]) - patches.grey
        for patches, level in zip(seen, levels, strict=True)
    ]


def _fit(
    seen: Sequence[_Patches], start: FloatArray | None = None, but: int = -1
) -> FloatArray:
    """Fit the model to frames, `but` for one part of the scene."""
    if start is None:
        k = 1.5
        gamma = SURFACE_FIT.gamma[0]
        albedo = np.array(FIT.tissue)
        start = np.array([k, gamma, *np.log(albedo)])
        for patches in seen:
            log_light = gamma * np.log(np.maximum(patches.grey, 1) / 255)
            level = np.median(log_light - patches.light(k, albedo), axis=0)
            start = np.append(start, level)

    def residual(x: FloatArray) -> FloatArray:
        left = [
            r[patches.part != but].ravel()
            for r, patches in zip(_residuals(x, seen), seen, strict=True)
        ]
        return np.concatenate(left) / SURFACE_FIT.usual_misfit

    bounds = np.full((2, len(start)), np.inf)
    bounds[0] = -np.inf
    bounds[:, 0] = EXPONENTS[[0, -1]]
    bounds[:, 1] = SURFACE_FIT.gammas
    bounds[:, 2:5] = np.log(FIT.albedos)[:, None]
    inside = np.clip(start, bounds[0] + 1e-3, bounds[1] - 1e-3)
    fitted: FloatArray = scipy.optimize.least_squares(
        residual, inside, bounds=bounds, loss="soft_l1"
    ).x
    return fitted
