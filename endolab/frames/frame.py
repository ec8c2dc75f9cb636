"""What is done to a frame before it is solved."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.frames.surround import SURE, field_of_view
from endolab.model.cameras import Camera
from endolab.model.photometry import CHANNELS, GREY_WEIGHTS
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import BoolArray, FloatArray, freeze
from endolab.numerics.checks import mask_array, readonly_copy, real_array
from endolab.numerics.noise import noise_level
from endolab.numerics.side_by_side import by_rows


@dataclass(frozen=True)
class FrameLimits:
    """What pixels and masks must be to be used; stored values are shares of their maximum."""

    dark: float = 4 / 255  # below this rounding and noise say more than the surface does
    bright: float = 254.5 / 255  # from here on it is saturated
    rounding: float = 0.3 / 255  # noise: that of rounding to 8 bits
    least_range: float = 1e-6  # of stored values; a picture with less is constant
    # Degrees; beyond, cos^k α is so small that noise divided by it looks near.
    max_alpha: float = 80.0
    # Share of a mask beyond what the endoscope shows, from which on it is no rounded
    # edge.
    misplaced: float = 0.05
    # Of the shorter side, within which a mask may lie beyond the field all the same.
    edge: float = 0.03
    levels: int = 64  # of a mask, or of some other drawing, there are fewer
    remembered: int = 3  # sizes of a frame


FRAME_LIMITS = FrameLimits()
ROUNDING = 0.3 / 255  # noise: that of rounding to 8 bits


@dataclass(frozen=True)
class Frame:
    """A picture and the pixels of it that are to be used.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) float array
        Stored values over their maximum, in [0, 1], gamma-coded as read; channels R, G, B.
    mask : (H, W) bool array
        Pixels that take part.
    name : str
        What to call it in messages.
    silent : (H, W) bool array, optional
        Pixels of the mask that say nothing of the wall, such as ignored highlights: the surface goes
        on beneath them, without their evidence.

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
    _resized: dict[tuple[int, int, float], Frame] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        image = real_array(f"{self.name}: the image", self.image)
        if image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)) or not image.size:
            raise ValueError(
                f"{self.name}: expected a grey or RGB picture, found an array of shape {image.shape}"
            )
        object.__setattr__(self, "mask", self._check_mask("mask", self.mask, image))
        if self.silent is not None:
            object.__setattr__(
                self, "silent", self._check_mask("silent", self.silent, image)
            )
        if not self.mask.any():
            raise ValueError(f"{self.name}: the mask is empty, no pixel is left to use")
        used = image if self.mask.all() else image[self.mask]
        low = used.min()
        high = used.max()
        if not (low >= 0 and high <= 1):  # either is nan where any value is
            is_bytes = np.asarray(self.image).dtype == np.uint8
            remedy = "; divide bytes by 255" if is_bytes else ""
            raise ValueError(
                f"{self.name}: values must be finite and lie in [0, 1], "
                f"found {low:.4g} to {high:.4g}{remedy}"
            )
        object.__setattr__(self, "image", readonly_copy(image))

    def _check_mask(self, what: str, given: BoolArray, image: FloatArray) -> BoolArray:
        """Return a copy, as the caller's buffer may be the next frame's soon."""
        mask = mask_array(f"{self.name}: the {what}", given)
        if mask.shape != image.shape[:2]:
            high, wide = image.shape[:2]
            found = "x".join(map(str, mask.shape[::-1]))
            raise ValueError(
                f"{self.name}: the {what} is {found} px, the frame {wide}x{high} px"
            )
        return readonly_copy(mask)

    @property
    def width(self) -> int:
        """Columns, px."""
        return self.image.shape[1]

    @property
    def height(self) -> int:
        """Rows, px."""
        return self.image.shape[0]

    def pixels_to_use(self) -> BoolArray:
        """Pixels to use, (H, W): the mask, without a surround that it keeps. Read-only."""
        return self._pixels_to_use

    @property
    def misplaced(self) -> float:
        """Share of a mask that is left out, as it surely lies beyond what the endoscope shows."""
        if self.mask.all():
            return 0.0
        return 1 - float(self._pixels_to_use.sum() / self.mask.sum())

    @cached_property
    def _pixels_to_use(self) -> BoolArray:
        if self.mask.all():
            return freeze(field_of_view(self.image))
        field = field_of_view(self.image, SURE)
        # A mask that follows the field's very edge, which is soft, is none that is misplaced.
        reach = 2 * round(FRAME_LIMITS.edge * min(field.shape)) + 1
        around = cv2.dilate(field.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
        beyond = (self.mask & ~around).sum() / self.mask.sum()
        seen = self.mask & field
        return freeze(seen) if beyond > FRAME_LIMITS.misplaced and seen.any() else self.mask

    def channel(self, name: str | None = None) -> tuple[str, FloatArray]:
        """One channel of the picture, and its name: "red", "green", "blue" or "grey".

        Green by default, which neither saturates like red nor is as dark as blue; a grey picture has grey
        alone.
        """
        if self.image.ndim == 2:
            if name not in (None, "grey"):
                raise ValueError(
                    f"{self.name}: the picture is grey and has no {name} channel; choose grey"
                )
            return "grey", self.image
        name = name or "green"
        if name == "grey":
            return name, self.image @ GREY_WEIGHTS
        if not isinstance(name, str) or name not in CHANNELS:
            raise unknown_name("channel", name, (*CHANNELS, "grey"))
        return name, self.image[..., CHANNELS.index(name)]

    def resize(self, width: int, height: int, gamma: float) -> Frame:
        """Shrink the picture to a size, px, by averaging light, I^γ, which is not averaging stored values.

        Pixels of which less than half was in the mask are out of it; masked pixels do not enter the averages.
        A frame remembers the last few, for who solves it again and again.
        """
        key = (width, height, gamma)
        resized = self._resized  # never changed: other threads read it
        if key not in resized:
            resized = dict([*resized.items()][1 - FRAME_LIMITS.remembered :]) | {
                key: self._shrink(width, height, gamma)
            }
            object.__setattr__(self, "_resized", resized)
        return resized[key]

    def _shrink(self, width: int, height: int, gamma: float) -> Frame:
        if not (1 <= width <= self.width and 1 <= height <= self.height):
            raise ValueError(
                f"{self.name}: cannot shrink {self.width}x{self.height} px to {width}x{height} px"
            )

        def shrink(a: FloatArray | BoolArray) -> FloatArray:
            whole = a.astype(np.float64, copy=False)  # of twelve million pixels, 0.3 GB
            resized = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
            return np.asarray(resized, dtype=np.float64)

        share = shrink(self.mask)
        kept = share >= 0.5
        whole = self.mask.all()
        if not kept.any():
            raise ValueError(
                f"{self.name}: shrunk to {width}x{height} px, nothing of its mask is left"
            )
        part = np.where(kept, share, 1.0)

        def average_light(channel: FloatArray) -> FloatArray:
            inside = channel if whole else np.where(self.mask, channel, 0.0)
            light = shrink(power(inside, gamma)) / part
            if not kept.all():
                outside = np.clip(np.nan_to_num(channel), 0, 1)
                light = np.where(kept, light, shrink(power(outside, gamma)))
            return np.clip(light, 0.0, 1.0) ** (1 / gamma)

        # One by one: of twelve million pixels, 0.1 GB each.
        channels = [
            average_light(plane) for plane in np.moveaxis(np.atleast_3d(self.image), -1, 0)
        ]
        silent = None if self.silent is None else shrink(self.silent) > 0
        image = np.stack(channels, axis=-1).reshape(height, width, *self.image.shape[2:])
        return Frame(image, kept, self.name, silent)


def shrink_bytes(
    stored: NDArray[np.uint8], width: int, height: int, gamma: float
) -> FloatArray:
    """What `Frame.resize` makes of a picture of bytes without a mask, in the time between a camera's frames.

    In single precision, to 1e-6: light is looked up in a table of 256.
    """
    light = (np.arange(256) / 255).astype(np.float32) ** np.float32(gamma)
    mean = cv2.resize(cv2.LUT(stored, light), (width, height), interpolation=cv2.INTER_AREA)
    return np.clip(mean.astype(np.float64), 0.0, 1.0) ** (1 / gamma)


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
    field = mask & (cos_alpha > np.cos(np.deg2rad(FRAME_LIMITS.max_alpha)))
    if not field.any():
        raise ValueError(
            f"{name}: the mask and the camera's field of view have no pixel in common"
        )
    bright = field & (image > FRAME_LIMITS.dark)
    if not bright.any():
        raise ValueError(
            f"{name}: the picture is all dark, its brightest pixel is {image[field].max() * 255:.2g} of 255; "
            "it may use fewer bits than the file, such as 10 of 16"
        )
    if np.all(image[bright] >= FRAME_LIMITS.bright):
        raise ValueError(f"{name}: the picture is fully saturated")
    if np.ptp(image[bright]) < FRAME_LIMITS.least_range:  # shrinking rounds
        raise ValueError(
            f"{name}: the picture is constant, {image[bright][0] * 255:.4g} of 255 everywhere"
        )
    return bright


def large_parts(region: BoolArray, least: float) -> BoolArray:
    """Return the connected parts of a region that have at least so many pixels."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        region.astype(np.uint8), connectivity=4
    )
    large = stats[:, cv2.CC_STAT_AREA] >= least
    large[0] = False
    return large[labels]


def looks_like_depth(image: FloatArray) -> bool:
    """Whether a picture is so like a depth map that it may be one: grey, of many values, without noise.

    A camera's picture of 8 bits has the noise of their rounding at least, 0.3 grey levels; the depth maps
    of C3VD and SimCol3D have 0.001 and 0.03.
    """
    if image.ndim == 3:
        return False
    noise = noise_level(image, image > 0)
    return (
        0 < noise < FRAME_LIMITS.rounding / 3
        and len(np.unique(image)) > FRAME_LIMITS.levels
    )


def smooth_light(
    image: FloatArray, mask: BoolArray, gamma: float, sigma: float
) -> FloatArray:
    """Blur the light I^γ of a picture within a mask by a Gaussian of `sigma` px; not its stored values.

    The picture is as it was outside the mask.
    """
    if sigma <= 0:
        return image
    lit = power(np.where(mask, image, 0.0), gamma)
    around = cv2.BORDER_CONSTANT
    light = cv2.GaussianBlur(lit, (0, 0), sigma, borderType=around)
    share = cv2.GaussianBlur(mask.astype(np.float64), (0, 0), sigma, borderType=around)
    out = np.empty(image.shape)

    def store(rows: slice) -> None:
        inside = mask[rows]
        mean = np.maximum(light[rows] / np.where(inside, share[rows], 1.0), 0.0)
        out[rows] = np.where(inside, mean ** (1 / gamma), image[rows])

    by_rows(store, mask.shape)
    return out


def power(a: FloatArray, exponent: float) -> FloatArray:
    """Return a picture's values (H, W) or (H, W, 3) to a power."""
    out = np.empty(a.shape)
    by_rows(lambda rows: np.power(a[rows], exponent, out=out[rows]), a.shape)
    return out
