"""Recordings of a calibration: what was logged, read back."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.summary import mean_distances
from endolab.workbench.recording.calibration import record_calibration
from tests.tools.recorded import Recorded
from tests.tools.simulated_session import COUNT, LOST, refused, simulated


@pytest.mark.parametrize("name", ["vicalib_small", "vicalib_folded"])
def test_what_is_read_back_is_the_calibration(name, tmp_path):
    session, frames = simulated(name)
    record_calibration(session, frames, tmp_path / "calibration.rrd")
    assert [file.name for file in tmp_path.iterdir()] == ["calibration.rrd"]
    file = Recorded(tmp_path / "calibration.rrd")
    names = list(session.detections)
    assert list(file.rows["/picture"]["blob"]) == list(range(len(names)))
    shown = file.grey_picture("/picture", 4)
    assert np.abs(shown / 255 - frames[4][1]).mean() < 0.1  # JPEG of noise

    def points(entity, component, number, size=2):
        return file.at(entity, component, number).reshape(-1, size)

    target = session.target
    panel = target.panel_of(target.points)
    geometry = session.geometry
    for number, name in enumerate(names):
        pixels = points("/picture/detected", "positions", number)
        assert np.allclose(pixels, session.detections[name].pixels + 0.5, atol=1e-3)
        sheet = points("/world/sheet", "positions", number, 3)
        places = [
            pose.transform(target.points[panel == n])
            for n, pose in enumerate(session.poses.get(name, ()))
            if pose is not None
        ]
        assert (places == []) == (name in LOST)
        assert np.allclose(sheet, np.concatenate([sheet[:0], *places]), atol=1e-3)
        views = [n for n, view in enumerate(geometry.views) if view.name == name]
        residuals = [geometry.residuals[n][geometry.inliers[n]] for n in views]
        vectors = points("/picture/reprojection", "vectors", number)
        expected = (
            0.015 * 160 / geometry.sigma * np.concatenate([*residuals, vectors[:0]])
        )
        assert np.allclose(vectors, expected, rtol=1e-5)

    located = [names.index(name) for name in session.poses]
    gains = dict(zip(located, session.light.gains, strict=True))
    assert file.numbers("/plots/gain", "scalars") == gains
    distances = mean_distances(session.samples, np.arange(COUNT))
    found = file.numbers("/plots/distance", "scalars")
    assert [found[k].item() for k in located] == pytest.approx(distances.tolist())


def test_a_session_without_light_camera_or_picture_is_recorded(tmp_path):
    session, frames = simulated("vicalib_folded")
    poses = session.poses | {"frame_0": (None, session.poses["frame_0"][1])}
    session = replace(refused(session), geometry=None, poses=poses)
    frames = [(name, None if name == "frame_2" else image) for name, image in frames]
    record_calibration(session, frames, tmp_path / "calibration.rrd")
    file = Recorded(tmp_path / "calibration.rrd")
    assert 2 not in file.numbers("/picture", "blob")
    assert "/plots/gain" not in file.rows
