"""What is done to a frame before it is solved."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from endolab.frames.boxes import flat_boxes
from endolab.frames.surround import SURE, dilate, field_of_view
from endolab.model.cameras import Camera
from endolab.model.photometry import CHANNELS, GREY_WEIGHTS
from endolab.numerics.arrays import BoolArray, FloatArray, freeze
from endolab.numerics.checks import mask_array, readonly_copy, real_array, unknown_name
from endolab.numerics.side_by_side import by_rows

# Stored values, as shares of their maximum.
SATURATED = 254.5 / 255  # from here on
ROUNDING = 0.3 / 255  # noise: that of rounding to 8 bits
# cos α; beyond 80°, cos^k α is so small that noise divided by it looks near.
LEAST_COSINE = float(np.cos(np.deg2rad(80.0)))


class Selection(NamedTuple):
    """What of a frame is to be used."""

    pixels: BoolArray  # (H, W), read-only
    # Share of a mask that is left out, as it surely lies beyond what the endoscope shows.
    misplaced: float = 0.0
    shown_share: float = 1.0  # of what the endoscope shows, that a mask keeps
    box_share: float = 0.0  # of the picture, that is left out as boxes of one colour


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture and the pixels of it that are to be used.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        Stored values over their maximum, in [0, 1], gamma-coded as read; channels R, G, B. A picture
        whose three channels are as good as one becomes (H, W), the grey that ITU-R BT.601 makes of them.
    mask : (H, W) bool array
        Pixels that take part.
    name : str
        What to call it in messages.
    silent : (H, W) bool array, optional
        Pixels of the mask that say nothing of the wall, such as ignored highlights: the surface goes
        on beneath them, without their evidence.
    is_linear : bool
        Whether its file says that values go with the light, γ 1.

    Raises
    ------
    ValueError
        If the image has a value that is not finite or outside [0, 1], if its shape is not that of a
        picture, if the mask has another size or is empty.

    Examples
    --------
    >>> import endolab as el
    >>> frame = el.load_traced("matt").frame
    >>> frame.resize(160, 120, 2.2).image.shape
    (120, 160, 3)
    """

    image: FloatArray
    mask: BoolArray
    name: str = "frame"
    silent: BoolArray | None = None
    is_linear: bool = False
    _resized: dict[tuple[int, int, float], Frame] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        image = real_array(f"{self.name}: the image", self.image)
        if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)) or not image.size:
            raise ValueError(
                f"{self.name}: expected a grey or RGB picture, found an array of shape {image.shape}"
            )
        high, wide = image.shape[:2]
        for what in ("mask", "silent"):
            given = getattr(self, what)
            if given is None and what == "silent":
                continue
            mask = mask_array(f"{self.name}: the {what}", given)
            if mask.shape != (high, wide):
                found = "x".join(map(str, mask.shape[::-1]))
                raise ValueError(
                    f"{self.name}: the {what} is {found} px, the frame {wide}x{high} px"
                )
            # A copy, as the caller's buffer may be the next frame's soon.
            object.__setattr__(self, what, readonly_copy(mask))
        if not self.mask.any():
            raise ValueError(f"{self.name}: the mask is empty, no pixel is left to use")
        used = image if self.mask.all() else image[self.mask]
        least = used.min()
        most = used.max()
        if not (least >= 0 and most <= 1):  # either is nan where any value is
            is_bytes = np.asarray(self.image).dtype == np.uint8
            remedy = "; divide bytes by 255" if is_bytes else ""
            raise ValueError(
                f"{self.name}: values must be finite and lie in [0, 1], "
                f"found {least:.4g} to {most:.4g}{remedy}"
            )
        if image.ndim == 3 and _is_grey(image, self.mask):
            image = image @ GREY_WEIGHTS
        object.__setattr__(self, "image", readonly_copy(image))

    @property
    def width(self) -> int:
        """Columns, px."""
        return self.image.shape[1]

    @property
    def height(self) -> int:
        """Rows, px."""
        return self.image.shape[0]

    @cached_property
    def selection(self) -> Selection:
        """Pixels to use, and what was left out to get them.

        A surround that the mask keeps is none of them; where the mask leaves nothing out, boxes of one colour
        are left out as well.
        """
        if self.mask.all():
            shown = field_of_view(self.image)
            boxes = shown & flat_boxes(self.image, shown)
            return Selection(freeze(shown & ~boxes), box_share=float(boxes.mean()))
        field = field_of_view(self.image, SURE)
        # A mask that follows the field's very edge, which is soft, is none that is misplaced.
        around = dilate(field, 0.03 * min(field.shape))
        beyond = (self.mask & ~around).sum() / self.mask.sum()
        seen = self.mask & field
        used = freeze(seen) if beyond > 0.05 and seen.any() else self.mask
        misplaced = 1 - float(used.sum() / self.mask.sum())
        return Selection(used, misplaced, float(seen.sum() / field.sum()))

    def channel(self, name: str | None = None) -> tuple[str, FloatArray]:
        """One channel of the picture, and its name: "red", "green", "blue" or "grey".

        Green by default, which neither saturates like red nor is as dark as blue; every channel of a grey
        picture is grey.
        """
        name = name or "green"
        if not isinstance(name, str) or name not in (*CHANNELS, "grey"):
            raise unknown_name("channel", name, (*CHANNELS, "grey"))
        if self.image.ndim == 2:
            return "grey", self.image
        if name == "grey":
            return name, self.image @ GREY_WEIGHTS
        return name, self.image[..., CHANNELS.index(name)]

    def resize(self, width: int, height: int, gamma: float) -> Frame:
        """Shrink the picture to a size, px, by averaging light, I^γ, which is not averaging stored values.

        Pixels of which less than half was in the mask are out of it; masked pixels do not enter the averages.
        A frame remembers the last few, for who solves it again and again.
        """
        key = width, height, gamma
        known = self._resized
        if key in known:
            return known[key]
        if not (1 <= width <= self.width and 1 <= height <= self.height):
            raise ValueError(
                f"{self.name}: cannot shrink {self.width}x{self.height} px to {width}x{height} px"
            )

        def shrink(a: FloatArray | BoolArray) -> FloatArray:
            whole = a.astype(np.float64, copy=False)
            resized = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
            return np.asarray(resized, dtype=np.float64)

        kept = shrink(self.mask) >= 0.5
        if not kept.any():
            raise ValueError(
                f"{self.name}: shrunk to {width}x{height} px, nothing of its mask is left"
            )
        # Where nothing is in the mask, the others are averaged.
        weight = np.where(self.mask, 1.0, 1e-12)
        whole = shrink(weight)

        def average_light(plane: FloatArray) -> FloatArray:
            light = power(np.clip(np.nan_to_num(plane), 0, 1), gamma)
            return np.clip(shrink(light * weight) / whole, 0.0, 1.0) ** (1 / gamma)

        # One by one: of twelve million pixels, 0.1 GB each.
        planes = np.moveaxis(np.atleast_3d(self.image), -1, 0)
        image = np.stack([average_light(plane) for plane in planes], axis=-1)
        silent = None if self.silent is None else shrink(self.silent) > 0
        shape = (height, width, *self.image.shape[2:])
        image = image.reshape(shape)
        small = Frame(image, kept, self.name, silent)
        # A picture in colour stays one, though its colours may have averaged out.
        object.__setattr__(small, "image", freeze(image))
        # Replaced, never changed, as another thread may look into it.
        last = dict([*self._resized.items()][-2:])
        object.__setattr__(self, "_resized", last | {key: small})
        return small


