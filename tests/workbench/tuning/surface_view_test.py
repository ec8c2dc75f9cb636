"""The surface that is turned, without a browser: what is sent, what is not joined, what is refused."""

from itertools import pairwise

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.numerics.derivatives import links
from endolab.workbench.recording import viewer
from endolab.workbench.tuning.surface_view import (
    PANEL,
    SurfaceView,
    box_of,
    fits_box,
    show_surface,
    thin_indices,
    thin_links,
)


@pytest.fixture
def view():
    view = SurfaceView()
    yield view
    view.close()


def wall(height, width, far=40.0):
    """A wall before a pinhole: distance, rays and a picture."""
    field = el.Pinhole(
        width, height, width / 2, width / 2, (width - 1) / 2, (height - 1) / 2
    ).field
    return far / field.rays[..., 2], field.rays, np.full((height, width, 3), 100, np.uint8)


def points_of(view):
    grid = np.frombuffer(view.grid, np.float32).reshape(-1, 5)
    return grid[:, :3] * np.frombuffer(view.far, np.float32)[:, None]


def triangles_of(view):
    return np.frombuffer(view.triangles, np.uint32).reshape(-1, 3)


def test_the_points_are_those_of_the_surface_and_each_square_is_two_triangles(view):
    distance, rays, picture = wall(6, 8)
    view.show(distance, rays, picture)
    np.testing.assert_allclose(
        points_of(view), (rays * distance[..., None]).reshape(-1, 3), rtol=1e-6
    )
    triangles = triangles_of(view)
    assert len(triangles) == 2 * 5 * 7
    corners = points_of(view)[triangles].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(normal[:, 2] < 0)  # all face the endoscope
    assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(
        np.ptp(corners[..., 0]) * np.ptp(corners[..., 1])
    )
    np.testing.assert_allclose(
        np.frombuffer(view.grid, np.float32)[3:5], [0.5 / 8, 0.5 / 6]
    )


def test_no_triangle_bridges_a_cut_or_leaves_the_mask(view):
    distance, rays, picture = wall(6, 8)
    distance[:, 4:] *= 2
    distance[2, 1] = np.nan
    cuts = np.zeros((2, 6, 8), bool)
    cuts[0, :, 3] = True
    view.show(distance, rays, picture, cuts=cuts)
    columns = triangles_of(view) % 8
    assert np.all((columns <= 3).all(axis=1) | (columns >= 4).all(axis=1))
    assert {*range(8)} == {*columns.ravel().tolist()}
    assert 2 * 8 + 1 not in triangles_of(view)
    before = view.triangles
    view.drawn = 1
    view.show(distance, rays, picture)
    assert (
        len(view.triangles) == len(before) + 5 * 2 * 12
    )  # the column of squares that was cut


@pytest.mark.parametrize(
    ("height", "width"), [(300, 400), (240, 320), (1080, 1350), (700, 100), (1, 900)]
)
def test_large_frames_are_thinned_evenly_and_to_their_rim(height, width):
    rows, columns = thin_indices((height, width))
    assert len(rows) <= PANEL.rows
    assert len(columns) <= PANEL.columns
    for places, count in ((rows, height), (columns, width)):
        assert places[0] == 0
        assert len(places) == 1 or places[-1] == count - 1
        assert np.ptp(np.diff(places)) <= 1 if len(places) > 1 else True
    if (height, width) == (240, 320):
        assert (len(rows), len(columns)) == (height, width)


def test_a_step_between_thinned_points_is_one_where_all_steps_are():
    rng = np.random.default_rng(3)
    joined = links(rng.random((29, 41)) < 0.95, rng.random((2, 29, 41)) < 0.03)
    rows = np.array([0, 2, 5, 8, 12, 28])
    columns = np.array([0, 1, 4, 9, 20, 40])
    found = thin_links(joined, rows, columns)
    right = [
        [joined[0, r, a:b].all() for a, b in pairwise(columns)] + [False] for r in rows
    ]
    below = [[joined[1, a:b, c].all() for c in columns] for a, b in pairwise(rows)] + [
        [False] * 6
    ]
    np.testing.assert_array_equal(found, [right, below])
    assert 0 < found.sum() < 50


