"""Fast pictures: colours, ticks, panels of any shape and size."""

import numpy as np
import pytest

from endolab.tuning.pictures import Look, coloured, curve_panel, grey_or_colour, map_panel, ticks


def test_colours_span_their_limits_and_leave_out_what_is_unknown():
    values = np.array([[0.0, 1.0, 5.0, np.nan]])
    assert coloured(values, (0, 1)).tolist()[0] == [[68, 1, 84], [253, 231, 37], [253, 231, 37], [184] * 3]
    middle = coloured(np.zeros((1, 1)), (-1, 1), "diverging")[0, 0]
    assert middle.min() > 250
    assert grey_or_colour(np.array([[0.5, np.nan]])).tolist()[0] == [[128] * 3, [184] * 3]


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 170), (1e-5, 2e-5), (2, 2)])
def test_ticks_are_round_and_within(low, high):
    marks = ticks(low, high)
    assert 1 <= len(marks) <= 8
    assert all(low - 1e-12 <= mark <= high + 1e-12 for mark in marks)


def test_a_panel_takes_any_shape_and_a_curve_of_one_point_is_a_dot():
    shapes = {map_panel("", np.zeros((h, w, 3), np.uint8)).shape for h, w in ((1, 1), (900, 3), (480, 640))}
    assert len(shapes) == 1
    curves = [("data", np.zeros(1), np.ones(1))], [("data", np.zeros(1), np.full(1, np.nan))]
    drawn, blank = (curve_panel("", each, "x", "y", y_limits=(0, 2)) for each in curves)
    assert (drawn != blank).any()


def test_a_small_panel_keeps_letters_that_can_be_read():
    assert [Look(scale).text for scale in (0.6, 1.0, 2.0)] == [11, 12, 24]
    assert Look().size == (392, 274)
    assert Look(2.0).size == (784, 548)
    assert Look(bars=False).size == (336, 274)
