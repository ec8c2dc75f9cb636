"""Figures of an endoscope's light: where it was sampled, how it falls off, gains, BRDF, scores.

As in `maps`, every function draws into the axes ``ax`` it is given, or into new ones, under
``title``, and returns the axes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import norm

from endolab.calibration.photometric.result import LEAST_SCORED, AngleErrors, PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.summary import count_of
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.style import (
    HOUSE,
    AxesOrNew,
    decorate,
    house,
    legend_below,
)

# With their standard errors.
POINTS: Any = {"color": HOUSE.vermilion, "marker": "o", "capsize": 3}


def histogram(
    ax: AxesOrNew,
    title: str,
    unit: str,
    values: FloatArray,
    mean: float,
    sigma: float,
    label: str,
) -> Axes:
    """Draw a histogram as a density, and the normal distribution of `mean` and `sigma` over it."""
    ax = decorate(ax, title, f"measured - predicted [{unit}]", f"density [1/{unit}]")
    x = mean + np.linspace(-4, 4, 301) * max(sigma, 1e-9)
    ax.hist(values, x[::5].tolist(), density=True, color=HOUSE.sky, label=label)
    ax.plot(x, norm.pdf(x, mean, sigma), "--", color="black", label="Gaussian")
    ax.set_xlim(x[0], x[-1])
    ax.margins(y=0.3)
    ax.locator_params(axis="x", nbins=5)
    ax.legend(loc="upper right", ncols=2)
    return ax


def _show_band(
    ax: Axes, x: FloatArray | IntArray, low: FloatArray, high: FloatArray
) -> None:
    """Fill what lies within a standard error of a curve."""
    ax.fill_between(x, low, high, color=HOUSE.vermilion, alpha=0.35, lw=0)


def _shade_unseen(ax: Axes, low: float, high: float) -> None:
    """Shade the angles of 0 to 90° that are not between two."""
    ax.axvspan(0, low, color="0.88", lw=0, zorder=0)
    ax.axvspan(high, 90, color="0.88", lw=0, zorder=0)
    ax.set(xlim=(0, 90), xticks=range(0, 91, 15))


@house()
def show_sampling(
    image: FloatArray,
    samples: Samples,
    camera: Camera,
    ax: AxesOrNew = None,
    *,
    used: BoolArray | None = None,
    title: str = "Samples",
) -> Axes:
    """Show where the brightness of a frame was read.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        Stored values in [0, 1].
    samples : Samples
        Of this frame.
    camera : Camera
    used : (n,) bool array, optional
        Those that counted in the fit; all by default.
    """
    used = np.ones(len(samples), bool) if used is None else used
    ax = show_picture(image, ax, f"{title}: {len(samples)} in this frame")
    pixels = camera.project(samples.points)
    paper = samples.material == 0
    for which, fill, edge, label in (
        (used & paper, HOUSE.vermilion, "white", "bare paper"),
        (used & ~paper, HOUSE.blue, "white", "grey patch"),
        (~used, "none", "black", "left out"),
    ):
        ax.plot(*pixels[which].T, "o", ms=5, mfc=fill, mec=edge, mew=0.8, label=label)
    legend_below(ax)
    return ax


@house()
def show_light_residuals(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show how the residuals of the samples that counted are spread, with a Gaussian."""
    values = light.residuals[light.used]
    left_out = np.count_nonzero(~light.used)
    title = f"Residuals: ± {light.sigma:.2f} grey levels; {left_out} left out"
    label = count_of(len(values), "sample")
    return histogram(
        ax, title, "grey levels", values, float(np.mean(values)), light.sigma, label
    )


