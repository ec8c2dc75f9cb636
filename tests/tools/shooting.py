"""How a sheet is moved and seen, from keywords of both."""

from dataclasses import fields, replace

from endolab.calibration.simulation.sheet_image import Sensor
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import SAMPLED


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
