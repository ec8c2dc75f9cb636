"""exp for compiled loops, of arithmetic alone: so that a loop takes many pixels at once.

Calls of the C library's are made one by one.
"""

from endolab.numerics.compiled import kernel


@kernel
def exp(x: float) -> float:
    """e^x = (e^(x/1024))^1024, by Taylor's series: to 1e-10 for |x| up to 20; it stops at e^±700."""
    r = min(max(x, -700.0), 700.0) / 1024
    return (1 + r * (1 + r * (1 / 2 + r * (1 / 6 + r * (1 / 24 + r / 120))))) ** 1024
