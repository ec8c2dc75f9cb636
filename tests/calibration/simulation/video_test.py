"""The simulated calibration video: what a hand may do with a sheet."""

import numpy as np
import pytest

import endolab as el
from endolab.calibration.simulation.trajectory import trajectory

CAMERA = el.load_calibration("paper").camera
FOLDED = el.TARGETS["vicalib_folded"]


@pytest.mark.parametrize("fold", [0.0, 0.05, 1.2])
def test_panels_share_the_fold_and_turn_away(fold):
    ridge = np.array([[FOLDED.fold_x, y, 0.0] for y in (0.0, 38.0)])
    for left, right in trajectory(FOLDED, CAMERA, 30, fold=fold):
        np.testing.assert_allclose(
            left.transform(ridge), right.transform(ridge), atol=1e-9
        )
        assert left.normal @ right.normal == pytest.approx(np.cos(fold), abs=1e-12)
        # Convex: each panel lies behind the plane of the other, seen from where the sheet is read.
        tip = right.transform([[76.0, 19.0, 0.0]])
        assert np.all((tip - left.translation) @ left.normal <= 1e-9)
