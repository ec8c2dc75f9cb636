"""Pictures that are turned, with their cameras: the surface must turn with them."""

from dataclasses import replace

import numpy as np

import endolab as el

TURNS = {
    "mirrored": np.fliplr,
    "upside down": lambda a: a[::-1, ::-1],
    "transposed": lambda a: a.swapaxes(0, 1),
}


def solve_turned(frame, calibration, name, **options):
    """Solve the turned picture."""
    image, mask = (
        np.ascontiguousarray(TURNS[name](a)) for a in (frame.image, frame.mask)
    )
    camera = calibration.camera
    width, height = camera.width, camera.height
    if name == "transposed":
        changes = {"width": height, "height": width, "cx": camera.cy, "cy": camera.cx}
        changes |= {"fx": camera.fy, "fy": camera.fx}
    else:
        changes = {"cx": width - 1 - camera.cx}
        if name == "upside down":
            changes["cy"] = height - 1 - camera.cy
    known = el.Calibration(replace(camera, **changes), calibration.photometry)
    return el.reconstruct(el.Frame(image, mask), known, **options)
