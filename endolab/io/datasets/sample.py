"""A frame with its truth, and where published ones lie.

Every sample comes out the same way: a `Frame`, a `Calibration` of its size, and Euclidean
distances in mm, nan where the truth is unknown. Nothing is downloaded. `published.open_dataset`
opens any layout; EndoMapper's calibrations are in `endomapper`.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Sample:
    """A published frame."""

    frame: Frame
    calibration: Calibration  # of the frame's size; its gain is unknown
    distance: FloatArray  # (H, W), true, Euclidean, mm; nan where unknown


def data_folder() -> Path | None:
    """Folder of published frames, which $ENDOLAB_DATA names; None if there is none."""
    named = os.environ.get("ENDOLAB_DATA")
    return Path(named) if named and os.path.isdir(named) else None
