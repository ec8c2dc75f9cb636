"""Recordings of a calibration: what was logged, read back, and what becomes of the file."""

from dataclasses import replace
from itertools import compress

import numpy as np
import pytest

from endolab.calibration.summary import mean_distances
from endolab.workbench.recording.calibration import record_calibration
from tests.tools.recorded import Recorded
from tests.tools.simulated_session import COUNT, LOST, refused, simulated


@pytest.fixture(scope="module", params=["vicalib_small", "vicalib_folded"])
def recorded(request, tmp_path_factory):
    session, frames, _ = simulated(request.param)
    path = tmp_path_factory.mktemp("recording") / "calibration.rrd"
    record_calibration(session, frames, path)
    assert [file.name for file in path.parent.iterdir()] == ["calibration.rrd"]
    return session, frames, Recorded(path)


def test_every_frame_has_its_picture_and_its_features(recorded):
    session, frames, file = recorded
    names = list(session.detections)
    assert list(file.rows["/picture"]["blob"]) == list(range(len(names)))
    shown = file.picture("/picture", 4, grey=True)
    assert np.abs(shown / 255 - frames[4][1]).mean() < 0.1  # JPEG of noise
    for number, name in enumerate(names):
        pixels = file.at("/picture/detected", "positions", number).reshape(-1, 2)
        assert np.allclose(pixels, session.detections[name].pixels + 0.5, atol=1e-3)


def test_the_sheet_stands_where_its_poses_say(recorded):
    session, _, file = recorded
    target = session.target
    panel = target.panel_of(target.points)
    for number, name in enumerate(session.detections):
        found = file.at("/world/sheet", "positions", number).reshape(-1, 3)
        assert (len(found) == 0) == (name in LOST)
        for n, pose in enumerate(session.poses.get(name, ())):
            if pose is None:
                continue
            places = pose.transform(target.points[panel == n])
            assert np.allclose(found[: len(places)], places, atol=1e-3)
            found = found[len(places) :]


def test_arrows_are_the_residuals_of_the_frame(recorded):
    session, _, file = recorded
    geometry = session.geometry
    number = 6
    name = list(session.detections)[number]
    here = [view.name == name for view in geometry.views]
    pixels = np.concatenate([view.pixels for view in compress(geometry.views, here)])
    residuals = np.concatenate(list(compress(geometry.residuals, here)))
    good = np.concatenate(list(compress(geometry.inliers, here)))
    origins = file.at("/picture/reprojection", "origins", number).reshape(-1, 2)
    vectors = file.at("/picture/reprojection", "vectors", number).reshape(-1, 2)
    assert np.allclose(origins, pixels[good] + 0.5, atol=1e-3)
    magnify = 0.015 * 160 / geometry.sigma
    assert np.allclose(vectors, magnify * residuals[good], rtol=1e-5)


def test_curves_are_on_the_frames_of_the_video(recorded):
    session, _, file = recorded
    names = list(session.detections)
    located = [names.index(name) for name in session.poses]
    gains = dict(zip(located, session.light.gains, strict=True))
    assert file.numbers("/plots/gain", "scalars") == gains
    distances = mean_distances(session.samples, np.arange(COUNT))
    found = file.numbers("/plots/distance", "scalars")
    assert [found[k].item() for k in located] == pytest.approx(distances.tolist())


def test_a_session_without_light_camera_or_picture_is_recorded(tmp_path):
    session, frames, _ = simulated("vicalib_folded")
    poses = session.poses | {"frame_0": (None, session.poses["frame_0"][1])}
    session = replace(refused(session), geometry=None, poses=poses)
    frames = [(name, None if name == "frame_2" else image) for name, image in frames]
    record_calibration(session, frames, tmp_path / "calibration.rrd")
    file = Recorded(tmp_path / "calibration.rrd")
    assert 2 not in file.numbers("/picture", "blob")
    assert "/plots/gain" not in file.rows
