"""What `convert` writes for other programs is read back as the same rays."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from endolab.cli.main import main
from endolab.io.cameras.formats import read_camera

PLAIN = (320, 240, 300.123456789, 310.1, 160.3, 120.7)
CAMERAS = {
    "pinhole": el.Pinhole(*PLAIN),
    "brown": el.BrownConrady(*PLAIN, (-0.1, 0.02, 0.001, -0.002)),
    "rational": el.BrownConrady(
        *PLAIN, (-0.1, 0.02, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005)
    ),
    "fisheye": el.KannalaBrandt(*PLAIN, (-0.05, 0.01, -0.002, 1e-5)),
    "scaramuzza": el.load_calibration("c3vd").camera,
}
FILES = {
    "opencv": ("a.yaml", "a.xml", "a.json"),
    "kalibr": ("camchain.yaml",),
    "colmap": ("cameras.txt",),
    "ros": ("camera_info.yaml",),
}
IMPOSSIBLE = {("kalibr", "rational")} | {(program, "scaramuzza") for program in FILES}


@pytest.mark.parametrize("program", FILES)
@pytest.mark.parametrize("name", CAMERAS)
def test_there_and_back(tmp_path, capsys, program, name):
    camera = CAMERAS[name]
    source = tmp_path / "endoscope.json"
    el.write_calibration(el.Calibration(camera, el.Photometry()), source)
    for file in FILES[program]:
        out = tmp_path / file
        status = main(f"convert {source} --to {program} --out {out}".split())
        if (program, name) in IMPOSSIBLE:
            assert status == 2
            assert len(capsys.readouterr().err.splitlines()) == 1
            assert not out.exists()
            continue
        assert status == 0
        back = read_camera(out)
        pixels = np.mgrid[0:320:40, 0:240:30].reshape(2, -1).T
        assert_allclose(back.unproject(pixels), camera.unproject(pixels), atol=1e-12)
        assert type(back) is type(camera)
        again = tmp_path / "again.json"
        words = f"convert {out} --out {again} --overwrite"
        assert main(words.split()) == 0
        assert el.load_calibration(again).camera == back


def test_opencv_reads_what_is_written_for_it(tmp_path):
    source = tmp_path / "endoscope.json"
    el.write_calibration(el.Calibration(CAMERAS["rational"], el.Photometry()), source)
    out = tmp_path / "a.xml"
    assert main(f"convert {source} --to opencv --out {out}".split()) == 0
    storage = cv2.FileStorage(str(out), cv2.FileStorage_READ)
    k = storage.getNode("distortion_coefficients").mat().ravel()
    storage.release()
    assert tuple(k) == CAMERAS["rational"].k
