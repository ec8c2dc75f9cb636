"""Why a light cannot be told, and what may be wrong with one that was: all sentences."""

from enum import Enum
from typing import Any

from endolab.calibration import constants

OWN_LIGHT = "use the endoscope's own light, and no other"


class NotIdentifiableError(ValueError):
    """The samples do not tell an unknown: "gamma", "k", "lamps" or "light"."""

    def __init__(self, unknown: str, reason: str) -> None:
        super().__init__(reason)
        self.unknown = unknown


class Refusal(Enum):
    """What is not told, and why."""

    FEW = (
        "light",
        "{good} of {count} samples are lit and neither dark nor saturated, "
        f"{constants.LEAST_SAMPLES} are needed; change the exposure, or bring the sheet nearer: white paper "
        "must show",
    )
    FACING = (
        "k",
        "these samples do not determine k: in all frames the incidence angle goes with the angle off the "
        "axis, as on a sheet that faces the camera, and a free BRDF explains whatever k does; tilt "
        "the sheet by 10° or more",
    )
    FLAT = (
        "gamma",
        "these samples do not determine gamma, only k/gamma: a change of gamma is made up for by k, the "
        "gains and the BRDF to {share:.2g} % of the light "
        f"({100 * constants.LEAST_GAMMA_SIGNAL:g} % is needed); fold the sheet (vicalib_folded), "
        "print grey patches (vicalib_grey) of known ratio (--reflectance), lock the gain (--gain locked) "
        "and vary the distance, or give gamma (--gamma)",
    )
    AFAR = (
        "lamps",
        "these samples do not determine where the lamps are: 1 mm changes the light by {share:.2g} % "
        f"({100 * constants.LEAST_LAMP_SIGNAL:g} % is needed), as the sheet was {{near:.0f}} mm away or "
        "more; bring it nearer, all over the picture, or take lamps (--lamps) centre",
    )
    LIT_ROOM = (
        "light",
        "the brightness hardly falls with distance and tilt, as in a lit room: to the power {power:.2f} ± "
        f"{{error:.2f}} of what a lamp at the lens does; {OWN_LIGHT}",
    )
    UNLIKE = (
        "light",
        f"residuals of {{sigma:.0f}} grey levels are too large for a lamp at the lens; {OWN_LIGHT}",
    )
    UNSURE_K = (
        "k",
        "{samples} samples of {frames} frames do not determine k: it is {k:.2f} ± {error:.2g}, of which "
        f"± {constants.LARGEST_K_ERROR:g} at most is of use; take more, over a wider field",
    )
    UNSURE_GAMMA = (
        "gamma",
        "gamma ran to {gamma:.2f} ± {error:.2g}, of "
        f"{constants.GAMMA_BOUNDS[0]:g} to {constants.GAMMA_BOUNDS[1]:g} ± "
        f"{100 * constants.LARGEST_GAMMA_ERROR:g} % at most; check the distances, or give gamma (--gamma)",
    )

    def if_(self, is_so: Any, **facts: float) -> None:
        """Raise it if it is so."""
        unknown, words = self.value
        if is_so:
            raise NotIdentifiableError(unknown, words.format(**facts))


class Doubt(Enum):
    """Why a light that was found may not be the right one."""

    UNFINISHED = "The fit of the light did not end as it should."
    OTHER_LIGHT = (
        "The brightness falls less with distance and tilt than a lamp's at the lens: there was another "
        "light, γ is larger, or the paper is rough."
    )
    UNTOLD_PLACE = (
        "Where the lamp is was not told, and it was left at the lens: the sheet was never near enough, or "
        "never off the axis."
    )
    OTHER_PLACE = (
        "One side of the picture is brighter than the lamps that were fitted explain: there are others, "
        "or elsewhere."
    )
    MATT = "The surface was taken to be matt (Lambertian): a sheen would show as wrong k and γ."
    CLIPPED = "The residuals are so large that they reach out of the sensor's range, which biases the result."
