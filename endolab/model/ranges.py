"""Ranges beyond which a number is a slip of the pen; those of an endoscope stand in its types.

They are generous, and narrow enough that whatever is computed from such numbers stays finite.
"""

from endolab.numerics.checks import number

RANGES = {
    # Of a surface, in any unit: its square is a number in single precision, too.
    "distance": (1e-12, 1e12),
    "lam": (0.0, 1e12),
    "epsilon": (1e-12, 1e6),
    "threshold": (1e-9, 1e6),
}


def check_range(name: str, value: float) -> None:
    """Raise a ValueError if a value of this name is out of its range."""
    number(name, value, *RANGES[name])
