"""A patch of another colour on a wall, as a stain or a painted polyp, which a solver takes for relief."""

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates
from skimage.measure import label, regionprops

from endolab.metrics.contrast import noise_left, residual_of
from endolab.solvers.result import Result

DIRECTIONS = np.linspace(0, 2 * np.pi, 48, endpoint=False)  # from a patch's middle


def find_patch(
    result: Result,
    *,
    strong: float = 7.0,
    sizes: tuple[float, float] = (0.004, 0.3),
    rim: int = 3,
    reach: int = 8,
    misfit: float = 0.4,
) -> tuple[float, float, float] | None:
    """Return column and row, px, of a patch's middle, and its albedo over that around it; None without one.

    The residual has a closed ring, `strong` times the noise, around a share of the pixels in `sizes`: no
    surface follows a step. So it has around a lumen or a tube's end; but the picture of a patch is that of
    the wall times one factor, so that all around log I steps by as much, and its slope goes on. This holds,
    from `rim` to `reach` px beyond to both sides, to within the share `misfit` of the step: .09 to .31 for
    painted discs, .59 and more for 34 pictures without one, of cavities and of scenes.
    """
    problem = result.problem
    residual = residual_of(result.iterate)
    light = np.log(np.maximum(problem.image, 1e-3))
    light[np.isnan(residual)] = np.nan
    residual = np.nan_to_num(residual)
    regions = label(np.abs(residual) <= strong * noise_left(result)[0], connectivity=1)
    s = np.arange(-rim - reach, rim + reach + 1)
    s = s[np.abs(s) > rim]
    # log I = a + b s, and on the patch + c + d s.
    terms = np.stack([s**0, s, s < 0, s * (s < 0)], axis=-1)
    for region in regionprops(regions):
        if not sizes[0] < region.area / np.count_nonzero(problem.mask) < sizes[1]:
            continue
        inside = regions == region.label
        if inside[~problem.mask].any():
            continue
        row, column = region.centroid
        radius = np.arange(np.ceil(region.axis_major_length) + 4 * reach)
        places = [
            row + np.outer(np.sin(DIRECTIONS), radius),
            column + np.outer(np.cos(DIRECTIONS), radius),
        ]
        lights, steps, insides = (
            map_coordinates(one, places, order=1, cval=np.nan)
            for one in (light, residual, inside.astype(float))
        )
        steps = np.abs(np.gradient(gaussian_filter1d(steps, 1), axis=1))
        last = radius.size - 1 - np.argmax(insides[:, ::-1] > 0.5, axis=1)
        first = last[:, None] - 2  # in each direction; the rim is where the residual steps
        near = (first + np.arange(2 * reach + 2)).clip(0, radius.size - 1)
        at = np.argmax(np.take_along_axis(steps, near, axis=1), axis=1, keepdims=True)
        around = first + at + s
        seen = np.take_along_axis(lights, around.clip(0, radius.size - 1), axis=1)
        whole = np.isfinite(seen).all(axis=1) & (around[:, 0] > 0)
        if np.mean(whole) < 0.8:
            continue
        *_, step, slope = np.linalg.lstsq(terms, seen[whole].T, rcond=None)[0]
        usual = np.median(step)
        off = np.abs(step - usual) + np.abs(slope) * reach / 2
        if np.percentile(off, 80) < misfit * abs(usual):
            return column, row, float(np.exp(problem.photometry.gamma * usual))
    return None
