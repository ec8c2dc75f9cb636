"""The surface that is turned: what lies in the page, and what is refused; a browser draws it elsewhere."""

import base64
import json

import numpy as np
import pytest

import endolab as el


@pytest.fixture(scope="module")
def shown(seen):
    frame, calibration, _ = seen
    return el.reconstruct(frame, calibration, channel="green", contours=False)


def test_the_points_are_those_of_the_surface(shown):
    page = el.show_surface(shown).data
    content = json.loads(page[page.index('{"width"') : page.rindex("); })();")])
    maps = {
        name: np.frombuffer(base64.b64decode(text), kind)
        for name, kind, text in content["maps"]
    }
    points = maps["rays"].reshape(-1, 3) * maps["far"][:, None]
    wanted = shown.points.reshape(-1, 3)
    np.testing.assert_allclose(points, wanted, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("picture", [np.ones((3, 3)), "frame", np.ones((120, 160, 4))])
def test_what_lies_on_it_is_of_its_size(shown, picture):
    with pytest.raises(ValueError, match="picture"):
        el.show_surface(shown, picture)
