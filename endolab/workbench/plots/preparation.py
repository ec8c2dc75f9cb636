"""The figure of a frame that was prepared: as it came, without μ′, what was masked, what is solved."""

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from endolab.frames.prepare import Prepared
from endolab.numerics.arrays import FloatArray
from endolab.workbench.plots.maps import show_picture
from endolab.workbench.plots.scales import in_colour
from endolab.workbench.plots.style import HOUSE, legend_below, page

MASK_COLOURS = {
    "outside": HOUSE.left_out,
    "lumen": to_rgb(HOUSE.blue),
    "highlights": to_rgb(HOUSE.green),
}


def prepare_figure(prepared: Prepared) -> Figure:
    """Draw the steps from a frame as it came to a frame that is solved, as the paper does.

    Returns
    -------
    Figure
        Four panels, 1600 px wide when saved; not one of pyplot's.
    """
    image = prepared.original.image
    tall = min(image.shape[0] / image.shape[1], 2.0)  # that a page stays one
    ready = "inpainted" if prepared.inpainted else "pixels to be solved"
    if prepared.undistorted:
        ready = f"undistorted, {ready}"
    inside = prepared.frame.mask[..., None]
    masked, patches = mask_overlay(prepared)
    with page(16, 14 * tall + 2.4) as figure:
        ((original, canonical), (masks, used)) = figure.subplots(2, 2)
        show_picture(_rgb(image), original, "Original")
        show_picture(_rgb(prepared.canonical), canonical, "Canonical")
        show_picture(masked, masks, "Masks")
        solved = np.where(inside, _rgb(prepared.frame.image), HOUSE.left_out)
        show_picture(solved, used, ready.capitalize())
        if patches:
            legend_below(masks, handles=patches)
    return figure


def mask_overlay(prepared: Prepared) -> tuple[FloatArray, list[Patch]]:
    """Paint what was masked over the frame, (H, W, 3), and name what occurs, with its share."""
    picture = _rgb(prepared.original.image)
    patches = []
    for name, colour in MASK_COLOURS.items():
        part = ~prepared.field_of_view if name == "outside" else getattr(prepared, name)
        if part.any():
            below = np.clip(picture[part], 0, 1)
            picture[part] = 0.25 * below + 0.75 * np.array(colour)
            # Of the picture, or of what the endoscope shows, as the notes have it.
            whole = 1 if name == "outside" else prepared.field_of_view.mean()
            label = f"{name}, {100 * part.mean() / whole:.2g} %"
            patches.append(Patch(color=colour, label=label))
    return picture, patches


def _rgb(picture: FloatArray) -> FloatArray:
    """Return a picture of three channels, grey where it is not known."""
    three = in_colour(picture)
    return np.where(np.isfinite(three).all(axis=-1, keepdims=True), three, HOUSE.left_out)
