"""A real frame made ready: what it shows, what in it is not tissue, what it looks like without μ′."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from endolab.frames.frame import FRAME_LIMITS, Frame, check_size, large_parts, noise_level
from endolab.frames.highlights import (
    check_highlights,
    dilate,
    find_highlights,
    inpaint,
)
from endolab.model.cameras import Camera, Pinhole
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class PreparationLimits:
    """What in a real frame is no tissue."""

    # Signal over noise below which noise alone moves a distance by γ/10, about a fifth.
    least_signal: float = 5.0
    combed: float = 0.05  # combing from which on a frame is taken for interlaced
    # Of the longer side: colour fringes around highlights, which inpainting must not
    # spread.
    halo: float = 2 / 320
    paper_white: float = 0.6  # least value of text
    pale: float = 0.08  # most colour of text
    stands_out: float = 0.2  # contrast of text
    apart: float = 32 / 255  # of signs in the surround, their contrast to it
    letters: int = 4  # as many of one height and colour in a row make a text


PREPARATION = PreparationLimits()


@dataclass(frozen=True)
class Prepared:
    """A frame that is ready to be solved, and what was found in it."""

    original: Frame  # as it came
    frame: (
        Frame  # ready: its mask leaves out all that is not tissue; on the grid of `camera`
    )
    camera: (
        Camera  # the calibration's own, or the pinhole to which the frame was undistorted
    )
    canonical: (
        FloatArray  # see `canonical_picture`; on the original grid, as are the masks below
    )
    field_of_view: BoolArray  # (H, W), what the endoscope shows
    lumen: BoolArray  # where noise says more than the wall
    highlights: BoolArray  # mirrored light
    text: BoolArray  # letters
    interlaced: bool  # whether two fields were found and one of them was replaced
    undistorted: bool
    inpainted: bool
    notes: tuple[str, ...]  # what was found, in sentences


def _brightest(image: FloatArray) -> FloatArray:
    return image if image.ndim == 2 else image.max(axis=-1)


def _green(image: FloatArray) -> FloatArray:
    return image if image.ndim == 2 else image[..., 1]


def dark_lumen(image: FloatArray, mask: BoolArray) -> BoolArray:
    """Find the depth of the lumen, where noise says more than the wall, within what the endoscope shows.

    Connected regions in which the signal of green is below five times the noise (or below 4 of 255): a
    distance is there uncertain by γ/10 from noise alone. Specks are left alone.
    """
    green = np.where(mask, np.nan_to_num(_green(image)), 0.0)
    limit = max(FRAME_LIMITS.dark, PREPARATION.least_signal * noise_level(green, mask))
    share = cv2.blur(mask.astype(np.float64), (5, 5), borderType=cv2.BORDER_CONSTANT)
    calm = cv2.blur(green, (5, 5), borderType=cv2.BORDER_CONSTANT) / np.where(
        mask, share, 1.0
    )
    return large_parts(mask & (calm < limit), max(9, 2e-4 * mask.sum()))


def _rows_of_letters(boxes: list[tuple[int, int, int, int, float]]) -> list[list[int]]:
    """Group boxes (left, top, width, height, value) that stand in a row, like letters."""
    rows: list[list[int]] = []
    for index in sorted(range(len(boxes)), key=lambda i: boxes[i][0]):
        left, top, _, high, value = boxes[index]
        for row in rows:
            last = boxes[row[-1]]
            tall = max(high, last[3])
            aligned = abs(top + high - last[1] - last[3]) <= 0.25 * tall
            similar = abs(high - last[3]) <= 0.25 * tall and abs(value - last[4]) <= 4 / 255
            if (
                aligned
                and similar
                and -0.2 * tall <= left - last[0] - last[2] <= 1.5 * tall
            ):
                row.append(index)
                break
        else:
            rows.append([index])
    return [row for row in rows if len(row) >= PREPARATION.letters]


def overlay_text(image: FloatArray, mask: BoolArray) -> BoolArray:
    """Find text that a video system has written over the picture; the mask is what the endoscope shows.

    Islands in the flat surround of the picture, and rows of at least four pale marks of one height and
    value on one line. Highlights are pale too, but stand in no row; a single sign within the picture is not
    found.
    """
    shade = np.nan_to_num(_brightest(image))
    apart = ~dilate(mask, 4)
    if apart.any():
        apart &= np.abs(shade - np.median(shade[apart])) > PREPARATION.apart
    text = dilate(apart, 1) & ~mask if apart.any() else apart
    pale = image if image.ndim == 2 else np.nan_to_num(image).min(axis=-1)
    reach = 2 * max(4, max(image.shape[:2]) // 60) + 1
    stroke = cv2.morphologyEx(pale, cv2.MORPH_OPEN, np.ones((reach, reach), np.uint8))
    marks = (
        (pale > PREPARATION.paper_white)
        & (shade - pale < PREPARATION.pale)
        & (pale - stroke > PREPARATION.stands_out)
    )
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        marks.astype(np.uint8), connectivity=8
    )
    boxes = []
    for label in range(1, count):
        left, top, wide, high = (int(value) for value in stats[label, :4])
        if high >= 5 and wide <= 3 * high and high <= image.shape[0] / 8:
            window = (slice(top, top + high), slice(left, left + wide))
            boxes.append(
                (left, top, wide, high, float(pale[window][labels[window] == label].max()))
            )
    for row in _rows_of_letters(boxes):
        tall = max(boxes[i][3] for i in row)
        top = min(boxes[i][1] for i in row)
        bottom = max(boxes[i][1] + boxes[i][3] for i in row)
        left = boxes[row[0]][0]
        right = boxes[row[-1]][0] + boxes[row[-1]][2]
        line = np.zeros(mask.shape, dtype=bool)
        line[
            max(0, top - tall // 2) : bottom + tall // 2, max(0, left - tall) : right + tall
        ] = True
        text |= dilate(marks & line, max(2.0, 0.1 * tall))
    return text


def is_interlaced(image: FloatArray, mask: BoolArray) -> bool:
    """Tell whether a frame is made of two fields that show a moving scene, as its odd and even rows differ.

    By the share of the picture in which neighbouring rows of green differ more than every second, less the
    share in which columns do: about 0 in a picture that was taken at once, since nothing in a scene, nor
    noise, makes near rows less alike than far ones.
    """
    green = np.where(mask, np.nan_to_num(_green(image)), 0.0)
    inside = cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=0) > 0
    shares = []
    for rows, known in ((green, inside), (green.T, inside.T)):
        if len(rows) < 3 or not known[1:-1].any():
            return False
        of_rows = cv2.blur((rows[1:-1] - rows[:-2]) ** 2, (15, 15))
        two = cv2.blur((rows[2:] - rows[:-2]) ** 2, (15, 15))
        shares.append(float((of_rows > 1.2 * two + (1 / 255) ** 2)[known[1:-1]].mean()))
    return shares[0] - shares[1] >= PREPARATION.combed


def deinterlace(image: FloatArray) -> FloatArray:
    """Keep the field of the even rows (0, 2, …) and interpolate the other."""
    image = np.array(image, dtype=np.float64)
    odd = np.arange(1, len(image), 2)
    last = (len(image) - 1) // 2 * 2
    image[odd] = (image[odd - 1] + image[np.minimum(odd + 1, last)]) / 2
    return image


def undistort_frame(
    frame: Frame, camera: Camera, fov: float = 90.0, *, crop: bool = False
) -> tuple[Frame, Pinhole]:
    """Show a frame as a pinhole camera in its place would; returns the new frame and its camera.

    `fov` is the angle that the new width spans, degrees, below 170; the new picture is as fine as the frame
    is at its centre, with its proportions. `crop` cuts off rows and columns in which nothing is seen. The
    mask leaves out what the old one left out or did not reach.
    """
    if not 0 < fov < 170:
        raise ValueError(f"fov must be between 0 and 170 degrees, got {fov}")
    check_size(frame.name, (frame.width, frame.height), camera, "camera")
    half = np.tan(np.deg2rad(fov) / 2)
    axis = np.array([[0.0, 0.0, 1.0], [1e-4, 0.0, 1.0]])
    finest = float(np.linalg.norm(np.diff(camera.project(axis), axis=0)) / 1e-4)
    width = max(1, round(2 * half * finest))
    height = max(1, round(width * frame.height / frame.width))
    focal = width / (2 * half)
    new = Pinhole(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    columns, rows = np.moveaxis(
        np.nan_to_num(camera.project(new.field.rays), nan=-9.0), -1, 0
    )
    maps = columns.astype(np.float32), rows.astype(np.float32)

    def remap(a: FloatArray | BoolArray, border: int = cv2.BORDER_CONSTANT) -> FloatArray:
        remapped = cv2.remap(
            a.astype(np.float64), *maps, cv2.INTER_LINEAR, borderMode=border
        )
        return np.asarray(remapped, dtype=np.float64)

    image = np.clip(remap(np.nan_to_num(frame.image), cv2.BORDER_REPLICATE), 0.0, 1.0)
    mask = remap(frame.mask) > 0.999
    if not mask.any():
        raise ValueError(f"{frame.name}: the pinhole camera sees none of the frame's mask")
    silent = None if frame.silent is None else remap(frame.silent) > 0
    if not crop:
        return Frame(image, mask, frame.name, silent), new
    left, top, wide, high = cv2.boundingRect(mask.astype(np.uint8))
    window = (slice(top, top + high), slice(left, left + wide))
    silent = None if silent is None else silent[window]
    return Frame(image[window], mask[window], frame.name, silent), new.crop(
        left, top, wide, high
    )


def canonical_picture(frame: Frame, calibration: Calibration) -> FloatArray:
    """Take μ′ = cos^k α out of a picture, for people to look at (paper, Section IV).

    I_c per channel to the power of 1/γ, in [0, 1]; the 90th percentile of the brightest channel is 0.9. nan
    outside the mask and more than 80° off the axis.
    """
    photometry = calibration.photometry.simplify()
    cosine = calibration.camera.field.cos_alpha
    seen = frame.mask & (
        np.nan_to_num(cosine, nan=-1.0) > np.cos(np.deg2rad(FRAME_LIMITS.max_alpha))
    )
    if not seen.any():
        raise ValueError(
            f"{frame.name}: the mask and the camera's field of view have no pixel in common"
        )
    factor = np.where(seen, photometry.attenuation(np.where(seen, cosine, 1.0)), np.nan)
    factor **= 1 / photometry.gamma
    picture = frame.image / (factor if frame.image.ndim == 2 else factor[..., None])
    top = float(np.percentile(_brightest(picture)[seen], 90))
    return np.clip(picture * (0.9 / top if top > 0 else 1.0), 0.0, 1.0)


def _share(part: BoolArray, whole: BoolArray) -> str:
    return f"{100 * part[whole].mean():.2g} % of what the endoscope shows"


def prepare(
    frame: Frame,
    calibration: Calibration,
    *,
    undistort: bool = False,
    highlights: str | None = None,
) -> Prepared:
    """Make a real frame ready to be solved.

    Parameters
    ----------
    frame : Frame
        As it came; pixels outside its mask stay out. If it leaves nothing out, the black frame around
        what the endoscope shows is found and left out, as `endolab.reconstruct` does.
    calibration : Calibration
        Of the frame's size.
    undistort : bool
        Whether to resample to a pinhole camera of 90°; solvers do not need it.
    highlights : {"keep", "ignore", "inpaint"}, optional
        What `endolab.reconstruct` means by it: take them as they are, which is the default; as no
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
    highlights = check_highlights(highlights)
    camera = calibration.camera
    gamma = calibration.photometry.gamma
    check_size(frame.name, (frame.width, frame.height), camera)
    notes = []
    image = np.nan_to_num(frame.image)
    field = frame.pixels_to_use()
    if not field.any():
        raise ValueError(f"{frame.name}: the frame shows nothing but black")
    notes.append(f"The endoscope shows {100 * field.mean():.0f} % of the picture.")
    if frame.misplaced:
        beyond = f"{100 * frame.misplaced:.0f} % of the mask"
        notes.append(f"{beyond} lies beyond what the endoscope shows, and is left out.")
    fields = is_interlaced(image, field)
    if fields:
        image = deinterlace(image)
        notes.append(
            "Two interlaced fields: the even rows are kept, the odd ones interpolated."
        )
    text = overlay_text(image, field)
    if text.any():
        notes.append(
            f"Text or signs on the screen: {int(text.sum())} px, {_share(text, field)}."
        )
    tissue = field & ~text
    if not tissue.any():
        raise ValueError(f"{frame.name}: nothing but text is left of the frame")
    mirrored = find_highlights(image, tissue, gamma)
    lumen = dark_lumen(image, tissue)
    lumen &= ~mirrored
    if lumen.any():
        notes.append(
            f"Dark lumen, where noise says more than the wall: {_share(lumen, field)}."
        )
    treated = {
        "ignore": "no evidence",
        "inpaint": "filled in from around",
        "keep": "left to the solver",
    }
    if mirrored.any():
        notes.append(f"Highlights: {_share(mirrored, field)}, {treated[highlights]}.")
    canonical = canonical_picture(Frame(image, field, frame.name), calibration)
    mask = tissue & ~lumen
    inpainted = highlights == "inpaint" and bool(mirrored.any())
    if inpainted:
        image = inpaint(
            image,
            dilate(mirrored, PREPARATION.halo * max(frame.width, frame.height)) & tissue,
            tissue,
        )
    silent = frame.silent
    if highlights == "ignore" and mirrored.any():
        silent = mirrored if silent is None else silent | mirrored
    ready = Frame(image, mask, frame.name, silent)
    if undistort:
        ready, camera = undistort_frame(ready, camera)
        notes.append(
            f"Undistorted to a pinhole camera of {camera.width}x{camera.height} px, 90° across."
        )
    done: dict[str, Any] = {
        "field_of_view": field,
        "lumen": lumen,
        "highlights": mirrored,
        "text": text,
    }
    done |= {"interlaced": fields, "undistorted": undistort, "inpainted": inpainted}
    return Prepared(frame, ready, camera, canonical, **done, notes=tuple(notes))
