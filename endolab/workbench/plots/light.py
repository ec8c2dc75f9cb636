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

ALPHA = "angle α off the axis [°]"
# With their standard errors.
POINTS: Any = {"color": HOUSE.vermilion, "marker": "o", "capsize": 3}


def histogram(ax: AxesOrNew, title: str, unit: str, values: FloatArray) -> Axes:
    """Draw a histogram of residuals as a density, and the normal distribution as wide over it."""
    ax = decorate(ax, title, f"measured - predicted [{unit}]", f"density [1/{unit}]")
    mean = float(np.mean(values))
    sigma = float(np.std(values)) or 1.0
    x = mean + np.linspace(-4, 4, 301) * sigma
    label = f"{len(values)} values"
    ax.hist(values, x[::5].tolist(), density=True, color=HOUSE.sky, label=label)
    ax.plot(x, norm.pdf(x, mean, sigma), "--", color="black", label="Gaussian")
    ax.margins(y=0.3)
    ax.locator_params(axis="x", nbins=5)
    ax.legend(loc="upper right", ncols=2)
    return ax


def _over_angles(ax: AxesOrNew, title: str, x: str, y: str, seen: Any) -> Axes:
    """Give axes over angles of 0 to 90°; those beyond what was `seen`, rad, are shaded."""
    ax = decorate(ax, title, x, y)
    low, high = np.rad2deg(seen)
    ax.axvspan(0, low, color="0.88", lw=0, zorder=0)
    ax.axvspan(high, 90, color="0.88", lw=0, zorder=0)
    ax.set(xlim=(0, 90), xticks=range(0, 91, 15))
    return ax


def _show_counts(ax: Axes, count: IntArray, edges: FloatArray) -> None:
    """Draw how many samples there are between edges, at the bottom."""
    low: Any = {"transform": ax.get_xaxis_transform(), "color": HOUSE.sky, "alpha": 0.8}
    heights = 0.2 * count / max(count.max(), 1)
    ax.bar(edges[:-1], heights, np.diff(edges), align="edge", label="samples", **low)


def _show_beside(ax: Axes, x: Any, values: Any, label: str) -> None:
    """Draw a dashed curve in blue, with a scale of its own on the right, beside one in red."""
    twin = ax.twinx()
    twin.plot(x, values, "--", color=HOUSE.blue)
    twin.set_ylabel(label)
    for axes, colour in ((ax, HOUSE.vermilion), (twin, HOUSE.blue)):
        axes.set_ylim(bottom=0)
        axes.yaxis.label.set_color(colour)
        axes.tick_params(axis="y", colors=colour)


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
    ax = show_picture(image, ax, f"{title}: {len(samples)} in this frame")
    pixels = camera.project(samples.points)
    kind = 1 * (samples.material > 0)
    if used is not None:
        kind[~used] = 2
    fills = {"bare paper": HOUSE.vermilion, "grey patch": HOUSE.blue, "left out": "black"}
    for number, (label, fill) in enumerate(fills.items()):
        ax.plot(*pixels[kind == number].T, "o", ms=5, mfc=fill, mec="white", label=label)
    legend_below(ax)
    return ax


@house()
def show_light_residuals(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show how the residuals of the samples that counted are spread, with a Gaussian."""
    left_out = np.count_nonzero(~light.used)
    title = f"Residuals: ± {light.sigma:.2f} grey levels; {left_out} left out"
    return histogram(ax, title, "grey levels", light.residuals[light.used])


@house()
def show_fall_off(light: PhotometricFit, ax: AxesOrNew = None) -> Axes:
    """Show the joint vignetting and light spread cosᵏα beside cos⁴α.

    Angles at which there were no samples are shaded.
    """
    share = "share of the light on the axis"
    ax = _over_angles(ax, "Light's fall-off", ALPHA, share, light.alpha_range)
    alpha = np.linspace(0, 90, 361)
    cosine = np.cos(np.deg2rad(alpha)).clip(1e-9)
    ax.plot(alpha, cosine**4, color="black", lw=1.5, ls=":", label="cos⁴ α")
    label = f"cosᵏ α, k = {light.k:.3f} ± {light.standard_errors['k']:.3f}"
    ax.plot(alpha, cosine**light.k, color=HOUSE.vermilion, label=label)
    ax.set_ylim(0, 1.05)
    ax.legend(loc="upper right")
    return ax


@house()
def show_gains(
    light: PhotometricFit, ax: AxesOrNew = None, *, distance: FloatArray | None = None
) -> Axes:
    """Show the gains with their standard errors, and how far away the sheet was.

    Parameters
    ----------
    light : PhotometricFit
    distance : (m,) float array, optional
        Mean distance of the samples of each frame in ``light.frames``, mm.
    """
    ax = decorate(ax, "Gain of each frame", "located frame", "gain g ± s.e. [mm²]")
    known = np.isfinite(light.gain_errors)
    gains = np.where(known, light.gains, np.nan)
    ax.errorbar(light.frames, gains, light.gain_errors, **POINTS)
    ax.set_ylim(bottom=0)
    ax.locator_params(axis="x", integer=True)
    if distance is not None:
        _show_beside(ax, light.frames, distance, "mean distance of the sheet [mm]")
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
    theta, relative, errors = light.relative_brdf()
    relation = "$f_r$ relative to the pinned node"
    ax = _over_angles(ax, title, "incidence θ [°]", relation, theta[[0, -1]])
    ax.axhline(1, color="black", lw=1.5, ls=":", label="Lambertian")
    ax.errorbar(np.rad2deg(theta), relative, errors, label="fitted ± 1 s.e.", **POINTS)
    ax.margins(y=0.3)
    if samples is not None:
        incidence = np.arccos(np.minimum(samples.cos_theta[light.used], 1))
        _show_counts(ax, *np.histogram(np.rad2deg(incidence), 30, (0, 90)))
    ax.legend(loc="upper right")
    return ax


@house()
def show_scores(scores: AngleErrors, ax: AxesOrNew = None) -> Axes:
    """Show by how much the measured fall-off differs from the model's, and by how many samples."""
    ax = decorate(ax, "Error of the fall-off", ALPHA, "measured/modelled light - 1 [%]")
    edges = np.rad2deg(scores.edges)
    half = np.diff(edges) / 2
    # Of a few samples too little is known to be drawn.
    error = 100 * np.where(scores.count >= LEAST_SCORED, scores.error, np.nan)
    ax.axhline(0, color="black", lw=1.2)
    middle = edges[:-1] + half
    spread = 100 * scores.standard_error
    ax.errorbar(middle, error, spread, half, ls="none", **POINTS)
    ax.margins(y=0.3)
    _show_counts(ax, scores.count, edges)
    ax.set(xlim=(0, edges[-1]), xticks=range(0, int(edges[-1]) + 1, 15))
    ax.legend(loc="upper right")
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
    ax.plot(gammas, [fit.sigma for fit in fits], "o-", color=HOUSE.vermilion)
    ks = [fit.photometry.k for fit in fits]
    _show_beside(ax, gammas, ks, "k that goes with it [1]")
    return ax
