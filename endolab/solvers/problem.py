"""A frame to be explained: everything a solver needs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from endolab.model.cameras import Camera, RayField
from endolab.model.photometry import Photometry
from endolab.model.surface import XI, to_xi
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import (
    excerpt,
    mask_array,
    number,
    readonly_copy,
    real_array,
    unknown_name,
)
from endolab.numerics.noise import noise_level
from endolab.numerics.stencils import differences, px_per_reference
from endolab.solvers.provenance import Report

REGULARISERS = ("first", "second")  # in the order of the kinds of `numerics.stencils`
# What a pixel's value says of the surface's: see `Problem`.
EXACT, LOWER_BOUND, NONE = range(3)


@dataclass(frozen=True, eq=False)
class Problem:
    """A frame to be explained: everything a solver needs, and nothing it must look up."""

    image: FloatArray  # (H, W), stored values of one channel in [0, 1]
    mask: BoolArray  # (H, W), pixels that take part
    camera: Camera  # of size (W, H)
    photometry: Photometry  # simplified, of that channel; the gain is known, or chosen and `metric` False
    xi: str = "1/d"  # the map that the regulariser sees: "1/z", "d" or "1/d"
    regulariser: str = (
        "second"  # of the gradient ("first") or of the Hessian ("second") of ξ
    )
    lam: float = 1.0  # λ, at least 0: weight of the regulariser, larger is smoother
    # ε of the Huber norm, positive: below it a derivative costs its square, above it its size. ξ/ξ̃ of a
    # smooth wall bends by less than 1e-3 per squared 1/320 of the longer side, so that only creases are
    # charged like total variation. The paper's 1e-4, in the unit of its ξ, makes staircases of a wall's
    # curvature.
    epsilon: float = 1e-3
    # Where the data's Huber penalty becomes a line; stored value, positive.
    threshold: float = 0.05
    metric: bool = True  # whether distances are in mm; else in relative units
    # (2, H, W): steps from a pixel to its right and its lower neighbour over which the surface is cut, as
    # at an occluding contour: no derivative and no march takes them.
    cuts: BoolArray | None = None
    # (H, W): what the image says of each pixel; by default, EXACT everywhere. EXACT (0): it is as bright as
    # this. LOWER_BOUND (1), saturated: it is this bright or brighter. NONE (2), a highlight or an overlay:
    # nothing; the image holds some plausible value there, of the surroundings say, for a march to begin with.
    evidence: NDArray[np.int8] | None = None
    # ω, (H, W): light of the real lamps over that of the one at the optical centre, by whose 1/γ-th power the
    # image was divided; None if it was not.
    lamp_ratio: FloatArray | None = None
    # (H, W) or (H, W, 3), the frame as it looked, for people.
    picture: FloatArray | None = None
    # (H, W), what the endoscope shows of it, and a mask that was given keeps, for people, too: pixels of it
    # that are not in `mask` have no ray or are too dark.
    seen: BoolArray | None = None
    # Red, green and blue of the picture, green being this problem's own; none if they are not to be asked.
    colours: tuple[Problem, ...] = ()
    report: Report = field(default_factory=Report, compare=False)  # where it comes from

    def __post_init__(self) -> None:
        for name, known in (("xi", XI), ("regulariser", REGULARISERS)):
            if getattr(self, name) not in known:
                raise unknown_name(name, getattr(self, name), known)
        for name, least in (("lam", 0.0), ("epsilon", 1e-12), ("threshold", 1e-9)):
            object.__setattr__(self, name, number(name, getattr(self, name), least))
        shape = (self.camera.height, self.camera.width)
        image = real_array("image", self.image)
        for name, array in (("image", image), ("mask", mask_array("mask", self.mask))):
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, the camera {shape}")
            object.__setattr__(self, name, readonly_copy(array))
        if self.picture is not None:
            picture = readonly_copy(real_array("picture", self.picture))
            object.__setattr__(self, "picture", picture)
        for name, kind, wanted in (
            ("cuts", bool, (2, *shape)),
            ("evidence", np.int8, shape),
            ("seen", bool, shape),
        ):
            given = getattr(self, name)
            if given is not None and (
                np.shape(given) != wanted or getattr(given, "dtype", None) != kind
            ):
                expected = f"an array of {np.dtype(kind)} of shape {wanted}"
                raise ValueError(f"{name} must be {expected}, got {excerpt(given)}")
        if self.evidence is not None:
            found = self.evidence[self.mask]
            unknown = found[(found < EXACT) | (found > NONE)]
            if unknown.size:
                kinds = "0 (exact), 1 (lower bound) or 2 (none)"
                raise ValueError(f"evidence must be {kinds}, found {unknown[0]}")

    @property
    def field(self) -> RayField:
        """The camera's ray field."""
        return self.camera.field

    def is_lit_as(self, other: Problem) -> bool:
        """Whether light and wall are those of another problem, whatever the unit."""
        return replace(self.photometry, gain=None) == replace(other.photometry, gain=None)

    @property
    def shown(self) -> FloatArray:
        """The frame as it looked, (H, W) or (H, W, 3), or else the channel that is explained."""
        return self.image if self.picture is None else self.picture

    @property
    def unit(self) -> str:
        """Unit of distances."""
        return "mm" if self.metric else "relative units"

    @cached_property
    def log_d0(self) -> FloatArray:
        """log d₀ = -½ log I_c, (H, W): the distance if all the surface faced the camera."""
        canonical = self.photometry.canonical(self.image, self.field.cos_alpha)
        return -0.5 * np.log(np.where(self.mask, canonical, np.nan))

    def in_units(self) -> Problem:
        """Choose the gain, if it is not known, that makes the median of d₀ one unit."""
        if self.metric:
            return self
        factor = 1 / float(np.median(np.exp(self.log_d0[self.mask])))
        gain = (self.photometry.gain or 1.0) * factor**2
        return replace(self, photometry=replace(self.photometry, gain=gain))

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the image's noise, in stored values."""
        return noise_level(self.image, self.mask)

    @cached_property
    def edge_weight(self) -> FloatArray:
        """g, (H, W): near 1 in smooth parts of the image, less at its edges.

        It falls to 1/e where the image changes by 0.05 per 1/320 of the longer side.
        Steps to and from pixels that say nothing are no edges: a highlight is none of the surface's.
        """
        scale = px_per_reference(self.mask.shape)
        informative = (
            self.mask if self.evidence is None else self.mask & (self.evidence != NONE)
        )
        size = np.linalg.norm(differences(self.image, informative), axis=0) * scale
        return np.exp(-size / 0.05)

    @property
    def derivative_scale(self) -> float:
        """What a derivative of ξ per pixel is multiplied by: (longer side/320)^order."""
        return px_per_reference(self.mask.shape) ** (
            1 if self.regulariser == "first" else 2
        )

    @cached_property
    def xi_median(self) -> float:
        """ξ̃, the median of ξ at the start d₀."""
        inside = self.mask
        return float(
            np.median(to_xi(self.log_d0[inside], self.xi, self.field.cos_alpha[inside]))
        )


def check_maps(
    mask: BoolArray, start: FloatArray | None = None, inflow: FloatArray | None = None
) -> None:
    """Raise a ValueError if log-distances, to start from or said to be known, cannot be used."""
    for name, given in (("start", start), ("inflow", inflow)):
        if given is None:
            continue
        if not (isinstance(given, np.ndarray) and given.dtype.kind == "f"):
            raise ValueError(
                f"{name} must be an array of log-distances, got {excerpt(given)}"
            )
        if given.shape != mask.shape:
            raise ValueError(f"{name} has shape {given.shape}, the frame {mask.shape}")
    if inflow is not None and np.isinf(inflow[mask]).any():
        raise ValueError("inflow must be finite, or nan where the distance is not known")
    if start is not None and not np.isfinite(start[mask]).all():
        raise ValueError("start must be finite wherever the mask is")
