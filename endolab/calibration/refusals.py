"""Why a target, a pose, a camera or a light cannot be told, and what may be wrong with one that was.

All sentences.
"""

from enum import Enum
from typing import Any

from endolab.calibration import constants

VIEWS_NEEDED = (
    f"a calibration needs {constants.LEAST_VIEWS} views from different directions at least"
)
OWN_LIGHT = "use the endoscope's own light, and no other"


class NotIdentifiableError(ValueError):
    """What is seen does not tell an unknown: "target", "pose", "camera", "light", "k", "gamma", "lamps"."""

    def __init__(self, unknown: str, reason: str) -> None:
        super().__init__(reason)
        self.unknown = unknown


class Refusal(Enum):
    """What is not told, and why."""

    FEW_SPOTS = "target", "too few dark spots"
    NO_GRID = "target", "the dark spots form no grid"
    OTHER_CODE = "target", "the code of the dots does not match"
    ROUGH_DOTS = "target", "the dots do not lie on a smooth sheet"
    ROUGH_CORNERS = "target", "the corners do not lie on a smooth sheet"
    MIRRORED = "target", "the picture is a mirror image: exchange its left and right"
    FEW_CORNERS = (
        "target",
        "{read}, of the board's {first} to {last}; {count} corners agree, "
        f"{constants.LEAST_CORNERS} are needed",
    )
    OTHER_BOARD = "target", "a board of {columns}×{rows} squares is seen"
    NO_BOARD = "target", "no chessboard of this size, or not all of it is in view"
    WHITE_FIRST = (
        "target",
        "its upper left square is white; exchange columns and rows if the board is turned",
    )

    FEW_POINTS = (
        "pose",
        f"a pose needs {constants.LEAST_POINTS} points at least, got {{count}}",
    )
    DISORDER = "pose", "its points do not lie to each other as the target's do"
    BEHIND = "pose", "its points are mirrored: the paper would be seen from behind"
    DISAGREE = "pose", "only {good} of its {count} points agree with the others"
    ALIEN = "pose", "its points are {off:.3g} px off, of other frames {usual:.2g} px"
    LEFT_OUT = "pose", "left out, as asked"

    FEW_VIEWS = "camera", f"{VIEWS_NEEDED}, got {{count}}{{why}}"
    USELESS_VIEWS = "camera", "most views are of no use: {why}"
    STILL = (
        "camera",
        f"{VIEWS_NEEDED}, got {{count}}: the sheet hardly moves in the {{views}} views",
    )
    SQUARE = (
        "camera",
        "views square to the axis cannot tell the focal length from the distance: the sheet's largest tilt "
        "is {tilt:.1f}°; tilt the sheet by 20° or more in some views",
    )
    UNSURE_CAMERA = (
        "camera",
        "the views do not tell {name}: its standard error is {error:.0f} px; the sheet's largest tilt is "
        "{tilt:.1f}°, and points lie up to {seen:.0f}° off the axis; add tilted views that fill the picture",
    )

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

    def error(self, **facts: Any) -> NotIdentifiableError:
        """Return it as an error."""
        unknown, words = self.value
        return NotIdentifiableError(unknown, words.format(**facts))

    def if_(self, is_so: Any, **facts: Any) -> None:
        """Raise it if it is so."""
        if is_so:
            raise self.error(**facts)


class Doubt(Enum):
    """Why a camera or a light that was found may not be the right one."""

    LENSES_ALIKE = (
        "Both lenses predict views that were held out alike within their noise: fisheye."
    )
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


class Verdict(Enum):
    """What can be used of a calibration."""

    USE = "It can be used."
    CAMERA_ALONE = "Use the camera alone: the light could not be told."
    USELESS = (
        "Do not use it: many points do not agree with the camera. The lens is of another kind, or the "
        "sheet was not flat."
    )