@house()
def show_fall_off(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show the joint vignetting and light spread cosᵏα with its standard error, beside cos⁴α.

    Angles at which there were no samples are shaded.
    """
    share = "share of the light on the axis"
    ax = decorate(ax, "Light's fall-off", "angle α off the axis [°]", share)
    k = light.k
    error = light.standard_errors["k"]
    alpha = np.linspace(0, 90, 361)
    cosine = np.cos(np.deg2rad(alpha)).clip(1e-9)
    _shade_unseen(ax, *np.rad2deg(light.alpha_range))
    ax.plot(alpha, cosine**4, color="black", lw=1.5, ls=":", label="cos⁴ α")
    label = f"cosᵏ α, k = {k:.3f} ± {error:.3f}"
    ax.plot(alpha, cosine**k, color=HOUSE.vermilion, label=label)
    _show_band(ax, alpha, cosine ** (k + error), cosine ** (k - error))
    ax.set_ylim(0, 1.05)
    ax.legend(loc="upper right")
    return ax


def _show_second(
    ax: Axes, x: Any, values: Any, label: str, name: str, loc: Any = "upper right"
) -> None:
    """Draw a curve with a scale of its own on the right, in blue, beside one in red, from 0 on."""
    twin = ax.twinx()
    twin.set_ylabel(label)
    twin.plot(x, values, "--", color=HOUSE.blue, label=name)
    twin.set_ylim(0, 1.25 * float(np.nanmax(values, initial=1e-9)))
    for axes, colour in ((ax, HOUSE.vermilion), (twin, HOUSE.blue)):
        axes.yaxis.label.set_color(colour)
        axes.tick_params(axis="y", colors=colour)
    ax.legend(handles=[*ax.lines, *twin.lines], loc=loc, ncols=2)


@house()
def show_gains(
    light: PhotometricFit,
    ax: AxesOrNew = None,
    *,
    frames: IntArray | None = None,
    distance: FloatArray | None = None,
) -> Axes:
    """Show the gains, and how far away the sheet was.

    Parameters
    ----------
    light : PhotometricFit
    frames : (m,) int array, optional
        Numbers of the frames in the video; ``light.frames`` by default.
    distance : (m,) float array, optional
        Mean distance of each frame's samples, mm.
    """
    ax = decorate(ax, "Gain of each frame", "frame", "gain g [mm²]")
    frames = light.frames if frames is None else frames
    known = np.isfinite(light.gain_errors)
    gains = np.where(known, light.gains, np.nan)
    errors = np.where(known, light.gain_errors, np.nan)
    _show_band(ax, frames, gains - errors, gains + errors)
    ax.plot(frames, gains, ".-", color=HOUSE.vermilion, label="gain ± 1 s.e.")
    ax.set_ylim(0, 1.25 * float(np.nanmax(gains, initial=1e-9)))
    ax.legend(loc="upper right")
    if distance is not None:
        _show_second(ax, frames, distance, "mean distance of the sheet [mm]", "distance")
    return ax


@house()
def show_brdf(
    light: PhotometricFit,
    ax: AxesOrNew = None,
    *,
    samples: Samples | None = None,
    title: str = "BRDF of the paper",
) -> Axes:
    """Show the BRDF at its nodes with standard errors, beside a matt surface.

    Parameters
    ----------
    light : PhotometricFit
    samples : Samples, optional
        Those of the fit; how many lie at each angle is then drawn below.
    """
    ax = decorate(ax, title, "incidence θ [°]", "$f_r$ relative to the pinned node")
    theta, relative, errors = light.relative_brdf()
    degrees = np.rad2deg(theta)
    _shade_unseen(ax, degrees[0], degrees[-1])
    ax.axhline(1, color="black", lw=1.5, ls=":", label="Lambertian")
    ax.errorbar(degrees, relative, errors, label="fitted ± 1 s.e.", **POINTS)
    ax.margins(y=0.3)
    if samples is not None:
        incidence = np.arccos(np.minimum(samples.cos_theta[light.used], 1))
        count, bins = np.histogram(np.rad2deg(incidence), 30, (0, 90))
        below: Any = {"transform": ax.get_xaxis_transform(), "label": "samples"}
        heights = 0.2 * count / max(count.max(), 1)
        ax.bar(bins[:-1], heights, 3, align="edge", color=HOUSE.sky, alpha=0.8, **below)
    ax.legend(loc="upper right")
    return ax


@house()
def show_scores(scores: AngleErrors, ax: AxesOrNew = None) -> Axes:
    """Show by how much the measured fall-off differs from the model's, and by how many samples."""
    title = "Error of the fall-off, with samples"
    what = "measured/modelled light - 1 [%]"
    ax = decorate(ax, title, "angle α off the axis [°]", what)
    edges = np.rad2deg(scores.edges)
    half = np.diff(edges) / 2
    middle = edges[:-1] + half
    # Of a few samples too little is known to be drawn.
    error = 100 * np.where(scores.count >= LEAST_SCORED, scores.error, np.nan)
    ax.axhline(0, color="black", lw=1.2)
    ax.errorbar(middle, error, 100 * scores.standard_error, half, ls="none", **POINTS)
    ax.margins(y=0.15)
    ax.set(xlim=(0, edges[-1]), xticks=range(0, int(edges[-1]) + 1, 15))
    below: Any = {"transform": ax.get_xaxis_transform(), "color": "0.3", "size": "small"}
    for at, count in zip(middle, scores.count, strict=True):
        ax.text(at, 0.02, f"{count}", ha="center", **below)
    return ax


@house()
def show_ridge(
    fits: Sequence[PhotometricFit],
    ax: AxesOrNew = None,
    title: str = "What the samples know of γ",
) -> Axes:
    """Show how well fits with γ held at several values explain the samples, and the k that goes with each."""
    ax = decorate(ax, title, "γ", "σ of residuals [grey levels]")
    gammas = [fit.photometry.gamma for fit in fits]
    sigmas = [fit.sigma for fit in fits]
    ks = [fit.photometry.k for fit in fits]
    ax.plot(gammas, sigmas, "o-", color=HOUSE.vermilion, label="residuals")
    ax.set_ylim(0, 1.25 * max(sigmas))
    _show_second(ax, gammas, ks, "k that goes with it [1]", "k", "lower right")
    return ax
