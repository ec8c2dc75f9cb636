"""Pictures that are turned, with their cameras: the surface must turn with them."""

from dataclasses import replace

import numpy as np

import endolab as el

TURNS = {
    "mirrored": np.fliplr,
    "upside down": lambda a: a[::-1, ::-1],
    "transposed": lambda a: a.swapaxes(0, 1),
}


def turned(case, name):
    """A `Case` whose picture and distance are turned."""
    camera = case.calibration.camera
    width, height = camera.width, camera.height
    if name == "transposed":
        changes = {"width": height, "height": width, "cx": camera.cy, "cy": camera.cx}
        changes |= {"fx": camera.fy, "fy": camera.fx}
    else:
        changes = {"cx": width - 1 - camera.cx}
        if name == "upside down":
            changes["cy"] = height - 1 - camera.cy
    maps = (case.frame.image, case.frame.mask, case.distance)
    image, mask, distance = (np.ascontiguousarray(TURNS[name](a)) for a in maps)
    return replace(
        case,
        frame=el.Frame(image, mask),
        calibration=replace(case.calibration, camera=replace(camera, **changes)),
        distance=distance,
        normals=None,
    )
