"""A camera of every model."""

import pytest

from endolab.io.datasets import load_calibration
from endolab.model.cameras import BrownConrady, KannalaBrandt, Pinhole

ENDOSCOPE = load_calibration("paper").camera
WIDE = KannalaBrandt(400, 400, 100.0, 100.0, 199.5, 199.5, (0.01, 0.0, 0.0, 0.0))
PINHOLE = Pinhole(320, 240, 200.0, 210.0, 159.5, 119.5)
C3VD = load_calibration("c3vd").camera
BROWN = BrownConrady(
    640, 480, 420.0, 425.0, 310.0, 245.0, (-0.33, 0.12, 1e-3, -8e-4, -0.01)
)
RATIONAL_K = (0.9, 0.3, 1e-3, -5e-4, 0.02, 1.25, 0.5, 0.08)
RATIONAL = BrownConrady(1350, 1080, 600.0, 610.0, 670.0, 545.0, RATIONAL_K)
CAMERAS = {
    "endoscope": ENDOSCOPE,
    "wide": WIDE,
    "pinhole": PINHOLE,
    "scaramuzza": C3VD,
    "brown": BROWN,
    "rational": RATIONAL,
}
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
