"""The surface that is turned, without a browser: what is sent, what stands in a page, what is refused."""

import cv2
import numpy as np
import pytest

import endolab as el
from endolab.workbench.recording import viewer
from endolab.workbench.tuning.surface_view import SurfaceView


@pytest.fixture(scope="module")
def shown(seen):
    frame, calibration, _ = seen
    return el.reconstruct(frame, calibration, channel="green", contours=False)


def test_the_points_are_those_of_the_surface(shown):
    view = el.show_surface(shown)
    rays = np.frombuffer(view.rays, np.float32).reshape(-1, 3)
    points = rays * np.frombuffer(view.far, np.float32)[:, None]
    wanted = shown.points.reshape(-1, 3)
    np.testing.assert_allclose(points, wanted, rtol=1e-5, atol=1e-4)
    view.close()


@pytest.mark.parametrize(
    ("kernel", "kept"), [(None, True), ("a front end", False)], ids=["page", "lab"]
)
def test_a_rendered_page_has_a_picture_in_its_place(shown, monkeypatch, kernel, kept):
    monkeypatch.setattr(viewer, "front_end", lambda: kernel)
    view = el.show_surface(shown)
    bundle = view._repr_mimebundle_()[0]
    assert ("image/png" in bundle) == kept
    if kept:
        picture = cv2.imdecode(np.frombuffer(bundle["image/png"], np.uint8), 1)
        assert np.mean(picture.min(axis=-1) < 200) > 0.02
    view.close()


@pytest.mark.parametrize("picture", [np.ones((3, 3)), "frame", np.ones((120, 160, 4))])
def test_what_lies_on_it_is_of_its_size(shown, picture):
    with pytest.raises(ValueError, match="picture"):
        SurfaceView().show(shown, picture)
