"""The commands target, calibrate, calibrate-light and simulate sheet: what they write."""

import json

import numpy as np
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.io.descriptions import write_camera
from endolab.io.images import write_image
from endolab.synthetic.scenes import Tube


def call(*arguments):
    return cli.main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A simulated video `v`, and its calibration `cal.json` with its report."""
    folder = tmp_path_factory.mktemp("work")
    sheet = ("--target", "vicalib_folded", "--out")
    how = ("--frames", 24, "--lamp", "-3,2", "--video", *sheet)
    assert call("simulate", "sheet", *how, folder / "v") == 0
    how = ("--gamma", "free", "--leave-out", "000003", *sheet)
    assert call("calibrate", folder / "v/sheet.mkv", *how, folder / "cal.json") == 0
    return folder


def test_the_camera_and_the_light_come_back_with_a_report(work):
    truth = json.loads((work / "v/truth.json").read_text())
    found = el.load_calibration(work / "cal.json")
    for name in ("fx", "fy", "cx", "cy"):
        true = truth["camera"][name]
        assert getattr(found.camera, name) == pytest.approx(true, abs=0.15)
    (lamp,) = found.photometry.lights
    np.testing.assert_allclose(lamp.position, (-3, 2, 0), atol=0.1)
    light = found.photometry.simplify()
    assert light.k == pytest.approx(2.5, abs=0.06)
    assert light.k / light.gamma == pytest.approx(2.5 / 2.2, abs=0.01)
    # But for one factor, that of the paper.
    gains = found.evidence["photometry"]["gains"]
    ratio = [gain / truth["frames"][int(name)]["gain"] for name, gain in gains.items()]
    assert np.std(np.log(ratio)) < 0.02
    assert "000003" not in gains
    assert "asked" in found.evidence["frames"]["dropped"]["000003"]
    for name in ("report.html", "report.json", "camera.json"):
        assert (work / "cal_report" / name).is_file()
    assert 'id="tip"' in (work / "cal_report/report.html").read_text(encoding="utf-8")


def test_a_sheet_to_print(tmp_path):
    out = tmp_path / "s.pdf"
    assert call("target", "vicalib_folded", "--out", out) == 0
    assert out.read_bytes().startswith(b"%PDF")


def test_frames_of_tissue_tell_the_light(tmp_path):
    """A tube by the paper's fisheye, with k = 1.5; one picture cannot be read."""
    camera = el.load_calibration("paper", width=96).camera
    light = el.Photometry(1.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))
    for number, scene in enumerate((Tube(length=130), Tube(length=110, tilt=10))):
        write_image(tmp_path / f"{number}.png", el.render(scene, camera, light).image)
    (tmp_path / "2.png").write_bytes(b"no picture")
    write_camera(camera, tmp_path / "camera.json")
    how = ("--camera", tmp_path / "camera.json", "--albedo", "0.75,0.38,0.3", "--out")
    assert call("calibrate-light", tmp_path, *how, tmp_path / "found.json") == 0
    found = el.load_calibration(tmp_path / "found.json")
    assert found.photometry.k == pytest.approx(1.5, abs=0.45)  # 1.09, and says ± 0.38
    assert found.photometry.brdf == light.brdf
    assert list(found.evidence["unknown_light"]["costs"]) == ["0.png", "1.png"]
