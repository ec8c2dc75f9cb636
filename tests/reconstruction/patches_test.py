"""A disc that is painted on a wall is found, with its albedo, and what only looks like one is not."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.reconstruction.patches import find_patch
from endolab.reconstruction.report import warnings
from endolab.synthetic.scenes import Bump

KNOWN = el.load_calibration("paper", width=320)


def solve(scene, albedo=1.0):
    """Solve a scene on which a disc is painted, a quarter from the left, of this share of its albedo."""
    seen = el.render(scene, KNOWN.camera, KNOWN.photometry, noise=1)
    row, column = np.indices(seen.mask.shape)
    disc = np.hypot(row - 110, column - 110).clip(29.5, 30.5) - 29.5
    factor = (albedo + (1 - albedo) * disc) ** (1 / seen.photometry.gamma)
    image = np.round(255 * (seen.image * factor[..., None]).clip(0, 1)) / 255
    known = replace(KNOWN, photometry=seen.photometry)
    return el.reconstruct(el.Frame(image, seen.mask), known, width=320)


@pytest.mark.parametrize("scene", ["plane", "curved"])
@pytest.mark.parametrize("albedo", [0.7, 1.3])
def test_a_painted_disc_is_found_and_said(scene, albedo):
    result = solve(el.SCENES[scene], albedo)
    *middle, found = find_patch(result)
    assert middle == pytest.approx([110, 110], abs=4)
    assert found == pytest.approx(albedo, abs=0.1)
    assert "closed ring" in " ".join(warnings(result))


@pytest.mark.parametrize("scene", [*el.SCENES.values(), Bump(60, 5, 4)])
def test_no_scene_has_a_patch(scene):
    assert find_patch(solve(scene)) is None


@pytest.mark.parametrize("index", [0, 1])
def test_no_fold_of_a_photograph_is_a_patch(data, index):
    sample = el.open_dataset(data / "c3vd_trans_t1_a")[index]
    result = el.reconstruct(sample.frame, sample.calibration, width=320)
    assert find_patch(result) is None
