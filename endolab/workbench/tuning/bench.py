"""The model's bench: what each factor of the equation makes of one picture, by hand and without a kernel."""

import base64
import json

import numpy as np
from IPython.display import HTML

from endolab.calibration.simulation.video import PAPER_SHEET
from endolab.model.cameras import Camera
from endolab.model.photometry import Photometry
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import Plane
from endolab.workbench.tuning.script import page_script

NODES = np.deg2rad(np.linspace(0, 80, 15))  # of the BRDF, rad
PAGE = """<div style="max-width: 990px; padding: 6px; font: 12px sans-serif; background: white; color: black">
</div>
<script>(() => {{ {script}
bench(document.currentScript.previousElementSibling, {content}); }})();</script>"""


def bench(camera: Camera, photometry: Photometry) -> HTML:
    """Make the model's bench: a plane before an endoscope, its picture and the factors that make it.

    Vignetting, lamp, response, gain, BRDF and plane follow the hand; a picture may be kept, to compare
    another setting with it. The nearest point and the brightest are marked, and each map tells its value
    under the cursor. A line tells by how much the distance is misread where the lamp, which may
    stand beside the lens, is taken to be at it.

    Parameters
    ----------
    camera : Camera
        Some 240 px wide, to be quick.
    photometry : Photometry
        The first setting, of one light at the optical centre, whose exponent k the lamp has; with an
        unknown gain, one that exposes the picture well.

    Returns
    -------
    HTML
        What a notebook shows; ``bench.image`` of its first element is the picture, stored values,
        ``bench.misread`` what is misread, %, a quarter of the width from its left and right, and
        ``bench.marks`` the pixels nearest to the lamp, brightest, and under the cursor, or -1.
    """
    wall = Plane(60.0, 20.0)
    knobs = {
        "k": 0.0,
        "m": photometry.k,
        "gamma": photometry.gamma,
        "gain": render(wall, camera, photometry).photometry.gain,
        "lamp": 0.0,
        "tilt": wall.tilt,
        "depth": wall.depth,
    }
    cosines = np.cos(NODES)
    rays = np.nan_to_num(camera.field.rays).astype(np.float32)
    content = {
        "width": camera.width,
        "height": camera.height,
        "packed": base64.b64encode(rays.tobytes()).decode(),
        "knobs": knobs,
        "nodes": NODES.tolist(),
        "brdf": photometry.brdf.value(cosines, cosines).tolist(),
        "sheet": PAPER_SHEET.value(cosines, cosines).tolist(),
    }
    return HTML(PAGE.format(script=page_script("bench"), content=json.dumps(content)))
