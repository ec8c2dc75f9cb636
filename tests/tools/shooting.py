"""Samples of simulated videos."""

import endolab as el
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples

CAMERA = el.load_calibration("paper", width=480).camera
TRUTH = el.Photometry(2.5, 2.2, 1.0, PAPER_SHEET)


def video(target="vicalib_big", count=100, light=TRUTH, **how):
    """Samples and gains of a simulated video."""
    return simulate_samples(el.TARGETS[target], CAMERA, light, count, **how)
