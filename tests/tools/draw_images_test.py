"""The drawings: what is committed is what the code draws."""

import matplotlib
import pytest

from tests.tools.draw_images import DRAWINGS, IMAGES, svg

RENDERER = "3.11"  # of matplotlib, which drew what is committed


@pytest.mark.skipif(not matplotlib.__version__.startswith(RENDERER), reason="another Matplotlib drew them")
@pytest.mark.parametrize("draw", DRAWINGS, ids=lambda draw: draw.__name__)
def test_what_is_committed_is_what_the_code_draws(draw):
    assert svg(draw) == (IMAGES / f"{draw.__name__}.svg").read_bytes()
