"""Random frames: what a seed draws, and that nothing is lost in its file."""

from dataclasses import replace

from numpy.testing import assert_allclose, assert_array_equal

from endolab.datasets.traced import LAYERS
from endolab.model.photometry import Photometry
from endolab.synthetic.rendering import render
from tests.tools.path_tracing import Traced
from tests.tools.random_frames import developed_frame, random_case, read, write


def test_a_seed_decides_everything():
    assert random_case(3) == random_case(3)
    assert random_case(3).cavity != random_case(8).cavity


def test_round_trip(tmp_path):
    case = random_case(3)
    case = replace(case, camera=case.camera.resize(48, 36))
    one = Photometry(2.5, case.photometry.gamma, 1.0, case.photometry.brdf)
    seen = render(case.cavity, case.camera, one)
    direct = seen.image**one.gamma
    layers = {"direct": direct, "indirect": 0.1 * direct, "mirrored": 0.01 * direct[..., 0]}
    old = developed_frame(case, Traced(**vars(seen), **layers))
    write(tmp_path / "a.npz", old)
    new = read(tmp_path / "a.npz")
    assert_array_equal(new.frame.image, old.frame.image)
    assert_array_equal(new.frame.mask, old.frame.mask)
    assert_allclose(new.distance, old.distance, rtol=1e-6)
    assert_allclose(new.normals, old.normals, atol=3e-5)
    for name in LAYERS:
        assert_allclose(getattr(new, name), getattr(old, name), rtol=1e-3, atol=1e-6)
    assert new.calibration == old.calibration
    assert new.kind == old.kind == "bag"