def _is_grey(image: FloatArray, mask: BoolArray) -> bool:
    """Whether the colours of most of what is lit, averaged over blocks without their noise, are one."""
    step = max(1, max(mask.shape) // 320)
    few = image[::step, ::step], mask[::step, ::step].astype(np.float64)
    high, wide = few[1].shape
    block = max(1, max(high, wide) // 40)
    size = max(1, wide // block), max(1, high // block)
    means, whole = (cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in few)
    colours = means[whole > 0.999]
    most = colours.max(axis=-1, initial=0.0)
    # Colours that differ by less are a white balance's, off by 2 % to either side, and a codec's.
    apart = most - colours.min(axis=-1, initial=1.0) - 0.04 * most
    lit = most > 0.99 * most.mean() if most.size else most > 0
    return bool(lit.any() and np.median(apart[lit]) < 3 / 255)


def check_size(
    name: str, size: tuple[int, int], camera: Camera, what: str = "calibration"
) -> None:
    """Raise a ValueError if a picture, (columns, rows), has not the size of the camera."""
    if size != (camera.width, camera.height):
        expected = f"the {what} is for {camera.width}x{camera.height} px"
        raise ValueError(f"{name} is {size[0]}x{size[1]} px, but {expected}")


def usable_pixels(
    image: FloatArray, mask: BoolArray, cos_alpha: FloatArray, name: str = "frame"
) -> BoolArray:
    """Pixels of a channel (stored values) from which a distance can be had.

    The mask without pixels that are outside the camera's field (cos α is nan there), more than 80° off its
    axis or as good as black (below 4 of 255). ValueError that names the frame, if none is left, or if what
    is left is constant or all saturated.
    """
    field = mask & (cos_alpha > LEAST_COSINE)
    if not field.any():
        raise ValueError(
            f"{name}: the mask and the camera's field of view have no pixel in common"
        )
    # Below this rounding and noise say more than the surface does.
    usable = field & (image > 4 / 255)
    if not usable.any():
        raise ValueError(
            f"{name}: the picture is all dark, its brightest pixel is {image[field].max() * 255:.2g} of 255; "
            "it may use fewer bits than the file, such as 10 of 16"
        )
    values = image[usable]
    if values.min() >= SATURATED:
        raise ValueError(f"{name}: the picture is fully saturated")
    if np.ptp(values) < 1e-6:  # shrinking rounds
        raise ValueError(
            f"{name}: the picture is constant, {values[0] * 255:.4g} of 255 everywhere"
        )
    return usable


def smooth_light(
    image: FloatArray, mask: BoolArray, gamma: float, sigma: float
) -> FloatArray:
    """Blur the light I^γ of a picture within a mask by a Gaussian of `sigma` px; not its stored values.

    The picture is as it was outside the mask.
    """
    if sigma <= 0:
        return image
    lit = power(np.where(mask, image, 0.0), gamma)
    light, share = (
        cv2.GaussianBlur(a, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        for a in (lit, mask.astype(np.float64))
    )
    mean = np.maximum(light / np.where(mask, share, 1.0), 0.0)
    return np.where(mask, power(mean, 1 / gamma), image)


def power(a: FloatArray, exponent: float) -> FloatArray:
    """Return a picture's values (H, W) or (H, W, 3) to a power."""
    out = np.empty(a.shape)
    by_rows(lambda rows: np.power(a[rows], exponent, out=out[rows]), a.shape)
    return out
