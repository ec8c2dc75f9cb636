"""Ranges beyond which a number is a slip of the pen, and no endoscope or surface has it.

They are generous, and narrow enough that whatever is computed from such numbers stays finite.
"""

import numpy as np
from numpy.typing import ArrayLike

from endolab.numerics.checks import number, real_array

RANGES = {
    # Light and response
    "k": (0.0, 100.0),
    "gamma": (0.1, 10.0),
    "gain": (1e-15, 1e15),
    "albedo": (1e-9, 1.0),
    "theta": (0.0, np.pi / 2),
    "value": (1e-9, 1e9),  # of a BRDF, 1/sr
    "specular": (0.0, 1e3),
    "shininess": (0.0, 1e6),
    "position": (-1e3, 1e3),  # mm
    "exponent": (0.0, 100.0),
    "weight": (1e-12, 1e12),
    "length": (1e-3, 1e6),  # of a target, or one that fixes a scale, mm
    "distance": (
        1e-12,
        1e12,
    ),  # of a surface, in any unit: its square is a number in single precision, too
    "lam": (0.0, 1e12),
    "epsilon": (1e-12, 1e6),
    "threshold": (1e-9, 1e6),
    "smooth": (0.0, 1e6),  # px
    # Cameras, px
    "fx": (1e-2, 1e7),
    "fy": (1e-2, 1e7),
    "cx": (-1e6, 1e6),
    "cy": (-1e6, 1e6),
    "distortion": (-1e4, 1e4),
    "a[0]": (1e-2, 1e7),
    "a": (-1e7, 1e7),
    "c, d, e": (-1e3, 1e3),
    "c - d·e": (1e-6, 1e6),
}


def in_range(name: str, value: float) -> float:
    """Return a number that lies in the range of its name; else ValueError."""
    return number(name, value, *RANGES[name])


def check_range(name: str, values: ArrayLike, kind: str = "") -> None:
    """Raise a ValueError if a value of this name, or one of several, is out of its range, or a kind's."""
    low, high = RANGES[kind or name]
    wrong = [
        value for value in np.ravel(real_array(name, values)) if not low <= value <= high
    ]
    if wrong:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {wrong[0]:g}")
