"""The figure of a frame that was prepared: as it came, without μ′, what was masked, what is solved."""

import textwrap

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from endolab.frames.prepare import Prepared
from endolab.numerics.arrays import FloatArray
from endolab.solvers.result import Result
from endolab.workbench.plots.maps import (
    show_depth,
    show_normals,
    show_picture,
    show_section,
)
from endolab.workbench.plots.scales import in_colour, tallness
from endolab.workbench.plots.style import HOUSE, house

MASK_COLOURS = {
    "outside": HOUSE.left_out,
    "lumen": to_rgb(HOUSE.blue),
    "highlights": to_rgb(HOUSE.green),
}


def prepare_figure(prepared: Prepared, result: Result | None = None) -> Figure:
    """Draw the steps from a frame as it came to a frame that is solved, as the paper does.

    Parameters
    ----------
    prepared : Prepared
    result : Result, optional
        Of the prepared frame; its distance, normals and section fill a second row.

    Returns
    -------
    Figure
        Four panels a row, 1600 px wide when saved; not one of pyplot's.
    """
    image = prepared.original.image
    tall = tallness(image.shape)
    rows = 1 if result is None else 2
    ready = "Undistorted, " if prepared.undistorted else ""
    ready += "inpainted" if prepared.inpainted else "pixels to be solved"
    with house(HOUSE.page_text_size):
        figure = Figure(
            figsize=(16, rows * (3.7 * tall + 1.5) + 0.4), dpi=100, layout="constrained"
        )
        axes = figure.subplots(rows, 4, squeeze=False)
        show_picture(_rgb(image), axes[0, 0], "Original")
        show_picture(_rgb(prepared.canonical), axes[0, 1], "Canonical")
        picture, legend = mask_overlay(prepared)
        show_picture(picture, axes[0, 2], "Masks")
        patches = [
            Patch(color=MASK_COLOURS[name], label=label) for name, label in legend.items()
        ]
        if patches:
            # Below the picture, so that nothing of it is hidden.
            axes[0, 2].legend(
                handles=patches,
                loc="upper center",
                bbox_to_anchor=(0.5, -0.24),
                ncols=2,
                fontsize="small",
            )
        used = np.where(
            prepared.frame.mask[..., None], _rgb(prepared.frame.image), HOUSE.left_out
        )
        show_picture(used, axes[0, 3], ready[0].upper() + ready[1:])
        if result is not None:
            problem = result.iterate.problem
            show_depth(result.distance, axes[1, 0], unit=problem.unit)
            show_normals(result.normals, axes[1, 1])
            show_section(
                {"estimate": result.distance}, problem.field, axes[1, 2], unit=problem.unit
            )
            axes[1, 3].set_axis_off()
            lines = textwrap.TextWrapper(
                38, "· ", "  ", break_long_words=False, break_on_hyphens=False
            )
            text = "\n".join(lines.fill(note) for note in prepared.notes)
            axes[1, 3].text(
                0, 1, text, va="top", transform=axes[1, 3].transAxes, linespacing=1.5
            )
    return figure


def mask_overlay(prepared: Prepared) -> tuple[FloatArray, dict[str, str]]:
    """Paint what was masked over the frame, (H, W, 3), and name what occurs, with its share."""
    picture = _rgb(prepared.original.image)
    legend = {}
    for name, colour in MASK_COLOURS.items():
        part = ~prepared.field_of_view if name == "outside" else getattr(prepared, name)
        if part.any():
            below = np.clip(np.nan_to_num(picture[part]), 0, 1)
            picture[part] = 0.25 * below + 0.75 * np.array(colour)
            legend[name] = f"{name}, {100 * part.mean():.2g} %"
    return picture, legend


def _rgb(picture: FloatArray) -> FloatArray:
    """Return a picture of three channels, grey where it is not known."""
    three = in_colour(picture)
    return np.where(np.isfinite(three).all(axis=-1, keepdims=True), three, HOUSE.left_out)