def test_only_what_has_changed_is_sent_and_the_pose_never(view):
    distance, rays, picture = wall(30, 40)
    view.show(distance, rays, picture)
    sent = []
    view.send_state = lambda key=None: sent.append(
        {key} if isinstance(key, str) else {*key}
    )
    view.pose = [10.0, 5.0, 2.0, 0.1, 0.0]
    view.drawn = 1
    sent.clear()
    view.show(1.02 * distance, rays, picture)
    assert sent == [{"far", "number"}]
    view.drawn = 2
    sent.clear()
    view.show(1.02 * distance, rays, picture // 2)
    assert sent == [{"picture", "number"}]
    assert view.pose == [10.0, 5.0, 2.0, 0.1, 0.0]


def test_the_latest_waits_until_the_one_before_is_drawn(view):
    distance, rays, picture = wall(30, 40)
    for scale in (1.0, 1.01, 1.02, 1.03):
        view.show(scale * distance, rays, picture)
    assert view.number == 1
    view.drawn = 1  # as the page says
    assert view.number == 2
    np.testing.assert_allclose(
        np.frombuffer(view.far, np.float32), 1.03 * distance.ravel(), rtol=1e-6
    )
    view.drawn = 2
    assert view.number == 2


def test_what_nobody_sees_is_sent_when_it_is_seen(view):
    distance, rays, picture = wall(30, 40)
    view.visible = False
    view.show(distance, rays, picture)
    assert (view.number, view.far) == (0, b"")
    view.visible = True
    assert view.number == 1


def test_the_box_holds_all_but_spikes_and_stays_while_a_slider_moves():
    distance, rays, _ = wall(60, 80)
    distance[5, 5] *= 30
    points = (rays * distance[..., None]).reshape(-1, 3)
    box = box_of(points)
    assert box == pytest.approx([-40, -30, 40, 40, 30, 40], abs=2)
    assert fits_box(box, box_of(1.05 * points))
    assert not fits_box(box, box_of(1.5 * points))
    assert not fits_box(box, box_of(points + np.array([0, 0, 60])))
    assert not fits_box([], box)


def test_a_large_picture_is_shrunk_and_a_dark_one_lifted_if_asked_for(view):
    distance, rays, _ = wall(60, 80)
    picture = np.full((1200, 1600), 0.1)
    picture[:40] = 0.2
    view.show(distance, rays, picture)
    seen = cv2.imdecode(np.frombuffer(view.picture, np.uint8), cv2.IMREAD_COLOR)
    assert seen.shape == (0.75 * PANEL.texture_columns, PANEL.texture_columns, 3)
    assert np.median(seen) == pytest.approx(25, abs=2)
    view.drawn = 1
    view.show(distance, rays, picture, lift=True)
    seen = cv2.imdecode(np.frombuffer(view.picture, np.uint8), cv2.IMREAD_COLOR)
    assert np.median(seen) == pytest.approx(255 * 0.5**0.6, abs=3)


def test_a_closed_view_forgets_its_surface():
    distance, rays, picture = wall(30, 40)
    view = SurfaceView()
    view.show(distance, rays, picture)
    view.close()
    assert view.comm is None
    view.show(distance, rays, picture)
    assert {
        len(value) for value in (view.grid, view.far, view.triangles, view.picture)
    } == {0}


def test_a_result_is_shown_in_its_frame_and_has_a_still_where_nobody_looks(monkeypatch):
    small = datasets.load_calibration("paper").resize(80, 60)
    seen = el.render(el.SCENES["tube"], small.camera, small.photometry)
    frame = el.Frame(seen.image, seen.mask)
    known = el.Calibration(seen.camera, seen.photometry)
    result = el.reconstruct(frame, known, solver="fast_marching")
    view = el.show_surface(result)
    far = np.frombuffer(view.far, np.float32).reshape(60, 80)
    np.testing.assert_allclose(far[result.mask], result.distance[result.mask], rtol=1e-6)
    monkeypatch.setattr(viewer, "front_end", lambda: False)
    shown = view._repr_mimebundle_()[0]
    assert "application/vnd.jupyter.widget-view+json" in shown
    still = cv2.imdecode(np.frombuffer(shown["image/png"], np.uint8), cv2.IMREAD_COLOR)
    assert len(np.unique(still.reshape(-1, 3), axis=0)) > 500
    view.close()
    with pytest.raises(ValueError, match="result"):
        show_surface("run.rrd")
    for wrong in ("frame.png", np.ones((60, 80, 4)), np.ones((80, 60))):
        with pytest.raises(ValueError, match="picture"):
            show_surface(result, wrong)
