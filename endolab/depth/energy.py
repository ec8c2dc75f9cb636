"""The one energy: how well a depth map explains a frame, and how smooth it is.

    E(v) = mean ρ(I_model(v) - I) + λ mean g ‖D ξ(v)/ξ̃‖_ε,        v = log d

ρ is Huber's penalty, D the gradient or the Hessian, ξ̃ the median of ξ at the start d₀, and
derivatives are per 1/320 of the picture's width, so that one λ serves all ξ, units and sizes
(paper, Section V; conventions in README.md). What solvers minimise, recordings show and tests
check is this function.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from endolab.cameras import Camera
from endolab.operators import BoolArray, FloatArray, forward_gradient, gradient, hessian
from endolab.penalties import huber
from endolab.photometry import Photometry
from endolab.rays import RayField
from endolab.surface import check_xi, slant, to_xi

REGULARISERS = ("first", "second")
EDGE_SCALE = 0.05  # image gradient, per 1/320 of the width, at which g falls to 1/e
REFERENCE_WIDTH = 320


@dataclass(frozen=True)
class Problem:
    """A frame to be explained: everything a solver needs, and nothing it must look up.

    Parameters
    ----------
    image : (H, W) float array
        Stored values of one channel in [0, 1].
    mask : (H, W) bool array
        Pixels that take part.
    camera : Camera
        Of size (W, H).
    photometry : Photometry
        Simplified model of that channel, its gain known (or chosen, then `metric` is False).
    xi : {"1/z", "d", "1/d"}
        The map that the regulariser sees.
    regulariser : {"first", "second"}
        Gradient or Hessian.
    lam : float
        λ, at least 0: weight of the regulariser, larger is smoother.
    epsilon : float
        ε of the Huber norm, positive.
    threshold : float
        Where the data's Huber penalty becomes a line; stored value, positive.
    metric : bool
        Whether distances are in mm; else in relative units.
    picture : (H, W) or (H, W, 3) float array, optional
        The frame as it looked, for people.
    settings : dict
        What the user asked for, for people.
    """

    image: FloatArray
    mask: BoolArray
    camera: Camera
    photometry: Photometry
    xi: str = "1/d"
    regulariser: str = "second"
    lam: float = 1.0
    epsilon: float = 1e-4
    threshold: float = 0.05
    metric: bool = True
    picture: FloatArray | None = None
    settings: dict[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_xi(self.xi)
        if self.regulariser not in REGULARISERS:
            raise ValueError(f"unknown regulariser {self.regulariser!r}; choose {' or '.join(REGULARISERS)}")
        if not (np.isfinite(self.lam) and self.lam >= 0):
            raise ValueError(f"lam must be finite and at least 0, got {self.lam}")
        for name in ("epsilon", "threshold"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite, got {value}")
        shape = (self.camera.height, self.camera.width)
        for name in ("image", "mask"):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, the camera {shape}")

    @property
    def field(self) -> RayField:
        """The camera's ray field."""
        return self.camera.field

    @property
    def unit(self) -> str:
        """Unit of distances."""
        return "mm" if self.metric else "relative units"

    @cached_property
    def log_facing(self) -> FloatArray:
        """log d₀ = -½ log I_c, (H, W): the distance if all the surface faced the camera."""
        canonical = self.photometry.canonical(self.image, self.field.cos_alpha)
        return -0.5 * np.log(np.where(self.mask, canonical, np.nan))

    @cached_property
    def edge_weight(self) -> FloatArray:
        """g, (H, W): near 1 in smooth parts of the image, less at its edges."""
        scale = self.camera.width / REFERENCE_WIDTH
        size = np.linalg.norm(forward_gradient(self.image, self.mask), axis=0) * scale
        return np.exp(-size / EDGE_SCALE)

    @cached_property
    def _xi_median(self) -> float:
        start = to_xi(self.log_facing, self.xi, self.field.cos_alpha)
        return float(np.median(start[self.mask]))


def model_image(problem: Problem, log_distance: FloatArray) -> FloatArray:
    """The frame that a depth map predicts, with normals from its gradient.

    Parameters
    ----------
    problem : Problem
    log_distance : (H, W) float array
        v = log d.

    Returns
    -------
    (H, W) float array
        Stored values; nan outside the mask.
    """
    tan2 = slant(*gradient(log_distance, problem.mask), problem.field)
    predicted = problem.photometry.shade(log_distance, tan2, problem.field.cos_alpha)[0]
    return np.where(problem.mask, predicted, np.nan)


def energy_terms(problem: Problem, log_distance: FloatArray) -> dict[str, float]:
    """The two terms of the energy of a depth map.

    Parameters
    ----------
    problem : Problem
    log_distance : (H, W) float array
        v = log d, finite inside the mask.

    Returns
    -------
    dict
        "data" and "regulariser" (λ included); the energy is their sum.
    """
    mask, count = problem.mask, int(problem.mask.sum())
    residual = model_image(problem, log_distance)[mask] - problem.image[mask]
    xi = to_xi(np.where(mask, log_distance, 0.0), problem.xi, problem.field.cos_alpha) / problem._xi_median
    order, operator = (1, forward_gradient) if problem.regulariser == "first" else (2, hessian)
    scale = (problem.camera.width / REFERENCE_WIDTH) ** order
    size = np.linalg.norm(operator(xi, mask), axis=0) * scale
    roughness = problem.edge_weight * huber(size, problem.epsilon) / problem.epsilon
    return {
        "data": float(huber(residual, problem.threshold).sum() / count),
        "regulariser": float(problem.lam * roughness[mask].sum() / count),
    }
