"""The commands target, calibrate and simulate sheet: what they write, and what they refuse."""

import json
import shutil

import numpy as np
import pytest

import endolab as el
from endolab import _extras
from endolab.batch.calibrate import calibrate_to_files
from endolab.calibration import session
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.cli import main as cli
from endolab.io.descriptions import read_camera, write_camera
from endolab.io.images import read_image, write_image

FRAMES = 24


def call(*arguments):
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as exit:
        return exit.code


def calibrate(folder, out, *options, target="vicalib_small"):
    return call("calibrate", folder, "--target", target, "--out", out, *options)


def write_frames(folder, *, count=6, target="vicalib_small", width=480, **how):
    """Write a few frames of a sheet that is moved as `how` says."""
    folder.mkdir()
    camera = el.load_calibration("paper", width=width).camera
    light = el.Photometry(2.5, 2.2, None, PAPER_SHEET)
    for number, frame in enumerate(simulate_video(el.TARGETS[target], camera, light, count, **how)):
        write_image(folder / f"{number:03d}.png", frame.image)
    return folder


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A simulated video `v`, and its calibration `cal.json` with its report."""
    folder = tmp_path_factory.mktemp("work")
    how = ("--frames", FRAMES, "--width", 640, "--target", "vicalib_folded", "--noise", 1, "--video")
    assert call("simulate", "sheet", "--out", folder / "v", *how) == 0
    options = ("--gamma", "free", "--record")
    assert calibrate(folder / "v/sheet.mkv", folder / "cal.json", *options, target="vicalib_folded") == 0
    return folder


@pytest.fixture
def refused(capsys):
    """Run a command that must fail: exit code 2 and one line on stderr, which has the words of `says`."""

    def run(*arguments, says=(), **options):
        capsys.readouterr()
        code = (call if arguments[0] in ("target", "calibrate") else calibrate)(*arguments, **options)
        error = capsys.readouterr().err
        assert code == 2
        assert error.startswith("endolab: ")
        assert error.count("\n") == 1
        for words in says:
            assert words in error
        return error

    return run


def test_the_camera_and_the_light_come_back(work):
    truth = json.loads((work / "v/truth.json").read_text())
    found = el.Calibration.load(work / "cal.json")
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(found.camera, name) == pytest.approx(truth["camera"][name], abs=0.15)
    assert found.photometry.k == pytest.approx(2.5, abs=0.06)
    assert found.photometry.gamma == pytest.approx(2.2, abs=0.05)
    assert found.photometry.k / found.photometry.gamma == pytest.approx(2.5 / 2.2, abs=0.01)
    assert found.photometry.gain is None
    light = found.evidence["photometry"]
    gains = np.array(list(light["gains"].values()))
    known = np.array([frame["gain"] for frame in truth["frames"]])
    ratio = gains / known[[int(name) for name in light["gains"]]]
    assert np.std(np.log(ratio)) < 0.02  # but for one factor, that of the paper
    assert light["brdf_of"] == "the calibration sheet"
    assert len(found.evidence["frames"]["dropped"]) + len(gains) == FRAMES


def test_the_report_is_a_page_with_pictures_and_numbers(work):
    report = work / "cal_report"
    names = {path.name for path in report.iterdir()}
    assert {"report.html", "report.json", "camera.json", "camera.png", "light.png", "recording.rrd"} <= names
    assert json.loads((report / "report.json").read_text())["account"]
    assert "γ = 2." in (report / "report.html").read_text()
    assert read_image(report / "light.png").std() > 0.05


def test_an_interrupted_search_goes_on_where_it_was(work, tmp_path, monkeypatch, capsys):
    looked = []
    detect = session.detect

    def interrupted(image, target):
        looked.append(1)
        if len(looked) == 5:
            raise KeyboardInterrupt
        return detect(image, target)

    monkeypatch.setattr(session, "detect", interrupted)
    arguments = (work / "v/sheet.mkv", tmp_path / "c.json")
    assert calibrate(*arguments, target="vicalib_folded") == 130
    assert f"4 of {FRAMES} frames are searched and kept" in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()
    assert calibrate(*arguments, target="vicalib_folded") == 0
    assert len(looked) == 5 + FRAMES - 4
    assert f"4 of {FRAMES} frames were searched before" in capsys.readouterr().out
    found = el.Calibration.load(tmp_path / "c.json")
    assert (found.photometry.gamma, found.camera) == (2.2, el.Calibration.load(work / "cal.json").camera)


def test_the_library_does_what_the_command_does(work, tmp_path):
    camera = read_camera(work / "cal_report/camera.json")
    frames = el.open_frames(work / "v/sheet.mkv")
    session = calibrate_to_files(frames, el.TARGETS["vicalib_folded"], tmp_path / "c.json", camera=camera)
    found = el.Calibration.load(tmp_path / "c.json")
    assert found.camera == el.Calibration.load(work / "cal.json").camera
    assert found.photometry == session.light.photometry
    assert found.photometry.k == pytest.approx(2.5, abs=0.03)


def test_a_calibration_is_replaced_by_the_next_one_but_not_that_of_another(work, tmp_path, refused):
    for name in ("cal.json", "cal_report"):
        (shutil.copytree if name == "cal_report" else shutil.copy2)(work / name, tmp_path / name)
    out, report = tmp_path / "cal.json", tmp_path / "cal_report"
    how = ("--camera", work / "cal.json")
    assert calibrate(work / "v/sheet.mkv", out, *how, target="vicalib_folded") == 0
    assert el.Calibration.load(out).photometry.gamma == 2.2
    out.write_text(out.read_text().replace("2.2", "2.3"))
    for path, content in ((out, out.read_bytes()), (report / "detections.jsonl", b"my own")):
        there = path.read_bytes()
        path.write_bytes(content)
        says = [f"{path.name} is there already and endolab did not write it", "with --overwrite"]
        refused(work / "v/sheet.mkv", out, *how, target="vicalib_folded", says=says)
        assert path.read_bytes() == content
        path.write_bytes(there)
        out.unlink(missing_ok=True)
    shutil.copy2(work / "cal.json", out)
    says = ["cal.json is read by this very call"]
    refused(work / "v/sheet.mkv", out, "--camera", out, "--overwrite", target="vicalib_folded", says=says)
    refused(work / "v/sheet.mkv", tmp_path / "x", target="vicalib_folded", says=["ends in .json"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cal.json", "cal_report"]


def test_a_simulated_sheet_is_whole_and_mixed_with_no_other(tmp_path, capsys):
    sheet = ("simulate", "sheet", "--width", 64, "--out", tmp_path / "v")
    for count in (2, 2, 3):
        assert call(*sheet, "--frames", count) == 0
    files = [".endolab.json", "000000.png", "000001.png", "000002.png", "truth.json"]
    assert sorted(path.name for path in (tmp_path / "v").iterdir()) == files
    capsys.readouterr()
    assert call(*sheet, "--frames", 2, "--overwrite") == 2
    error = capsys.readouterr().err
    assert "000002.png would be taken for one of the 2 frames; choose another folder" in error
    (tmp_path / "v/000001.png").write_bytes(b"mine")
    assert call(*sheet, "--frames", 3) == 2
    assert "000001.png is there already and endolab did not write it" in capsys.readouterr().err
    assert call(*sheet, "--frames", 3, "--overwrite") == 0


def test_a_package_that_is_missing_is_named_before_the_search(work, tmp_path, monkeypatch):
    monkeypatch.setattr(_extras, "find_spec", lambda name: None if name == "rerun" else name)
    frames = el.open_frames(work / "v/sheet.mkv")
    with pytest.raises(_extras.MissingPackage, match="rerun is not installed"):
        calibrate_to_files(frames, el.TARGETS["vicalib_folded"], tmp_path / "c.json", record=True)
    assert not list(tmp_path.iterdir())


def test_a_video_that_ends_early_is_calibrated_as_far_as_it_goes(work, tmp_path, capsys):
    content = (work / "v/sheet.mkv").read_bytes()
    (tmp_path / "short.mkv").write_bytes(content[: int(0.8 * len(content))])
    assert calibrate(tmp_path / "short.mkv", tmp_path / "c.json", target="vicalib_folded") == 0
    assert "the video ends before it" in capsys.readouterr().out


def test_a_wall_is_not_made_of_paper(work, tmp_path, capsys):
    frame = tmp_path / "frame.png"
    assert call("simulate", "curved", "--out", tmp_path, "--width", 640) == 0
    arguments = ("reconstruct", frame, "--calibration", work / "cal.json", "--out", tmp_path / "out")
    assert call(*arguments, "--solver", "facing") == 0
    assert "The BRDF is that of the calibration sheet" in capsys.readouterr().out
    assert call(*arguments, "--solver", "facing", "--albedo", "0.75,0.38,0.30") == 0
    assert "calibration sheet" not in capsys.readouterr().out
    assert call(*arguments, "--albedo", "paper") == 2
    assert "--albedo must be one number in (0, 1] or three (R,G,B), got paper" in capsys.readouterr().err


def test_one_flat_sheet_does_not_tell_gamma(work, tmp_path, refused):
    says = "gamma", "fold", "the camera alone is in"
    refused(write_frames(tmp_path / "f", count=16), tmp_path / "c.json", "--gamma", "free", says=says)
    assert not (tmp_path / "c.json").exists()
    assert (tmp_path / "c_report/report.html").is_file()
    camera = json.loads((tmp_path / "c_report/camera.json").read_text())["camera"]
    assert camera["fx"] == pytest.approx(el.load_calibration("paper", width=480).camera.fx, abs=0.2)


def test_no_target_says_where_and_what_for(tmp_path, rng, refused):
    (tmp_path / "f").mkdir()
    for number in range(3):
        write_image(tmp_path / f"f/{number}.png", rng.random((120, 160)))
    says = "in none of 3 frames", "19 x 10 dots of two sizes, 4.2238 mm apart"
    refused(tmp_path / "f", tmp_path / "c.json", says=says)


def test_pictures_can_be_named_one_by_one(tmp_path, rng, refused):
    """In one folder or not; what was found is kept by names that tell them apart."""
    paths = [tmp_path / place for place in ("a/1.png", "a/10.png", "b/1.png")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        write_image(path, rng.random((120, 160)))
    refused(
        "calibrate",
        *reversed(paths),
        *("--target", "charuco", "--out", tmp_path / "c.json"),
        says=("in none of 3",),
    )
    kept = (tmp_path / "c_report/detections.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)[0] for line in kept[1:]] == ["a/1.png", "a/10.png", "b/1.png"]
    for other, says in ((tmp_path / "a", "is a folder: give one folder"), (paths[0], "is given twice")):
        refused(
            "calibrate", paths[0], other, *("--target", "charuco", "--out", tmp_path / "d.json"), says=(says,)
        )


def test_frontal_frames_with_a_known_camera_do_not_tell_k(work, tmp_path, refused):
    frames = write_frames(tmp_path / "f", count=8, tilt=0.0, width=640)
    error = refused(frames, tmp_path / "c.json", "--camera", work / "cal.json")
    assert error.startswith("endolab: k ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--gamma", "two"],
            "--gamma must be a positive number, one and its standard deviation (2.2,0.1) or free",
        ),
        (["--gamma", "9"], "gamma must lie between 0.5 and 5"),
        (["--reflectance", "0.5"], "the target has 0 kinds of grey patches, but --reflectance says 1"),
        (["--channel", "infrared"], "--channel"),
        (["--every", "0"], "--every must be at least 1, got 0"),
        (["--camera", "none.json"], "none.json: there is no such"),
    ],
)
def test_a_bad_option(work, tmp_path, refused, options, message):
    assert message in refused(work / "v/sheet.mkv", tmp_path / "c.json", *options, target="vicalib_folded")


def test_a_bad_place_or_source(work, tmp_path, refused):
    assert "ends in .json" in refused(work / "v/sheet.mkv", tmp_path / "c.txt")
    assert "no such folder or video" in refused(tmp_path / "none.mp4", tmp_path / "c.json")
    (tmp_path / "t.json").write_text('{"endolab_target": 1, "kind": "dots", "columns": 19, "rows": 10}')
    error = refused(work / "v/sheet.mkv", tmp_path / "c.json", target=tmp_path / "t.json")
    assert "t.json: spacing: missing" in error
    assert "unknown target" in refused("target", "none", "--out", tmp_path / "s.pdf")


def test_a_sheet_to_print(tmp_path, capsys):
    assert call("target", "vicalib_folded", "--out", tmp_path / "s.pdf") == 0
    assert (tmp_path / "s.pdf").read_bytes().startswith(b"%PDF")
    said = capsys.readouterr().out
    assert "print at 100 %" in said
    assert "folded by 10 to 30°" in said
    assert call("target", "vicalib_folded", "--out", tmp_path / "s.pdf") == 0  # the same again
    assert call("target", "vicalib_small", "--out", tmp_path / "s.pdf") == 2
    asked = "s.pdf is there already; choose another name, or replace it with --overwrite"
    assert asked in capsys.readouterr().err
    assert call("target", "vicalib_small", "--out", tmp_path / "s.pdf", "--overwrite") == 0
    assert "something flat" in capsys.readouterr().out


@pytest.fixture(scope="module")
def tissue(tmp_path_factory):
    """Pictures of a tube by the paper's fisheye, with k = 1.5, and its camera alone."""
    folder = tmp_path_factory.mktemp("tissue")
    camera = el.load_calibration("paper", width=96).camera
    for number, scene in enumerate((el.Tube(length=130), el.Tube(length=110, tilt=10))):
        light = el.Photometry(1.5, 2.2, None, el.Lambertian((0.75, 0.38, 0.30)))
        write_image(folder / f"{number}.png", el.render(scene, camera, light).image)
    write_camera(camera, folder / "camera.json")
    return folder


