"""What the tests of the tuner share: a frame with its truth."""

import pytest

import endolab as el
from endolab import datasets


@pytest.fixture(scope="package")
def seen():
    """A frame of a tube, its calibration and its true distance."""
    small = datasets.load_calibration("paper").resize(160, 120)
    view = el.render(el.SCENES["tube"], small.camera, small.photometry, noise=1, bits=8)
    calibration = el.Calibration(view.camera, view.photometry)
    return el.Frame(view.image, view.mask), calibration, view.distance
