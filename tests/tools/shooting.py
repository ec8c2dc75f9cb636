"""Samples of simulated videos; how a sheet is moved and seen, from keywords of both."""

from dataclasses import fields, replace

import endolab as el
from endolab import datasets
from endolab.calibration.simulation.sheet_image import Sensor
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import PAPER_SHEET, SAMPLED, simulate_samples

CAMERA = datasets.load_calibration("paper", width=480).camera
TRUTH = el.Photometry(2.5, 2.2, 1.0, PAPER_SHEET)


def video(target="vicalib_big", count=100, light=TRUTH, **how):
    """Samples and gains of a simulated video."""
    return simulate_samples(el.TARGETS[target], CAMERA, light, count, **shooting(**how))


def shooting(**options):
    """Sort the fields of `Movement` and of `Sensor` into options of `simulate_samples`."""
    kinds = [{field.name for field in fields(kind)} for kind in (Movement, Sensor)]
    movement, sensor = (
        {name: options.pop(name) for name in kind & set(options)} for kind in kinds
    )
    return options | {
        "movement": Movement(**movement),
        "sensor": replace(SAMPLED, **sensor),
    }
