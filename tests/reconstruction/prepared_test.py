"""Frames that were prepared before they are solved."""

import numpy as np

import endolab as el
from endolab.frames.prepare import prepare


def test_prepare_and_reconstruct_mean_the_same():
    """Where nothing is too dark, what is prepared solves as what is not, given the same words."""
    camera = el.Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5)
    light = el.load_calibration("paper").photometry
    how = {"noise": 2.0, "bits": 8, "highlights": 0.02}
    seen = el.render(el.SCENES["curved"], camera, light, **how)
    frame = el.Frame(seen.image, seen.mask)
    mine = el.Calibration(camera, seen.photometry)
    ready = prepare(frame, mine, highlights="ignore")
    assert ready.highlights.any()
    one = el.reconstruct(ready.frame, mine, channel="green")
    other = el.reconstruct(frame, mine, channel="green", highlights="ignore")
    np.testing.assert_array_equal(one.distance, other.distance)
