"""A real frame made ready: what it shows, what in it is not tissue, what it looks like without μ′."""

from dataclasses import dataclass

import cv2
import numpy as np

from endolab.frames.frame import DARK, LEAST_COSINE, Frame, check_size
from endolab.frames.highlights import find_highlights, inpaint
from endolab.frames.surround import dilate
from endolab.model.cameras import Camera, Pinhole
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_kinds, unknown_name
from endolab.numerics.noise import noise_level

TREATED = {
    "keep": "left to the solver",
    "ignore": "no evidence",
    "inpaint": "filled in from around",
}


@dataclass(frozen=True, eq=False)
class Prepared:
    """A frame that is ready to be solved, and what was found in it."""

    original: Frame  # as it came
    frame: Frame  # ready: its mask leaves out all that is not tissue
    canonical: FloatArray  # see `canonical_picture`
    field_of_view: BoolArray  # (H, W), what the endoscope shows
    lumen: BoolArray  # where noise says more than the wall
    highlights: (
        BoolArray  # mirrored light, and white letters on the screen, which look the same
    )
    notes: tuple[str, ...]  # what was found, in sentences


def dark_lumen(image: FloatArray, mask: BoolArray) -> BoolArray:
    """Find the depth of the lumen, where noise says more than the wall, within what the endoscope shows.

    Connected regions in which the signal of green is below five times the noise (or below 4 of 255): a
    distance is there uncertain by γ/10 from noise alone. Specks are left alone.
    """
    green = image if image.ndim == 2 else image[..., 1]
    green = np.where(mask, np.nan_to_num(green), 0.0)
    limit = max(DARK, 5 * noise_level(green, mask))
    calm, share = (
        cv2.blur(a, (5, 5), borderType=cv2.BORDER_CONSTANT)
        for a in (green, mask.astype(np.float64))
    )
    dark = mask & (calm < limit * share)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        dark.astype(np.uint8), connectivity=4
    )
    large = stats[:, cv2.CC_STAT_AREA] >= max(9, 2e-4 * mask.sum())
    return dark & large[labels]


def undistort_frame(frame: Frame, camera: Camera) -> tuple[Frame, Pinhole]:
    """Show a frame as a pinhole camera in its place would; returns the new frame and its camera.

    The new picture is 90° wide and as fine as the frame is at its centre, with its proportions. The mask
    leaves out what the old one left out or did not reach.
    """
    check_size(frame.name, (frame.width, frame.height), camera, "camera")
    axis = np.array([[0.0, 0.0, 1.0], [1e-4, 0.0, 1.0]])
    finest = float(np.linalg.norm(np.diff(camera.project(axis), axis=0)) / 1e-4)
    width = max(1, round(2 * finest))
    height = max(1, round(width * frame.height / frame.width))
    new = Pinhole(width, height, width / 2, width / 2, (width - 1) / 2, (height - 1) / 2)
    places = np.nan_to_num(camera.project(new.field.rays), nan=-9.0).astype(np.float32)

    def remap(a: FloatArray | BoolArray, border: int = cv2.BORDER_CONSTANT) -> FloatArray:
        x, y = places[..., 0], places[..., 1]
        values = a.astype(np.float64)
        return np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=border))

    image = np.clip(remap(np.nan_to_num(frame.image), cv2.BORDER_REPLICATE), 0.0, 1.0)
    mask = remap(frame.mask) > 0.999
    if not mask.any():
        raise ValueError(f"{frame.name}: the pinhole camera sees none of the frame's mask")
    silent = None if frame.silent is None else remap(frame.silent) > 0
    return Frame(image, mask, frame.name, silent), new


def canonical_picture(frame: Frame, calibration: Calibration) -> FloatArray:
    """Take μ′ = cos^k α out of a picture, for people to look at (paper, Section IV).

    I_c per channel to the power of 1/γ, in [0, 1]; the 90th percentile of the brightest channel is 0.9. nan
    outside the mask and more than 80° off the axis.
    """
    photometry = calibration.photometry.simplify()
    cosine = calibration.camera.field.cos_alpha
    seen = frame.mask & (cosine > LEAST_COSINE)
    if not seen.any():
        raise ValueError(
            f"{frame.name}: the mask and the camera's field of view have no pixel in common"
        )
    factor = np.where(seen, photometry.attenuation(np.where(seen, cosine, 1.0)), np.nan)
    picture = (frame.image.T / factor.T ** (1 / photometry.gamma)).T
    brightest = np.atleast_3d(picture).max(axis=-1)
    top = float(np.percentile(brightest[seen], 90))
    return np.clip(picture * (0.9 / top if top > 0 else 1.0), 0.0, 1.0)


def _share(part: BoolArray, whole: BoolArray) -> str:
    return f"{100 * part[whole].mean():.2g} % of what the endoscope shows"


@check_kinds(frame=Frame, calibration=Calibration)
def prepare(
    frame: Frame,
    calibration: Calibration,
    *,
    highlights: str = "keep",
) -> Prepared:
    """Make a real frame ready to be solved.

    Parameters
    ----------
    frame : Frame
        As it came; pixels outside its mask stay out. If it leaves nothing out, the black frame around
        what the endoscope shows is found and left out, as `endolab.reconstruct` does.
    calibration : Calibration
        Of the frame's size.
    highlights : {"keep", "ignore", "inpaint"}
        What `endolab.reconstruct` means by it: take them as they are; as no
        evidence (`Frame.silent`: the surface goes on beneath them); or filled in from around.

    Returns
    -------
    Prepared
        The frame to be solved, its masks, and notes on what was done.

    Raises
    ------
    ValueError
        If an option is unknown, sizes differ, or nothing is left to be solved.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("wet-1")
    >>> prepared = el.prepare(sample.frame, sample.calibration, highlights="inpaint")
    >>> prepared.highlights.shape
    (240, 320)
    """
    if highlights not in tuple(TREATED):
        raise unknown_name("way with highlights", highlights, TREATED)
    calibration = calibration.fit(frame.name, frame.width, frame.height)
    gamma = calibration.photometry.gamma
    image = np.nan_to_num(frame.image)
    field = frame.pixels_to_use()
    notes = [f"The endoscope shows {100 * field.mean():.0f} % of the picture."]
    if frame.misplaced:
        notes.append(
            f"{100 * frame.misplaced:.0f} % of the mask lies beyond what the endoscope shows, "
            "and is left out."
        )
    mirrored = find_highlights(image, field, gamma)
    lumen = dark_lumen(image, field) & ~mirrored
    if lumen.any():
        notes.append(
            f"Dark lumen, where noise says more than the wall: {_share(lumen, field)}."
        )
    if mirrored.any():
        share = _share(mirrored, field)
        notes.append(f"Highlights, or white letters: {share}, {TREATED[highlights]}.")
    canonical = canonical_picture(Frame(image, field, frame.name), calibration)
    if highlights == "inpaint" and mirrored.any():
        # Colour fringes around highlights must not be spread.
        fringe = 2 / 320 * max(frame.width, frame.height)
        image = inpaint(image, dilate(mirrored, fringe), field)
    silent = frame.silent
    if highlights == "ignore" and mirrored.any():
        silent = mirrored if silent is None else silent | mirrored
    ready = Frame(image, field & ~lumen, frame.name, silent)
    return Prepared(
        original=frame,
        frame=ready,
        canonical=canonical,
        field_of_view=field,
        lumen=lumen,
        highlights=mirrored,
        notes=tuple(notes),
    )
