"""The surface that is turned, without a browser: what is sent, what is not joined, what is refused."""

import time

import cv2
import numpy as np
import pytest

import endolab as el
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate
from endolab.workbench.recording import viewer
from endolab.workbench.tuning.surface_view import SurfaceView


@pytest.fixture
def view():
    view = SurfaceView()
    yield view
    view.close()


def wall(height, width, *, far=40.0, mask=True, cuts=None):
    """A wall before a pinhole, as an iterate; `far`, (H, W), is z."""
    middle = (width - 1) / 2, (height - 1) / 2
    camera = el.Pinhole(width, height, width / 2, width / 2, *middle)
    mask = np.broadcast_to(mask, (height, width))
    image = np.full((height, width), 0.1)
    problem = Problem(image, mask, camera, el.Photometry(gain=1.0), cuts=cuts)
    return Iterate.of(problem, np.log(far / camera.field.rays[..., 2]), terms={})


def points_of(view):
    rays = np.frombuffer(view.rays, np.float32).reshape(-1, 3)
    return rays * np.frombuffer(view.far, np.float32)[:, None]


def triangles_of(view):
    return np.frombuffer(view.triangles, np.uint32).reshape(-1, 3)


def test_the_points_are_those_of_the_surface_and_each_square_is_two_triangles(view):
    shown = wall(6, 8)
    view.show(shown)
    assert view.columns == 8
    np.testing.assert_allclose(points_of(view), shown.points.reshape(-1, 3), rtol=1e-6)
    triangles = triangles_of(view)
    assert len(triangles) == 2 * 5 * 7
    corners = points_of(view)[triangles].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(normal[:, 2] < 0)  # all face the endoscope
    area = np.ptp(corners[..., 0]) * np.ptp(corners[..., 1])
    assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(area)


@pytest.mark.parametrize("scale", [1, 50])
def test_no_triangle_bridges_a_cut_or_leaves_the_mask(view, scale):
    """Nor where a large frame has fewer points than pixels."""
    height = 6 * scale
    width = 8 * scale
    far = np.full((height, width), 40.0)
    far[:, width // 2 :] *= 2
    mask = np.ones((height, width), bool)
    mask[2 * scale : 3 * scale, scale : 2 * scale] = False
    cuts = np.zeros((2, height, width), bool)
    cuts[0, :, width // 2 - 1] = True
    view.show(wall(height, width, far=far, mask=mask, cuts=cuts))
    triangles = triangles_of(view)
    rows, columns = np.divmod(triangles, view.columns)
    assert 8 <= view.columns <= 320
    left = columns < view.columns // 2
    assert np.all(left.all(axis=1) | ~left.any(axis=1))
    assert {*range(view.columns)} == {*columns.ravel().tolist()}
    assert not np.any(
        mask[:: -(-width // 320), :: -(-width // 320)][rows, columns] == 0
    )


def test_only_what_has_changed_is_sent_and_the_pose_never(view):
    view.show(wall(30, 40))
    sent = []
    view.send_state = lambda key=None: sent.append(
        {key} if isinstance(key, str) else {*key}
    )
    view.pose = [10.0, 5.0, 2.0, 0.1, 0.0]
    view.drawn = 1
    sent.clear()
    view.show(wall(30, 40, far=41.0))
    assert sent == [{"far", "number"}]
    view.drawn = 2
    sent.clear()
    view.show(wall(30, 40, far=41.0), np.full((30, 40), 0.3))
    assert sent == [{"picture", "number"}]
    assert view.pose == [10.0, 5.0, 2.0, 0.1, 0.0]


def test_the_latest_waits_until_the_one_before_is_drawn_and_somebody_looks(view):
    view.visible = False
    view.show(wall(30, 40))
    assert (view.number, view.far) == (0, b"")
    view.visible = True
    assert view.number == 1
    for far in (41.0, 42.0, 43.0):
        last = wall(30, 40, far=far)
        view.show(last)
    assert view.number == 1
    view.drawn = 1  # as the page says
    assert view.number == 2
    far = np.frombuffer(view.far, np.float32)
    np.testing.assert_allclose(far, last.distance.ravel(), rtol=1e-6)
    view.drawn = 2
    assert view.number == 2


def test_a_page_that_draws_slowly_has_time_for_other_things(view):
    """Of surfaces that follow one another the latest comes later, by itself."""
    view.show(wall(30, 40), moving=True)
    triangles = view.triangles
    time.sleep(0.3)
    view.drawn = 1
    for far in (41.0, 42.0):
        last = wall(30, 40, far=far)
        view.show(last, moving=True)
    assert view.number == 1
    for _ in range(100):
        time.sleep(0.05)
        if view.number == 2:
            break
    np.testing.assert_allclose(points_of(view), last.points.reshape(-1, 3), rtol=1e-6)
    assert view.triangles == triangles
    view.show(wall(30, 40, far=43.0))  # that one is to stay
    view.drawn = 2
    assert view.number == 3


def test_a_closed_view_forgets_its_surface():
    view = SurfaceView()
    view.show(wall(30, 40))
    view.close()
    assert view.comm is None
    view.show(wall(30, 40))
    assert not any((view.rays, view.far, view.triangles, view.picture))


def test_a_result_is_shown_in_its_frame_and_has_a_still_where_nobody_looks(
    seen, monkeypatch
):
    frame, calibration, _ = seen
    result = el.reconstruct(frame, calibration, solver="fast_marching")
    view = el.show_surface(result)
    far = np.frombuffer(view.far, np.float32).reshape(result.mask.shape)
    np.testing.assert_allclose(
        far[result.mask], result.distance[result.mask], rtol=1e-6
    )
    monkeypatch.setattr(viewer, "front_end", lambda: False)
    shown = view._repr_mimebundle_()[0]
    assert "application/vnd.jupyter.widget-view+json" in shown
    still = cv2.imdecode(np.frombuffer(shown["image/png"], np.uint8), cv2.IMREAD_COLOR)
    assert len(np.unique(still.reshape(-1, 3), axis=0)) > 500
    view.close()
