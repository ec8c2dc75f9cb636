"""Checks of notebook 06: what a gain can make good of a wrong γ, and what a plane costs."""

from __future__ import annotations

from math import isclose
from typing import Any

import numpy as np

from endolab.course.verdict import Wrong, verdict
from endolab.tuning.engine import Tuner
from endolab.tuning.source import Settings

WRONG_GAMMA = 2.0  # that exercise 1 has the solver believe
ENOUGH = 0.1  # %, the error that exercise 2 asks for


@verdict
def exercise_1(gain: Any, left: Any, why: Any, engine: Tuner) -> str:
    """Look at the gain that makes good what it can of a wrong γ.

    Parameters
    ----------
    gain, left : float
        The answer: the gain, over the true one, at which the tube's median error is least; that error, %.
    why : str
        The answer: what is left then, an error of the "scale" or of the "shape".
    engine : Tuner
        It solves the tube once: a gain does no more than multiply its distances, by the root.
    """
    once = engine.cold(Settings(scene="tube", gamma=WRONG_GAMMA))
    assert once.result is not None
    assert once.truth is not None
    ratio = once.result.distance / once.truth

    def error(of: float) -> float:
        return float(100 * np.nanmedian(np.abs(np.sqrt(of) * ratio - 1)))

    tried = np.geomspace(0.8, 1.6, 400)
    best = float(tried[np.argmin([error(one) for one in tried])])
    here = f"At × {gain:.3g} the error is {error(gain):.1f} %."
    if gain < 1:
        raise Wrong(f"{here} With this γ all is already too near, and less gain brings it nearer still.")
    if not isclose(gain, best, rel_tol=0.025):
        if isclose(gain, best**0.5, rel_tol=0.01):
            raise Wrong(
                f"{here} By so much the *distances* are too small. And with the gain they grow by its root."
            )
        if isclose(gain, best**2, rel_tol=0.01):
            raise Wrong(
                f"{here} That is the square of the best: distances grow by the root of the gain, not more."
            )
        raise Wrong(f"{here} It is less with a {'higher' if gain < best else 'lower'} gain.")
    if isclose(100 * left, error(gain), rel_tol=0.2):
        raise Wrong(f"`left` is asked in per cent: {100 * left:.2g}, not {left:.2g}.")
    if not isclose(left, error(gain), rel_tol=0.2):
        raise Wrong(f"{here} The median error of the tuner's status line, or `median_error`, is asked.")
    if why not in ("scale", "shape"):
        raise Wrong('`why` is "scale" or "shape".')
    if why == "scale":
        raise Wrong(
            "Scale is what a gain takes out, and it is out: in the median the ratio to the truth is 1."
        )
    low, high = np.nanpercentile(np.sqrt(gain) * ratio, [5, 95])
    rest = f"The rest bends: distances are {low:.0%} to {high:.0%} of the true ones."
    return f"{error(1):.1f} % become {error(gain):.1f} %. {rest}"


@verdict
def exercise_2(lam: Any, charged: Any, engine: Tuner) -> str:
    """Look at the largest λ with which first order gets a plane right.

    Parameters
    ----------
    lam : float
        The answer: λ, to within a factor of 2.
    charged : str
        The answer: what first order charges a plane for, its "slope" or its "bend".
    engine : Tuner
        It solves the plane.
    """

    def error(lam: float, order: str = "first") -> float:
        found = engine.cold(Settings(scene="plane", regulariser=order, lam=lam)).median_error
        assert found is not None
        return found

    if not lam > 0:
        raise Wrong("λ must be positive: at 0 there is no order at all.")
    first, second = error(lam), error(lam, "second")
    if first >= ENOUGH:
        also = " By second order it is: is *order* at first?" if second < ENOUGH else ""
        raise Wrong(f"By first order and with λ = {lam:g} it is {first:.2g} %, not below {ENOUGH} %.{also}")
    if error(2 * lam) < ENOUGH:
        raise Wrong(f"It is below {ENOUGH} %, but so it is with twice this λ. It need not fall that far.")
    if charged == "bend":
        raise Wrong(
            "A plane has next to no bends. By what do 1/d of two neighbouring pixels differ on a tilted one?"
        )
    if charged != "slope":
        raise Wrong('`charged` is "slope" or "bend".')
    both = f"{error(1.0):.2g} % by first order and {error(1.0, 'second'):.2g} % by second"
    return f"First order charges the slope, and second the bends, of which there are none: at λ = 1, {both}."
