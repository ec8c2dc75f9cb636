"""The commands target, calibrate, calibrate-light and simulate sheet: what they write."""

import json
import shlex
import shutil

import numpy as np
import pytest

import endolab as el
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.cli import main as cli
from endolab.io.descriptions import write_camera
from endolab.io.images import write_image
from endolab.reconstruction.prior_sigma import PriorSigma
from endolab.synthetic.scenes import Tube

FRAMES = 24


def call(*arguments):
    return cli.main([str(argument) for argument in arguments])


def asking(source, out, target="vicalib_folded"):
    return "calibrate", source, "--target", target, "--out", out


def calibrate(source, out, *options):
    return call(*asking(source, out), *options)


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A simulated video `v`, and its calibration `cal.json` with its report."""
    folder = tmp_path_factory.mktemp("work")
    how = ("--frames", FRAMES, "--target", "vicalib_folded", "--video")
    assert call("simulate", "sheet", "--out", folder / "v", *how) == 0
    how = ("--gamma", "free", "--record")
    assert calibrate(folder / "v/sheet.mkv", folder / "cal.json", *how) == 0
    return folder


@pytest.fixture
def again(work, tmp_path):
    """Copy the calibration and its report, and name the video."""
    shutil.copy2(work / "cal.json", tmp_path)
    shutil.copytree(work / "cal_report", tmp_path / "cal_report")
    return work / "v/sheet.mkv", tmp_path / "cal.json"


def test_the_camera_and_the_light_come_back_with_a_report(work):
    truth = json.loads((work / "v/truth.json").read_text())
    found = el.load_calibration(work / "cal.json")
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(found.camera, name) == pytest.approx(
            truth["camera"][name], abs=0.15
        )
    light = found.photometry
    assert light.k == pytest.approx(2.5, abs=0.06)
    assert light.k / light.gamma == pytest.approx(2.5 / 2.2, abs=0.01)
    # But for one factor, that of the paper.
    gains = found.evidence["photometry"]["gains"]
    ratio = [gain / truth["frames"][int(name)]["gain"] for name, gain in gains.items()]
    assert np.std(np.log(ratio)) < 0.02
    for name in (
        "report.html",
        "report.json",
        "camera.json",
        "recording.rrd",
        "light.png",
    ):
        assert (work / "cal_report" / name).is_file()


@pytest.mark.parametrize(
    "options",
    [
        ("--video",),
        ("--target", "charuco"),
        ("--target", "vicalib_folded"),
    ],
)
def test_simulate_sheet_says_the_next_command(tmp_path, capsys, options):
    """Which finds what was written: it fails, if at all, for two frames are too few."""
    out = tmp_path / "a folder"
    small = ("--frames", 2, "--width", 240)
    assert call("simulate", "sheet", *small, "--out", out, *options) == 0
    _, hint = capsys.readouterr().out.split("next: ")
    _, command, source, *rest = shlex.split(hint)
    rest[-1] = tmp_path / rest[-1]
    assert call(command, source, *rest) == 2
    assert "needs 3 views" in capsys.readouterr().err


def test_a_calibration_without_some_frames_says_which(again, capsys):
    video, out = again
    names = list(el.load_calibration(out).evidence["frames"]["errors_px"])[:2]
    assert calibrate(video, out, "--overwrite", "--leave-out", *names) == 0
    assert "2: left out, as asked" in capsys.readouterr().out
    found = el.load_calibration(out)
    assert found.evidence["frames"]["dropped"][names[0]] == "left out, as asked"
    assert not set(names) & set(found.evidence["photometry"]["gains"])


def test_one_flat_sheet_does_not_tell_gamma_and_the_camera_is_kept_with_a_nominal_light(
    tmp_path, capsys
):
    (tmp_path / "f").mkdir()
    camera = el.load_calibration("paper", width=480).camera
    light = el.Photometry(brdf=PAPER_SHEET)
    video = simulate_video(
        el.TARGETS["vicalib_small"],
        camera,
        light,
        16,
    )
    for number, frame in enumerate(video):
        write_image(tmp_path / f"f/{number:03d}.png", frame.image)
    asked = asking(tmp_path / "f", tmp_path / "c.json", "vicalib_small")
    assert call(*asked, "--gamma", "free") == 0
    assert "The light is not" in capsys.readouterr().out
    found = el.load_calibration(tmp_path / "c.json")
    assert found.camera.fx == pytest.approx(camera.fx, abs=0.2)
    assert PriorSigma.of(found).k == 1  # nobody measured it


def test_a_sheet_to_print(tmp_path):
    out = tmp_path / "s.pdf"
    assert call("target", "vicalib_folded", "--out", out) == 0
    assert out.read_bytes().startswith(b"%PDF")


@pytest.fixture(scope="module")
def tissue(tmp_path_factory):
    """Pictures of a tube by the paper's fisheye, with k = 1.5, one that cannot be read, and its camera."""
    folder = tmp_path_factory.mktemp("tissue")
    camera = el.load_calibration("paper", width=96).camera
    for number, scene in enumerate((Tube(length=130), Tube(length=110, tilt=10))):
        light = el.Photometry(
            1.5,
            2.2,
            None,
            el.Lambertian((0.75, 0.38, 0.30)),
        )
        write_image(folder / f"{number}.png", el.render(scene, camera, light).image)
    (folder / "2.png").write_bytes(b"no picture")
    write_camera(camera, folder / "camera.json")
    return folder


def test_frames_of_tissue_tell_the_light(
    tissue,
    tmp_path,
):
    asked = ("calibrate-light", tissue, "--camera", tissue / "camera.json", "--out")
    out = tmp_path / "found.json"
    assert call(*asked, out, "--albedo", "0.75,0.38,0.3") == 0
    found = el.load_calibration(out)
    assert found.photometry.k == pytest.approx(1.5, abs=0.45)  # 1.09, and says ± 0.38
    assert found.photometry.brdf == el.Lambertian((0.75, 0.38, 0.3))
    assert list(found.evidence["unknown_light"]["costs"]) == ["0.png", "1.png"]