def calibrate_light(folder, *options):
    return call("calibrate-light", folder, "--camera", folder / "camera.json", *options)


def test_frames_of_tissue_tell_the_light(tissue, tmp_path, capsys):
    assert calibrate_light(tissue, "--out", tmp_path / "found.json", "--albedo", "0.75,0.38,0.3") == 0
    said = capsys.readouterr().out
    assert "The light falls off with k = " in said
    found = el.Calibration.load(tmp_path / "found.json")
    assert found.photometry.k == pytest.approx(1.5, abs=0.4)
    assert found.photometry.brdf == el.Lambertian((0.75, 0.38, 0.3))
    evidence = found.evidence["unknown_light"]
    assert evidence["verdict"] in said
    assert list(evidence["costs"]) == ["0.png", "1.png"]


def test_so_many_frames_are_asked_as_it_is_told(tissue, tmp_path, capsys):
    (tissue / "2.png").write_bytes(b"no picture")
    try:
        assert calibrate_light(tissue, "--out", tmp_path / "found.json", "--frames", 2) == 0
    finally:
        (tissue / "2.png").unlink()
    assert "cannot be read: 2.png" in capsys.readouterr().out
    assert list(el.Calibration.load(tmp_path / "found.json").evidence["unknown_light"]["costs"]) == ["0.png"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--camera", "paper"), "0.png is 96x72 px, but the calibration is for 1440x1080 px"),
        (("--frames", 0), "--frames must be at least 1, got 0"),
        (("--gamma", -1), "gamma must be positive"),
        (("--albedo", "red"), "--albedo must be one number in (0, 1] or three (R,G,B), got red"),
        (("--camera", "none.json"), "none.json: there is no such"),
    ],
)
def test_a_light_that_cannot_be_asked_for(options, says, tissue, tmp_path, capsys):
    assert calibrate_light(tissue, "--out", tmp_path / "found.json", *options) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_camera_that_is_read_is_not_replaced(tissue, capsys):
    before = (tissue / "camera.json").read_bytes()
    assert calibrate_light(tissue, "--out", tissue / "camera.json", "--overwrite") == 2
    assert (tissue / "camera.json").read_bytes() == before
    assert "write to another place" in capsys.readouterr().err
